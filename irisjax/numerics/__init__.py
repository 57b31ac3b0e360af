"""Numerics that know no physics."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
