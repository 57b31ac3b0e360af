"""Inversion: from measured spectra back to pigments."""

from irisjax._lazy import modules_of

__getattr__ = modules_of(__name__)
