"""Internal reflections of a ray in a layer: a geometric series, written without cancellation."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array


class Fates(NamedTuple):
    """Shares of a ray that has entered a layer: out at the far face, back out at the near one,
    absorbed in it. They sum to one.
    """

    out: Array
    back: Array
    absorbed: Array


def reflections(t, lost, near, far) -> tuple[Array, Array]:
    """1/(1 − t² F F'), the sum over all mirror reflections at one cosine, and whether none escapes.

    `t` is the survival of one crossing and `lost` = 1 − t; `near` and `far` are (reflectance,
    transmittance) of the two faces. The denominator is a sum of losses, so that nothing cancels
    where little is lost; a ray that never leaves has the sum 0.
    """
    escape = lost * (1 + t) + t * t * (near[1] + near[0] * far[1])
    sealed = escape <= 0
    return jnp.where(sealed, 0.0, 1 / jnp.where(sealed, 1.0, escape)), sealed


def visit(t, lost, near, far) -> Fates:
    """Where a ray ends that keeps its cosine and has entered through the near face.

    One that can neither leave nor be absorbed counts as absorbed, the limit of least absorption.
    """
    series, sealed = reflections(t, lost, near, far)
    absorbed = jnp.where(sealed, 1.0, lost * (1 + t * far[0]) * series)
    return Fates(t * far[1] * series, t * t * far[0] * near[1] * series, absorbed)
