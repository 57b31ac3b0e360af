"""Irides, eye colours and vessels grown from a seed."""
