"""Directions in the stroma, what each meets at the interfaces, and Rayleigh's modes in azimuth."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.quadrature import conserving, cosine_rule, quadratic_rule
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.fresnel import critical_cosine_squared, fresnel, refract, refracted
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.process import attenuation, survival
from irisjax.transport.series import visit


class Mode(NamedTuple):
    """One azimuthal order of Rayleigh's phase function: J(μ) = ω Σ_k strength_k f_k(μ) ∫ f_k I
    dμ'.
    """

    order: int
    parity: int
    strength: tuple[float, ...]

    def functions(self, mu):
        """f_k at cosines `mu` > 0, shape (rank, angles); at −μ they take the sign `parity`."""
        sine_squared = jnp.maximum(1 - mu * mu, 0.0)
        if self.order == 0:
            return jnp.stack([jnp.ones_like(mu), 1.5 * mu * mu - 0.5])
        if self.order == 1:
            return (mu * jnp.sqrt(sine_squared))[None]
        return sine_squared[None]


MODES = (Mode(0, 1, (0.5, 0.25)), Mode(1, -1, (0.375,)), Mode(2, 1, (0.09375,)))


class Directions(NamedTuple):
    """Directions in the stroma with what each meets at the interfaces, all of shape (angles,).

    At an interface: reflectance and transmittance, or what else the law of the interfaces gives.
    """

    cosine: jax.Array
    weight: jax.Array
    abl_cosine: jax.Array
    top: Any  # stroma/ABL
    surface: Any  # ABL/aqueous
    bottom: Any  # stroma/IPE


class Roof(NamedTuple):
    """The ABL seen from the stroma, or from the aqueous humour: shares of the flux that falls on
    it.
    """

    reflected: jax.Array
    passed: jax.Array
    absorbed: jax.Array


def quadrature_nodes(layers: Layers, n_angles: int, law=fresnel) -> Directions:
    """Directions in the stroma that a quadrature takes, split at its critical angles; `law` of the
    interfaces as in `optics.fresnel`.
    """
    n, order = layers.indices, layers.order
    neighbours = (n.aqueous, n.abl, n.ipe)
    rule = cosine_rule(
        jnp.stack([critical_cosine_squared(n.stroma, k) for k in neighbours]),
        (True, order.stroma_over_abl, order.stroma_over_ipe),
        n_angles,
    )
    rule = conserving(rule)
    cosines = [refracted(rule, i, n.stroma, k) for i, k in enumerate(neighbours)]
    return _directions(n, law, rule.cosine, rule.weight, *cosines)


def gauss_nodes(layers: Layers, n_angles: int) -> Directions:
    """Directions in the stroma of a quadrature made for polynomials of the cosine, split at its
    critical angles.
    """
    n, order = layers.indices, layers.order
    neighbours = (n.aqueous, n.abl, n.ipe)
    cosine, weight = quadratic_rule(
        jnp.stack([safe_sqrt(critical_cosine_squared(n.stroma, k)) for k in neighbours]),
        (True, order.stroma_over_abl, order.stroma_over_ipe),
        n_angles,
    )
    abl, aqueous, ipe = (refract(cosine, n.stroma, k) for k in (n.abl, n.aqueous, n.ipe))
    return _directions(n, fresnel, cosine, weight, aqueous, abl, ipe)


def from_outside(layers: Layers, outside, law=fresnel) -> Directions:
    """Directions with given cosines in the aqueous humour; they carry no quadrature weight."""
    n = layers.indices
    abl, stroma = (refract(outside, n.aqueous, k) for k in (n.abl, n.stroma))
    ipe = refract(outside, n.aqueous, n.ipe)
    return _directions(n, law, stroma, jnp.zeros_like(outside), outside, abl, ipe)


def _directions(n: RefractiveIndices, law, stroma, weight, aqueous, abl, ipe) -> Directions:
    return Directions(
        # A beam that cannot enter has cosine 0 and no power; keep the exponentials finite.
        cosine=jnp.where(stroma > 0, stroma, 1.0),
        weight=weight,
        abl_cosine=jnp.where(abl > 0, abl, 1.0),
        top=law(stroma, abl, n.stroma, n.abl),
        surface=law(abl, aqueous, n.abl, n.aqueous),
        bottom=law(stroma, ipe, n.stroma, n.ipe),
    )


def roof_of(depth, d: Directions, *, from_stroma: bool) -> Roof:
    """The ABL of optical depth `depth` along directions, seen from the stroma or the aqueous
    humour.
    """
    near, far = (d.top, d.surface) if from_stroma else (d.surface, d.top)
    t, lost = survival(depth, d.abl_cosine), attenuation(depth, d.abl_cosine)
    inside = visit(t, lost, near, far)
    return Roof(
        reflected=near[1] * inside.back,  # beyond the first interface's own reflectance
        passed=near[1] * inside.out,
        absorbed=near[1] * inside.absorbed,
    )


def split(tree, sets):
    """What belongs to each set of directions, of arrays over all of them."""
    ends = np.cumsum([d.cosine.size for d in sets])[:-1].tolist()
    leaves, structure = jax.tree.flatten(tree)
    return [
        jax.tree.unflatten(structure, x)
        for x in zip(*(jnp.split(x, ends, axis=-1) for x in leaves), strict=True)
    ]
