"""Inversion: from measured spectra back to pigments."""
