"""What light meets at the layers' interfaces: I_l and I_r by themselves, W = (U + iV)/√2 turned.

No interface couples these three; total reflection turns U into V, which is a phase of W.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from irisjax.optics.fresnel import coherence, fresnel_p, fresnel_s, refract
from irisjax.tissue.indices import RefractiveIndices
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.directions import Ordinates, ends_of, roof_of
from irisjax.transport.radiative.slab import Bounded, Images, Slab


class PolarisedOrdinates(NamedTuple):
    """Directions in the stroma with the interfaces as I_l, polarised in the plane of incidence
    (`p`), as I_r, across it (`s`), and as W meet them (`w` has `Coherence`s for them).
    """

    p: Ordinates
    s: Ordinates
    w: Ordinates


class Met(NamedTuple):
    """The slab's depth polynomials along directions: of I_l and I_r, one after the other, and of W
    with the real and the imaginary parts of its images.
    """

    linear: Bounded
    real: Bounded
    imaginary: Bounded


def polarised(make: Callable, *where: Any) -> PolarisedOrdinates:
    """`PolarisedOrdinates` of `quadrature_nodes` or `from_outside`."""
    return PolarisedOrdinates(*(make(*where, law) for law in (fresnel_p, fresnel_s, coherence)))


def meet(slab: Slab, abl: jax.Array, d: PolarisedOrdinates) -> tuple[Bounded, ...]:
    """The slab along directions as I_l, I_r and W (real part, imaginary part) meet it."""
    of_l, of_r = (slab.images(x.cosine, ends_of(roof_of(abl, x), x)) for x in (d.p, d.s))
    of_w = _turning_images(slab.depth, abl, d.w)
    along = slab.imaged(d.p.cosine, of_l)
    return (
        along,
        along._replace(images=of_r),
        along._replace(images=jax.tree.map(jnp.real, of_w)),
        along._replace(images=jax.tree.map(jnp.imag, of_w)),
    )


class TurningRoof(NamedTuple):
    """The ABL seen from the stroma, for W: what it reflects, 1 less that, and what passes it."""

    reflected: jax.Array
    lost: jax.Array
    passed: jax.Array


def turning_roof(abl: jax.Array, d: Ordinates) -> TurningRoof:
    """`TurningRoof` of an ABL of this optical depth along directions `PolarisedOrdinates.w`."""
    top, above = d.top, d.surface
    through, twice = (_complex(survival(x, d.abl_cosine)) for x in (abl, 2 * abl))
    gone = attenuation(2 * abl, d.abl_cosine)
    series = _series(gone, twice, top, above)
    passed, contrast = _complex(top.passed), _complex(top.contrast)
    once = _complex(gone) + twice * above.lost
    reflected = top.reflected + passed * passed * twice * above.reflected * series
    lost = series * (top.lost * once + twice * above.reflected * contrast * contrast)
    # Where all is reflected, the ABL is not seen.
    total = top.passed == 0
    return TurningRoof(
        reflected=jnp.where(total, top.reflected, reflected),
        lost=jnp.where(total, top.lost, lost),
        passed=passed * through * _complex(above.passed) * series,
    )


def _turning_images(depth, abl, d: Ordinates) -> Images:
    roof = turning_roof(abl, d)
    through, twice = survival(depth, d.cosine), survival(2 * depth, d.cosine)
    series = _series(attenuation(2 * depth, d.cosine), _complex(twice), roof, d.bottom)
    floor = d.bottom.reflected
    across = roof.reflected * series * floor * _complex(through)
    return Images(series, roof.reflected * series, across, floor * series)


def unscattered(
    abl: jax.Array, depth: jax.Array, d: Ordinates, outside: jax.Array, n: RefractiveIndices
) -> tuple[jax.Array, jax.Array]:
    """Of W of beams with cosines `outside` in the aqueous humour: what the first surface reflects,
    and what the inner interfaces do.
    """
    inside = refract(outside, n.aqueous, n.abl)
    first = coherence(outside, inside, n.aqueous, n.abl)
    under = coherence(inside, refract(outside, n.aqueous, n.stroma), n.abl, n.stroma)
    twice = _complex(survival(2 * abl, d.abl_cosine))
    series = _series(attenuation(2 * abl, d.abl_cosine), twice, d.surface, under)
    entered = _complex(first.passed)
    back = entered * entered * twice * under.reflected * series
    passed = turning_roof(abl, d).passed
    below = _turning_images(depth, abl, d)
    again = passed * passed * _complex(survival(2 * depth, d.cosine)) * below.bottom
    return first.reflected, back + again


def _series(gone, twice, near, far):
    """1/(1 − t² ρ ρ') without cancellation, 0 where nothing is ever lost."""
    lost = _complex(gone) + twice * (near.lost + near.reflected * far.lost)
    sealed = (jnp.real(lost) == 0) & (jnp.imag(lost) == 0)
    one = lax.complex(jnp.ones_like(gone), jnp.zeros_like(gone))
    return jnp.where(sealed, 0 * one, one / jnp.where(sealed, one, lost))


def _complex(x):
    return lax.complex(x, jnp.zeros_like(x))
