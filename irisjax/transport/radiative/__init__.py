"""Radiative transfer of the same layers."""
