"""Light that falls on the iris, from one direction or from all, and what its surface mirrors."""

import jax.numpy as jnp

from irisjax.numerics.quadrature import cosine_rule
from irisjax.optics.fresnel import critical_cosine_squared, fresnel_at
from irisjax.tissue.indices import RefractiveIndices

DIFFUSE = "diffuse"
"""Incidence from every direction alike (cosine-weighted hemisphere)."""

HEMISPHERE = "hemisphere"
"""Exits into every direction, collected by a lens."""


def beams_of(cos_incidence, nodes: int, indices: RefractiveIndices, dtype, interfaces: int = 3):
    """Cosines of the light's directions and its shares along them; `nodes` for `DIFFUSE`, a few
    more where that makes the shares of their panels even.

    Grazing light of a thin layer is resolved, and total reflection at the first `interfaces`, for
    which the nodes are shared out where the aqueous humour is denser than what lies beyond.
    """
    if isinstance(cos_incidence, str):
        beyond = (indices.abl, indices.stroma, indices.ipe)[:interfaces]
        breaks = [critical_cosine_squared(indices.aqueous, n) for n in beyond]
        rule = cosine_rule(jnp.asarray(breaks, dtype), (True,) * interfaces, nodes, entering=True)
        shares = 2 * rule.cosine * rule.weight
        return rule.cosine, shares / shares.sum()
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
        mu, w = beams_of(cos_incidence, 48, indices, dtype, interfaces=1)
        mirrored, entered = fresnel_at(mu, indices.aqueous, indices.abl)
        return w @ mirrored, w @ entered
    return fresnel_at(jnp.asarray(cos_incidence, dtype), indices.aqueous, indices.abl)
