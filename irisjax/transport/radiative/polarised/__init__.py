"""Polarised radiative transfer of the same layers."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
