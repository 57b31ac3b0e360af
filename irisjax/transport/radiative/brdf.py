"""The BRDF of radiative transfer for tables: scattered once exactly, oftener by look-up.

A look-up in the layers' three numbers and both cosines holds the azimuthal orders 0, 1 and 2, all
that Rayleigh's law has, of light scattered twice and oftener.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.tucker import Tucker
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.radiative.axes import (
    cosine_place,
    in_double,
    layers_at,
    nodes,
    outside_nodes,
    places,
    resummed,
)
from irisjax.transport.radiative.directions import Directions, from_outside, quadrature_nodes
from irisjax.transport.radiative.fates import before
from irisjax.transport.radiative.orders import (
    azimuthal,
    multiple_scattering,
    single_scattering,
    ways,
)

_NODES = 12, 24, 8, 6, 6  # along τ_A, τ, ω and the cosines in and out
_LEFT_OUT = 1e-5
_ANGLES, _HOW = 32, (10, 3)


def table(indices: RefractiveIndices, pole: np.ndarray, dtype) -> Tucker:
    """What light scattered oftener than once adds, the pole 1/(1 − ω λ) taken out of order 0;
    `pole`: polynomials of λ.
    """
    points, outside = nodes(*_NODES[:3]), outside_nodes(_NODES[3], indices)
    found = in_double(_multiple, points, outside, indices)
    depth = np.asarray(places(*points.T).depth, np.float64)
    eigenvalue = np.polynomial.chebyshev.chebval(depth, pole)
    found[..., 0] *= (1 - points[:, 2] * eigenvalue)[:, None, None]
    return Tucker.of(found.reshape(*_NODES, 3), _LEFT_OUT, dtype)


def values(
    held: Tucker,
    pole,
    abl,
    depth,
    albedo,
    beam: Directions,
    exits: Directions,
    azimuth,
    indices: RefractiveIndices,
):
    """BRDF, shape (wavelengths, exits), of light from one direction."""
    at = places(abl, depth, albedo)
    core = jnp.einsum(
        "abziof,i,oe->efabz",
        held.core,
        held.basis(3, cosine_place(beam.cosine, indices))[:, 0],
        held.basis(4, cosine_place(exits.cosine, indices)),
    )
    along = held.basis(0, at.abl)[:, None] * held.basis(2, at.albedo)[None]
    found = jnp.einsum("efabz,bw,azw->wef", core, held.basis(1, at.depth), along)
    found = found.at[..., 0].multiply(resummed(pole, at, albedo)[:, None])

    def one(abl, depth, albedo, orders):
        out, lost = ways(abl, depth, exits, indices), before(abl, depth, beam).lost[0]
        more = albedo**2 * lost * out.taken * (orders.T * azimuthal(beam, exits, azimuth)).sum(0)
        return out.outside * (single_scattering(abl, depth, albedo, beam, exits, azimuth) + more)

    return jax.vmap(one)(abl, depth, albedo, found)


@eqx.filter_jit
def _multiple(points, outside, indices: RefractiveIndices):
    """At points (τ_A, τ, ω), between cosines in the aqueous humour: (points, beams, exits, 3)."""
    layers = layers_at(points, indices)
    angles, between = quadrature_nodes(layers, _ANGLES), from_outside(layers, outside)

    def one(p):
        return multiple_scattering(p[0], p[1], p[2], angles, between, between, _HOW)

    return jax.lax.map(one, points, batch_size=32)
