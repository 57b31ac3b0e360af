"""Numerics without physics; not part of the public API."""
