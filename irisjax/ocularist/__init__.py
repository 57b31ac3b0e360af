"""Painted irides: coats of paint on cones, as ocularists make them [L03]."""
