"""Interfaces of the layers for polarised light: I_l, I_r and W = (U + iV)/√2.

No interface couples these three; total reflection turns U into V, which is a phase of W.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from irisjax.optics.fresnel import Coherence, coherence, fresnel_p, fresnel_s, refract
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.directions import (
    Absorber,
    Ordinates,
    abl_shares,
    boundaries,
    join_sets,
    over_epithelium,
    split_sets,
)
from irisjax.transport.radiative.slab import Bounded, Images, Slab


class PolarisedOrdinates(NamedTuple):
    """Directions in the stroma with the interfaces as I_l, polarised in the plane of incidence
    (`p`), as I_r, across it (`s`), and as W meet them (`w` has `Coherence`s for them).
    """

    p: Ordinates
    s: Ordinates
    w: Ordinates


class Passage(NamedTuple):
    """The slab and the ABL for light along directions.

    Attributes:
        linear: Depth polynomials of the slab for I_l and I_r, one after the other.
        real, imaginary: Depth polynomials for W, with the real and imaginary parts of its images.
        upper: The ABL for I_l and I_r, one after the other.
        w_passed: Share of W that passes the ABL, complex.
    """

    linear: Bounded
    real: Bounded
    imaginary: Bounded
    upper: Absorber
    w_passed: jax.Array


def polarised(make: Callable[..., Ordinates], *where: object) -> PolarisedOrdinates:
    """`PolarisedOrdinates` of `quadrature_nodes` or `from_outside`."""
    d = make(*where, lambda *x: (fresnel_p(*x), fresnel_s(*x), coherence(*x)))
    return PolarisedOrdinates(
        *(
            d._replace(**{i: getattr(d, i)[k] for i in _INTERFACES if getattr(d, i) is not None})
            for k in range(3)
        )
    )


_INTERFACES = ("top", "surface", "bottom", "behind")


def over_polarised(ipe: jax.Array | None, d: PolarisedOrdinates | None) -> Any:
    """`over_epithelium` of polarised directions; sets may be `None`."""
    if ipe is None or d is None:
        return d
    layer = turning_layer(ipe, d.w.ipe_cosine, d.w.bottom, d.w.behind)
    p, s = over_epithelium(ipe, d.p), over_epithelium(ipe, d.s)
    return PolarisedOrdinates(p, s, d.w._replace(bottom=layer))


def passages(slab: Slab, abl: jax.Array, *sets: PolarisedOrdinates | None) -> list[Passage]:
    """`Passage` of each of some sets of directions; sets may be `None`."""
    d = join_sets(*sets)
    linear_set = join_sets(d.p, d.s)
    upper = abl_shares(abl, linear_set)
    turning = turning_layer(abl, d.w.abl_cosine, d.w.top, d.w.surface)
    of_w = _turning_images(slab.depth, d.w, turning)
    paths = slab.imaged(d.p.cosine, of_w)
    linear = slab.images(linear_set.cosine, *boundaries(upper, linear_set))
    pairs = jax.tree.map(lambda x: x.reshape(2, -1), (linear, upper))
    results = []
    for x in split_sets((paths, pairs, turning.passed), *(s and s.p for s in sets)):
        paths, pair, w_passed = x
        linear, upper = jax.tree.map(jnp.ravel, pair)
        real, imaginary = (
            paths._replace(images=jax.tree.map(part, paths.images)) for part in (jnp.real, jnp.imag)
        )
        results.append(
            Passage(join_sets(real, real)._replace(images=linear), real, imaginary, upper, w_passed)
        )
    return results


class TurningLayer(NamedTuple):
    """ABL or IPE seen from the stroma, for W: what it reflects, 1 less that, and what passes it."""

    reflected: jax.Array
    lost: jax.Array
    passed: jax.Array


def turning_layer(
    depth: jax.Array, cosine: jax.Array, near: Coherence, far: Coherence
) -> TurningLayer:
    """`TurningLayer` of this optical depth along cosines in it, between its near and its far
    face.
    """
    through, twice = (_complex(survival(x, cosine)) for x in (depth, 2 * depth))
    loss = attenuation(2 * depth, cosine)
    series = _series(loss, twice, near, far)
    passed, contrast = _complex(near.passed), _complex(near.contrast)
    round_trip = _complex(loss) + twice * far.lost
    reflected = near.reflected + passed * passed * twice * far.reflected * series
    lost = series * (near.lost * round_trip + twice * far.reflected * contrast * contrast)
    # Light that its near face reflects totally does not enter the layer.
    total = near.passed == 0
    return TurningLayer(
        reflected=jnp.where(total, near.reflected, reflected),
        lost=jnp.where(total, near.lost, lost),
        passed=passed * through * _complex(far.passed) * series,
    )


def _turning_images(depth, d: Ordinates, upper: TurningLayer) -> Images:
    through, twice = survival(depth, d.cosine), survival(2 * depth, d.cosine)
    series = _series(attenuation(2 * depth, d.cosine), _complex(twice), upper, d.bottom)
    lower = d.bottom.reflected
    across = upper.reflected * series * lower * _complex(through)
    return Images(series, upper.reflected * series, across, lower * series)


def unscattered(
    abl: jax.Array,
    depth: jax.Array,
    d: Ordinates,
    path: Passage,
    outside: jax.Array,
    n: RefractiveIndices,
) -> tuple[jax.Array, jax.Array]:
    """Compute the W of beams (cosines `outside` in the aqueous humour) that the first surface and
    the inner interfaces reflect without scattering; `path` describes the layers for the beams.
    """
    inside = refract(outside, n.aqueous, n.abl)
    surface = coherence(outside, inside, n.aqueous, n.abl)
    inner = coherence(inside, refract(outside, n.aqueous, n.stroma), n.abl, n.stroma)
    twice = _complex(survival(2 * abl, d.abl_cosine))
    series = _series(attenuation(2 * abl, d.abl_cosine), twice, d.surface, inner)
    transmission = _complex(surface.passed)
    abl_image = transmission * transmission * twice * inner.reflected * series
    below = lax.complex(path.real.images.bottom, path.imaginary.images.bottom)
    stroma_image = path.w_passed * path.w_passed * _complex(survival(2 * depth, d.cosine)) * below
    return surface.reflected, abl_image + stroma_image


def _series(loss, twice, near, far):
    """1/(1 − t² ρ ρ') without cancellation, 0 where nothing is ever lost."""
    escape = _complex(loss) + twice * (near.lost + near.reflected * far.lost)
    trapped = (jnp.real(escape) == 0) & (jnp.imag(escape) == 0)
    unit = lax.complex(jnp.ones_like(loss), jnp.zeros_like(loss))
    return jnp.where(trapped, 0 * unit, unit / jnp.where(trapped, unit, escape))


def _complex(x):
    return lax.complex(x, jnp.zeros_like(x))
