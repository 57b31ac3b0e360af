"""What a component of a painted coat is: parameters that draw an opacity map from a key.

Extents along a radius are in relative radii, from 0, the pupil's edge, to 1, the root; those across
are in outer radii of the iris.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float32

from irisjax._types import PRNGKey
from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.ocularist.strokes import Opacity, Ring

LIMITS = {
    "inner": Range(0, 1, meaning="relative radius from which strokes or dots cover the iris"),
    "outer": Range(0, 1, meaning="relative radius up to which they do"),
    "length": Range(0, 1, meaning="median length, relative radii"),
    "width": Range(0.001, 0.3, meaning="median width, outer radii"),
    "reach": Range(0.01, 1, meaning="extent of a ring, relative radii"),
    "softness": Range(0.002, 0.2, meaning="standard deviation of the brush's edge, outer radii"),
    "waviness": Range(0, 1, meaning="how far strokes sway"),
    "irregularity": Range(0, 1, meaning="how unlike strokes, dots and their distances are"),
}
"""Allowed range of each parameter but `count`, the number of strokes or dots."""
MOST_STROKES = 1500
PUPIL = Range(0.02, 0.95, meaning="radius of the pupil over the outer one of the iris")
SIZES = (2, 8192)
"""Fewest and most texels along a map's side."""


class AbstractComponent(eqx.Module):
    """A component is an immutable value: its parameters are its fields, all plain numbers.

    **Raises:** `ValueError` naming a parameter, its value and its range.
    """

    def __post_init__(self):
        for name, value in vars(self).items():
            check_parameter(name, value)
        inner, outer = getattr(self, "inner", 0), getattr(self, "outer", 1)
        if not inner < outer:
            raise ValueError(f"inner = {inner:g} is not below outer = {outer:g}")

    def opacity(self, size: int, pupil: float, *, key: PRNGKey) -> Opacity:
        """Opacity map, float32 of shape (size, size), 0 (clear) to 1 (opaque).

        Texel (i, j) stands at x = (2(j + ½)/size − 1)R, y = (1 − 2(i + ½)/size)R, with R the outer
        radius of the iris; `pupil` is that of the pupil over R. Equal keys give equal maps, and
        another size samples the same painting. Beyond the iris all is clear, but for two texels
        that interpolation at its edges finds.

        **Raises:** `ValueError` for a size or a pupil out of range.
        """
        check_whole("size", size, *SIZES)
        check_range("pupil", pupil, PUPIL)
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
        ring, radius = Ring(float(pupil)), np.hypot(*texels(size))
        painted = self.painted(rng, ring, radius)
        margin = 4 / size
        on = (radius <= 1 + margin) & (radius >= ring.pupil - margin)
        return np.where(on, np.clip(painted, 0, 1), 0).astype(np.float32)

    @abc.abstractmethod
    def painted(self, rng: np.random.Generator, ring: Ring, radius: Opacity) -> Opacity:
        """Opacity at texels of these radii, whatever it is beyond the iris."""


def setting(default: float) -> Any:
    """A parameter with this default."""
    return eqx.field(static=True, default=default)


def check_parameter(name: str, value: Any) -> None:
    """Raise `ValueError` unless a component's parameter is a number in its range."""
    if name == "count":
        check_whole(name, value, 0, MOST_STROKES)
    elif isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{name} = {value!r} is not a number")
    else:
        check_range(name, value, LIMITS[name])


def texels(size: int) -> tuple[Float32[np.ndarray, "1 size"], Float32[np.ndarray, "size 1"]]:
    """x and y of texels, in outer radii of the iris."""
    x = ((2 * np.arange(size) + 1) / size - 1).astype(np.float32)
    return x[None], -x[:, None]
