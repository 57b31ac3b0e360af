"""Directions in the stroma with the interfaces along each, and Rayleigh's modes in azimuth."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.numerics.quadrature import conserving, cosine_rule, quadratic_rule
from irisjax.numerics.roots import safe_sqrt, share_of
from irisjax.optics.fresnel import Shares, critical_cosine_squared, fresnel, refract, refracted
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light, beams_of
from irisjax.transport.process import attenuation, reflections, survival


class Mode(NamedTuple):
    """One azimuthal order of Rayleigh's phase function: J(μ) = ω Σ_k strength_k f_k(μ) ∫ f_k I
    dμ'.
    """

    order: int
    parity: int
    strength: tuple[float, ...]

    def functions(self, mu: jax.Array) -> jax.Array:
        """f_k at cosines `mu` > 0, shape (rank, angles); at −μ they take the sign `parity`."""
        sine_squared = jnp.maximum(1 - mu * mu, 0.0)
        if self.order == 0:
            return jnp.stack([jnp.ones_like(mu), 1.5 * mu * mu - 0.5])
        if self.order == 1:
            return (mu * jnp.sqrt(sine_squared))[None]
        return sine_squared[None]


MODES = (Mode(0, 1, (0.5, 0.25)), Mode(1, -1, (0.375,)), Mode(2, 1, (0.09375,)))
Law: TypeAlias = Callable[..., tuple[jax.Array, ...]]
"""A law of interfaces, with the arguments of `optics.fresnel.fresnel`."""


class Ordinates(NamedTuple):
    """Directions in the stroma and the interfaces that light along each meets, shape (angles,).

    `top`, `surface`, `bottom` and `behind` are results of the law of the interfaces, such as
    reflectance and transmittance. The last three fields are `None` over a black epithelium. After
    `over_epithelium`, `bottom` includes the whole epithelium, and `through` is the share of the
    light that enters it for good and leaves it behind.
    """

    cosine: jax.Array
    weight: jax.Array
    abl_cosine: jax.Array
    top: Any  # stroma/ABL
    surface: Any  # ABL/aqueous
    bottom: Any  # stroma/IPE
    ipe_cosine: Any = None
    behind: Any = None  # IPE/aqueous
    through: jax.Array | None = None


class BeamsAndExits(NamedTuple):
    """The light on the iris, and the directions that it is observed from.

    `outside` and `power` are the cosines of the beams in the aqueous humour and their shares of the
    light; `exits` and `azimuth` may be `None`; `to_brdf` is the BRDF of radiance 1 that passes out.
    """

    beams: Any
    outside: jax.Array
    power: jax.Array
    exits: Any
    azimuth: Any
    to_brdf: jax.Array


class Absorber(NamedTuple):
    """Shares of the flux on a layer that absorbs without scattering, such as the ABL.

    `reflected` does not include the reflectance of its first interface.
    """

    reflected: jax.Array
    passed: jax.Array
    absorbed: jax.Array


def quadrature_nodes(layers: Layers, n_angles: int, law: Law = fresnel) -> Ordinates:
    """Directions in the stroma that a quadrature takes, split at its critical angles; `law` of the
    interfaces as in `optics.fresnel`.
    """
    n = layers.indices
    neighbours, critical, possible = _critical(layers)
    rule = conserving(cosine_rule(critical, possible, n_angles))
    cosines = [refracted(rule, i, n.stroma, k) for i, k in enumerate(neighbours)]
    return _ordinates(layers, law, rule.cosine, rule.weight, *cosines)


def gauss_nodes(layers: Layers, n_angles: int) -> Ordinates:
    """Directions in the stroma of a quadrature made for polynomials of the cosine, split at its
    critical angles.
    """
    n = layers.indices
    neighbours, critical, possible = _critical(layers)
    cosine, weight = quadratic_rule(safe_sqrt(critical), possible, n_angles)
    cosines = [refract(cosine, n.stroma, k) for k in neighbours]
    return _ordinates(layers, fresnel, cosine, weight, *cosines)


def from_outside(layers: Layers, outside: jax.Array, law: Law = fresnel) -> Ordinates:
    """Directions with given cosines in the aqueous humour; they carry no quadrature weight."""
    n = layers.indices
    abl, stroma, ipe = (refract(outside, n.aqueous, k) for k in (n.abl, n.stroma, n.ipe))
    return _ordinates(layers, law, stroma, jnp.zeros_like(outside), outside, abl, ipe)


def beams_and_exits(
    layers: Layers,
    light: Light,
    n_beams: int,
    interfaces: int = 3,
    ordinates: Callable[..., Any] = from_outside,
) -> BeamsAndExits:
    """Beams, for diffuse light `n_beams` as in `beams_of`, and exits; `ordinates` makes directions
    of layers and of cosines in the aqueous humour.
    """
    n = layers.indices
    outside, power = beams_of(light, n_beams, n, layers.extinction.dtype, interfaces)
    exits = azimuth = None
    if light.exits is not None:
        exits, azimuth = ordinates(layers, light.exits.cosine), light.exits.azimuth
    to_brdf = (n.aqueous / n.stroma) ** 2 / (2 * jnp.pi)
    return BeamsAndExits(ordinates(layers, outside), outside, power, exits, azimuth, to_brdf)


def abl_shares(depth: jax.Array, d: Ordinates, *, from_stroma: bool = True) -> Absorber:
    """Shares of light that meets an ABL of this optical depth from the stroma, or else from the
    aqueous humour.
    """
    near, far = (d.top, d.surface) if from_stroma else (d.surface, d.top)
    return _absorber(depth, d.abl_cosine, near, far)


def over_epithelium(ipe: jax.Array | None, d: Any) -> Any:
    """Directions over a pigment epithelium of optical depth `ipe`; the same ones over a black
    epithelium (`None`).
    """
    if ipe is None or d is None:
        return d
    layer = _absorber(ipe, d.ipe_cosine, d.bottom, d.behind)
    entry = layer.passed + layer.absorbed
    return d._replace(
        bottom=(d.bottom[0] + layer.reflected, entry),
        through=share_of(layer.passed, entry, 0.0),
    )


def _absorber(depth: jax.Array, cosine: jax.Array, near: Any, far: Any) -> Absorber:
    t, loss = survival(depth, cosine), attenuation(depth, cosine)
    series, trapped = reflections(t, loss, near, far)
    # What can neither leave nor be absorbed counts as absorbed, the limit of least absorption.
    absorbed = jnp.where(trapped, 1.0, loss * (1 + t * far[0]) * series)
    reflected, transmitted = t * t * far[0] * near[1] * series, t * far[1] * series
    return Absorber(near[1] * reflected, near[1] * transmitted, near[1] * absorbed)


def boundaries(abl: Absorber, d: Ordinates) -> tuple[Shares, Shares]:
    """Shares that the upper and the lower boundary of the stroma reflect and pass along directions;
    `abl`: those of the ABL, from the stroma.
    """
    return (d.top[0] + abl.reflected, abl.passed + abl.absorbed), d.bottom


def join_sets(*sets: Any) -> Any:
    """Join several sets of directions, so that one fused loop serves all; sets may be `None`."""
    present = [d for d in sets if d is not None]
    return jax.tree.map(lambda *x: jnp.concatenate(x, axis=-1), *present)


def split_sets(tree: Any, *sets: Any) -> list[Any]:
    """Split arrays over joined sets into those of each set: the inverse of `join_sets`."""
    ends = np.cumsum([d.cosine.size for d in sets if d is not None])[:-1].tolist()
    leaves, structure = jax.tree.flatten(tree)
    parts = zip(*(jnp.split(x, ends, axis=-1) for x in leaves), strict=True)
    return [jax.tree.unflatten(structure, x) for x in parts]


def _critical(layers: Layers):
    """Indices of the media beyond the stroma, squares of its critical cosines to them, and whether
    there may be one.
    """
    n, order = layers.indices, layers.order
    neighbours = (n.aqueous, n.abl, n.ipe)
    critical = jnp.stack([critical_cosine_squared(n.stroma, k) for k in neighbours])
    return neighbours, critical, (True, order.stroma_over_abl, order.stroma_over_ipe)


def _ordinates(layers: Layers, law, stroma, weight, aqueous, abl, ipe) -> Ordinates:
    # One call for all interfaces: a third of the program.
    n, deep = layers.indices, layers.ipe_absorption is not None
    inside, outside = (stroma, abl, stroma, ipe), (abl, aqueous, ipe, aqueous)
    indices = (n.stroma, n.abl, n.stroma, n.ipe), (n.abl, n.aqueous, n.ipe, n.aqueous)
    count = 4 if deep else 3
    inside, outside, *indices = (jnp.stack(x[:count]) for x in (inside, outside, *indices))
    faces = law(inside, outside, *(x[:, None] for x in indices))
    top, surface, bottom, *behind = (jax.tree.map(lambda x, k=k: x[k], faces) for k in range(count))
    return Ordinates(
        # A beam that cannot enter has cosine 0 and no power; keep the exponentials finite.
        cosine=jnp.where(stroma > 0, stroma, 1.0),
        weight=weight,
        abl_cosine=jnp.where(abl > 0, abl, 1.0),
        top=top,
        surface=surface,
        bottom=bottom,
        ipe_cosine=jnp.where(ipe > 0, ipe, 1.0) if deep else None,
        behind=behind[0] if deep else None,
    )
