"""Rayleigh's phase matrix by orders in azimuth, each a sum of few products f(μ) f(μ').

Light is described by I_l and I_r, the intensities of the fields in the plane of the normal and
across it, and by W = (U + iV)/√2, of which 2|W|² ≤ 4 I_l I_r: so scaled, the matrix is symmetric.
[Chandrasekhar 1960, Section 17, Eq. 17.209 ff.]
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from irisjax.numerics.roots import safe_sqrt

_ROOT_2 = math.sqrt(2)


class PolarisedMode(NamedTuple):
    """One azimuthal order: sources ω Σ_k strength_k f_k(μ) ∫ f_k·(I_l, I_r, U/√2, V/√2) dμ'.

    The functions are those of light on its way down. If U and V of the incident light are 0, order
    m has I ∝ cos mφ and U, V ∝ sin mφ; if I_l and I_r are 0, I ∝ sin mφ and U, V ∝ −cos mφ. The
    system is the same.

    Attributes:
        order: Azimuthal order m.
        strength: Strength of each term.
        parity: Signs of the functions for light on its way up: of I_l, of I_r and of W.
        linear: Functions of I_l and I_r, from cosines (angles,) to (rank, 2, angles), or `None`.
            Terms beyond `rank` are of W alone.
        turning: Function of U or V, (angles,), or `None`.
        u, v: Terms of U and of V.
    """

    order: int
    strength: tuple[float, ...]
    parity: tuple[int, int, int]
    linear: Callable[[Array], Array] | None
    turning: Callable[[Array], Array] | None
    u: int | None
    v: int | None

    def signs(self, cosine: Array) -> Array:
        """`parity` of I_l along directions, then of I_r."""
        return jnp.concatenate([jnp.full_like(cosine, sign) for sign in self.parity[:2]])


def _meridional(mu):
    one = jnp.ones_like(mu)
    return jnp.stack([jnp.stack([one, one]), jnp.stack([3 * mu * mu - 2, one])])


def _sine(mu):
    return safe_sqrt(1 - mu * mu)


def _first(mu):
    return jnp.stack([_ROOT_2 * mu * _sine(mu), jnp.zeros_like(mu)])[None]


def _second(mu):
    return jnp.stack([mu * mu, -jnp.ones_like(mu)])[None]


MERIDIONAL = PolarisedMode(0, (1 / 4, 1 / 8), (1, 1, 1), _meridional, None, None, None)
"""Order 0 of I_l and I_r; its first term is the whole intensity's, and carries all energy."""

CIRCULAR = PolarisedMode(0, (3 / 4,), (1, 1, -1), None, lambda mu: mu, None, 0)
"""Order 0 of V."""

FIRST = PolarisedMode(1, (3 / 8, 3 / 8), (-1, 1, 1), _first, _sine, 0, 1)
"""Order 1: one term of I_l and U, one of V."""

SECOND = PolarisedMode(2, (3 / 16,), (1, 1, -1), _second, lambda mu: _ROOT_2 * mu, 0, None)
"""Order 2."""

RAYLEIGH = (MERIDIONAL, CIRCULAR, FIRST, SECOND)
