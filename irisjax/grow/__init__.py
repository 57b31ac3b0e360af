"""Irides, eye colours and vessels grown from a seed."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
