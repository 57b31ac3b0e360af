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
    joined_sets,
    over_epithelium,
    parted,
)
from irisjax.transport.radiative.slab import Bounded, Images, Slab


class PolarisedOrdinates(NamedTuple):
    """Directions in the stroma with the interfaces as I_l, polarised in the plane of incidence
    (`p`), as I_r, across it (`s`), and as W meet them (`w` has `Coherence`s for them).
    """

    p: Ordinates
    s: Ordinates
    w: Ordinates


class Met(NamedTuple):
    """The slab and the ABL for light along directions.

    Attributes:
        linear: Depth polynomials of the slab for I_l and I_r, one after the other.
        real, imaginary: Depth polynomials for W, with the real and imaginary parts of its images.
        upper: The ABL for I_l and I_r, one after the other.
        turned: Share of W that passes the ABL, complex.
    """

    linear: Bounded
    real: Bounded
    imaginary: Bounded
    upper: Absorber
    turned: jax.Array


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
    whole = turning_layer(ipe, d.w.ipe_cosine, d.w.bottom, d.w.behind)
    p, s = over_epithelium(ipe, d.p), over_epithelium(ipe, d.s)
    return PolarisedOrdinates(p, s, d.w._replace(bottom=whole))


def meet(slab: Slab, abl: jax.Array, *sets: PolarisedOrdinates | None) -> list[Met]:
    """`Met` of each of some sets of directions; sets may be `None`."""
    d = joined_sets(*sets)
    both = joined_sets(d.p, d.s)
    upper = abl_shares(abl, both)
    turning = turning_layer(abl, d.w.abl_cosine, d.w.top, d.w.surface)
    of_w = _turning_images(slab.depth, d.w, turning)
    along = slab.imaged(d.p.cosine, of_w)
    linear = slab.images(both.cosine, *boundaries(upper, both))
    apart = jax.tree.map(lambda x: x.reshape(2, -1), (linear, upper))
    found = []
    for x in parted((along, apart, turning.passed), *(s and s.p for s in sets)):
        along, of_both, turned = x
        linear, upper = jax.tree.map(jnp.ravel, of_both)
        real, imaginary = (
            along._replace(images=jax.tree.map(part, along.images)) for part in (jnp.real, jnp.imag)
        )
        found.append(
            Met(joined_sets(real, real)._replace(images=linear), real, imaginary, upper, turned)
        )
    return found


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
    gone = attenuation(2 * depth, cosine)
    series = _series(gone, twice, near, far)
    passed, contrast = _complex(near.passed), _complex(near.contrast)
    once = _complex(gone) + twice * far.lost
    reflected = near.reflected + passed * passed * twice * far.reflected * series
    lost = series * (near.lost * once + twice * far.reflected * contrast * contrast)
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
    met: Met,
    outside: jax.Array,
    n: RefractiveIndices,
) -> tuple[jax.Array, jax.Array]:
    """Compute the W of beams (cosines `outside` in the aqueous humour) that the first surface and
    the inner interfaces reflect without scattering; `met` describes the layers for the beams.
    """
    inside = refract(outside, n.aqueous, n.abl)
    first = coherence(outside, inside, n.aqueous, n.abl)
    under = coherence(inside, refract(outside, n.aqueous, n.stroma), n.abl, n.stroma)
    twice = _complex(survival(2 * abl, d.abl_cosine))
    series = _series(attenuation(2 * abl, d.abl_cosine), twice, d.surface, under)
    entered = _complex(first.passed)
    back = entered * entered * twice * under.reflected * series
    below = lax.complex(met.real.images.bottom, met.imaginary.images.bottom)
    again = met.turned * met.turned * _complex(survival(2 * depth, d.cosine)) * below
    return first.reflected, back + again


def _series(gone, twice, near, far):
    """1/(1 − t² ρ ρ') without cancellation, 0 where nothing is ever lost."""
    lost = _complex(gone) + twice * (near.lost + near.reflected * far.lost)
    sealed = (jnp.real(lost) == 0) & (jnp.imag(lost) == 0)
    one = lax.complex(jnp.ones_like(gone), jnp.zeros_like(gone))
    return jnp.where(sealed, 0 * one, one / jnp.where(sealed, one, lost))


def _complex(x):
    return lax.complex(x, jnp.zeros_like(x))
