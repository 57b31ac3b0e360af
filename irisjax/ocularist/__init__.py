"""Painted irides: coats of paint on cones [L03]."""
