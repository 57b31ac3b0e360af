"""Cornea and white of an eye as stacks of truncated cones  [L03 Section 3.1, Figs. 6, 7]."""

from typing import NamedTuple

import jax.numpy as jnp

from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import check_whole
from irisjax.ocularist.cones import Cones


class Shell(NamedTuple):
    """`cornea`: its front, from the apex to the limbus; `white`: on from there to the eye's back.

    Between circles cones lie within the surface, by R (1 − cos(δ/2)) at most for circles that are δ
    apart as seen from its centre.
    """

    cornea: Cones
    white: Cones


def shell(eye: Eye, circles: int = 64) -> Shell:
    """The cross-section of an eye's outside, drawn as the paper draws it; `circles` of each part.

    With `prosthesis`: spheres of 7.8 and 11.5 mm, their centres 4.7 mm apart  [L03 Fig. 6].

    **Raises:** `ValueError` for an eye without cornea or white, and for fewer than two circles.
    """
    if eye.cornea is None or eye.sclera is None:
        raise ValueError("an eye without cornea or white has no shell")
    check_whole("circles", circles, 2)
    rim, wide = eye.limbus_radius, eye.sclera.radius
    front = rim * jnp.linspace(0, 1, circles)
    cornea = Cones(eye.cornea.anterior.sagitta(front), front)
    begin = jnp.arcsin(rim / wide)
    turn = begin + (jnp.pi - begin) * jnp.linspace(0, 1, circles)
    middle = cornea.z[-1] + wide * jnp.cos(begin)
    behind = jnp.maximum(wide * jnp.sin(turn), 0.0)  # at the back pole a rounding below 0
    return Shell(cornea, Cones(middle - wide * jnp.cos(turn), behind))
