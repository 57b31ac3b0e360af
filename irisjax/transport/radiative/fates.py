"""Where light ends after its first scattering in the stroma, whatever the direction it came from.

What a beam does before it is scattered has a closed form; what follows is smooth in the depths,
the albedo and the direction, and is what tables of radiative transfer hold.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.numerics import linear
from irisjax.transport.process import attenuation, survival
from irisjax.transport.radiative.directions import MODES, Directions, Roof, roof_of
from irisjax.transport.radiative.slab import Bounded, Ends, Slab
from irisjax.transport.series import reflections


class Beam(NamedTuple):
    """Shares of light that falls on the iris, before any of it is scattered; shape (beams,).

    `mirrored` at the first surface; `reflected` by the inner interfaces and out again; `abl`,
    absorbed there; `lost` to the stroma, absorbed or scattered in it; `passed` into the IPE. They
    sum to one.
    """

    mirrored: jax.Array
    reflected: jax.Array
    abl: jax.Array
    lost: jax.Array
    passed: jax.Array


class Course(NamedTuple):
    """Of directions in the stroma, shape (angles,): the sum over all mirror images; the share that
    comes back from the slab's floor; what of light that enters is lost to the slab; the share that
    leaves through the ABL.
    """

    series: jax.Array
    back: jax.Array
    lost: jax.Array
    roof: Roof


class ScatteredFates(NamedTuple):
    """Of light scattered once: shares that leave the iris and that end in the ABL and in the IPE,
    and the mean number of times that it collides again; shape (beams,).
    """

    out: jax.Array
    abl: jax.Array
    ipe: jax.Array
    collisions: jax.Array


def before(abl, depth, beams: Directions) -> Beam:
    """Of beams through an ABL and a stroma of these optical depths.

    The mirror images of both layers' faces are geometric series.
    """
    roof_in = roof_of(abl, beams, from_stroma=False)
    through, way = survival(depth, beams.cosine), course(abl, depth, beams)
    down = roof_in.passed * way.series
    up = down * through * way.back
    return Beam(
        mirrored=beams.surface[0],
        reflected=roof_in.reflected + up * way.roof.passed,
        abl=roof_in.absorbed + up * way.roof.absorbed,
        lost=roof_in.passed * way.lost,
        passed=down * through * beams.bottom[1],
    )


def course(abl, depth, d: Directions) -> Course:
    """`Course` of directions between the ends of a stroma under an ABL of these optical depths."""
    roof = roof_of(abl, d, from_stroma=True)
    through, gone = survival(depth, d.cosine), attenuation(depth, d.cosine)
    above = d.top[0] + roof.reflected, roof.passed + roof.absorbed
    series, _ = reflections(through, gone, above, d.bottom)
    back = through * d.bottom[0]
    return Course(series, back, series * gone * (1 + back), roof)


def after(abl, depth, albedo, nodes: Directions, beams: Directions, n_depths: int, n_panels: int):
    """`ScatteredFates` of the light that each of some beams has scattered once, of one wavelength.

    `albedo` may exceed 1 by a little: the sum over orders of scattering goes on converging as long
    as light leaves the slab faster.
    """
    slab, mode = Slab(depth, n_depths, n_panels), MODES[0]
    strength = jnp.asarray(mode.strength, depth.dtype)
    roof, lost = course(abl, depth, nodes).roof, course(abl, depth, beams).lost
    angle, beam = (met(slab, abl, d) for d in (nodes, beams))
    f_nodes, f_beams = mode.functions(nodes.cosine), mode.functions(beams.cosine)
    operator = slab.moments(angle, nodes.weight, f_nodes, mode.parity)
    operator = operator * jnp.repeat(strength, operator.shape[0] // strength.size)[None, :]
    each = slab.driving_each(beam, mode.parity) / (beams.cosine * lost)[None]
    driving = f_beams[:, None] * each[None]
    driving = driving.reshape(-1, beams.cosine.size)
    first = linear.solve(jnp.eye(driving.shape[0], dtype=depth.dtype) - albedo * operator, driving)
    again = (operator @ first).reshape(strength.size, n_panels, n_depths, -1)[0, :, 0]
    top, bottom = slab.leaving_each(angle, mode.parity)
    flux = strength[:, None] * f_nodes * (nodes.weight * nodes.cosine)[None, :]

    def share(leaving, taken):
        return ((flux * taken[None, :]) @ leaving.T).ravel() @ first

    return ScatteredFates(
        out=share(top, roof.passed),
        abl=share(top, roof.absorbed),
        ipe=share(bottom, nodes.bottom[1]),
        collisions=slab.widths @ again,
    )


def met(slab: Slab, abl, d: Directions) -> Bounded:
    """The slab's depth polynomials along directions, its roof the ABL."""
    roof = roof_of(abl, d, from_stroma=True)
    ends = Ends(d.top[0] + roof.reflected, roof.passed + roof.absorbed, *d.bottom)
    return slab.bounded(d.cosine, ends)
