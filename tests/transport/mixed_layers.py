"""Layers whose phase function is a mixture, and their solution in one program."""

import dataclasses

import jax.numpy as jnp

import irisjax as ij
from common import layers, quick_jit
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.indices import Order

MATCHED = (1.4, 1.4, 1.4, 1.4)
LB06 = (1.336, 1.4733, 1.4728, 1.5)
REVERSED = (1.5, 1.4, 1.35, 1.3)


def mixed(abl, absorption, scattering, rayleigh, g, indices):
    """Layers whose phase function is a mixture, one wavelength or as many as are given."""
    made = layers(abl, absorption, scattering, indices)
    size = made.extinction.shape
    spread = (jnp.broadcast_to(jnp.asarray(x, float), size) for x in (rayleigh, g))
    order = made.order
    if not (order.stroma_over_abl or order.stroma_over_ipe):
        order = Order(True, False, False)  # one program for LB06's media and equal ones
    return dataclasses.replace(made, phase=PhaseMixture(*spread), order=order)


def _solve(seen, cosine, solver, exits=None):
    return solver.solve(seen, ij.Light(cosine, exits))


solve = quick_jit(_solve)
