"""Light that falls on the iris, from one direction or from all, and what its surface mirrors."""

import jax.numpy as jnp

from irisjax.numerics.quadrature import gauss_legendre
from irisjax.optics.fresnel import fresnel_at
from irisjax.tissue.indices import RefractiveIndices

DIFFUSE = "diffuse"
"""Incidence from every direction alike (cosine-weighted hemisphere)."""

HEMISPHERE = "hemisphere"
"""Exits into every direction, collected by a lens."""


def beams_of(cos_incidence, nodes: int, dtype):
    """Cosines of the light's directions and its shares along them; `nodes` for `DIFFUSE`."""
    if isinstance(cos_incidence, str):
        x, w = gauss_legendre(nodes)
        return jnp.asarray(x, dtype), jnp.asarray(2 * x * w, dtype)
    return jnp.atleast_1d(jnp.asarray(cos_incidence, dtype)), jnp.ones(1, dtype)


def exits_of(cos_incidence, cos_exit, azimuth, dtype):
    """Cosines and azimuths (default 0, straight on) of exits; `None` twice where none are asked
    for.

    **Raises:** `ValueError` under diffuse light, which comes from no plane that azimuths count
    from.
    """
    if cos_exit is None:
        return None, None
    if isinstance(cos_incidence, str):
        raise ValueError("a BRDF is of light from one direction, not diffuse")
    cosine = jnp.asarray(cos_exit, dtype)
    return cosine, jnp.zeros_like(cosine) if azimuth is None else jnp.asarray(azimuth, dtype)


def first_surface(cos_incidence, indices: RefractiveIndices, dtype):
    """Shares mirrored by and passing the aqueous/ABL interface, of light from a cosine or
    `DIFFUSE`.
    """
    if isinstance(cos_incidence, str):
        mu, w = beams_of(cos_incidence, 48, dtype)
        mirrored, entered = fresnel_at(mu, indices.aqueous, indices.abl)
        return w @ mirrored, w @ entered
    return fresnel_at(jnp.asarray(cos_incidence, dtype), indices.aqueous, indices.abl)
