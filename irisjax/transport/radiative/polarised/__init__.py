"""Polarised radiative transfer of the same layers."""
