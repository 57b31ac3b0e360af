"""A painting in plan view: from straight ahead, lit from there, without cornea and parallax.

Textures of an iris are polar as in `IrisMaps`: rows are angles from +x towards +y, columns radii
from the pupil's edge to the root.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from irisjax.anatomy.eye import Eye
from irisjax.measure.colour import lab_of_srgb
from irisjax.numerics.checks import check_whole
from irisjax.ocularist.coats import Painting, over, through
from irisjax.ocularist.integrator import look_up
from irisjax.tissue.maps import cell_centres, texels

TEXTURE_SHAPE = (256, 64)
"""Angles and radii of textures by default."""


_Places = Int[np.ndarray, "size size"]


class Difference(NamedTuple):
    """Colour difference of two textures, CIE 1976 ΔE*ab under D65; a reflectance of 1 is white.

    Attributes:
        mean: Over the texels.
        q95: The value that 95 % of the texels stay below.
    """

    mean: float
    q95: float


@eqx.filter_jit
def plan_view(
    opacity: Float[Array, "coats *texels"], colour: Float[Array, "coats 3"]
) -> Float[Array, "*texels 3"]:
    """Linear reflectance of coats, the bottom one first, each lit through those above it; black
    where all are clear. Differentiable.
    """
    coats = opacity.reshape(len(opacity), -1, 1), colour[:, None, :]
    light = jnp.ones((coats[0].shape[1], 3), jnp.result_type(opacity, colour))
    _, lights = jax.lax.scan(
        lambda lit, coat: (through(lit, *coat), lit), light, coats, reverse=True
    )
    behind = jnp.zeros_like(light)
    seen, _ = jax.lax.scan(lambda seen, coat: (over(seen, *coat), None), behind, (*coats, lights))
    return seen.reshape(*opacity.shape[1:], 3)


def texture_of(
    painting: Painting, eye: Eye, shape: tuple[int, int] = TEXTURE_SHAPE
) -> Float[Array, "angles radii 3"]:
    """A painting's plan view on the iris of an eye, linear reflectance.

    Raises:
        ValueError: for a painting without coats and for a shape below 2 × 2.
    """
    if not painting.coats:
        raise ValueError("a painting without coats has no colours")
    opacity = jnp.stack([unrolled(coat.opacity, eye, shape) for coat in painting.coats])
    return plan_view(opacity, jnp.stack([coat.colour for coat in painting.coats]))


@eqx.filter_jit
def unrolled(
    picture: Float[Array, "rows columns"], eye: Eye, shape: tuple[int, int] = TEXTURE_SHAPE
) -> Float[Array, "angles radii"]:
    """A square picture of an iris seen from ahead, whose sides touch the root, as a polar texture
    between pupil and root; row 0 of the picture is at the top.

    Raises:
        ValueError: for a picture that is not square, and for a shape below 2 × 2.
    """
    for name, number in zip(("angles", "radii"), shape, strict=True):
        check_whole(name, number, 2)
    if picture.shape[0] != picture.shape[1] or len(picture) < 2:
        raise ValueError(f"a picture of an iris has shape {picture.shape}; it must be square")
    angle, radius = (c.astype(picture.dtype) for c in cell_centres(shape))
    away = eye.from_axis(radius).astype(picture.dtype)
    x, y = jnp.outer(jnp.cos(angle), away), jnp.outer(jnp.sin(angle), away)
    return look_up(picture, x, y, eye.iris_radius)


def rolled(
    shape: tuple[int, ...], eye: Eye, size: int
) -> tuple[_Places, _Places, Bool[np.ndarray, "size size"]]:
    """The inverse of `unrolled`: for each texel of a square picture the row and column of the
    nearest texel of a polar texture of this shape, and whether it lies on the iris.
    """
    rows, columns = shape
    x, y = (v * float(eye.iris_radius) for v in texels(size))
    place = np.asarray(eye.relative_radius(np.hypot(x, y)))
    row = np.floor(np.arctan2(y, x) * (rows / (2 * np.pi))).astype(int) % rows
    column = np.clip(np.floor(place * columns), 0, columns - 1).astype(int)
    return row, column, (place >= 0) & (place <= 1)


def difference(
    one: Float[Array | np.ndarray, "*s 3"],
    other: Float[Array | np.ndarray, "*s 3"],
    known: Bool[np.ndarray, "*s"] | None = None,
) -> Difference:
    """Colour difference of two textures of linear reflectance, over the texels that are `known`."""
    off = np.asarray(_delta(one, other))
    off = off.ravel() if known is None else off[np.asarray(known)]
    return Difference(float(off.mean()), float(np.quantile(off, 0.95)))


@eqx.filter_jit
def _delta(one, other):
    return jnp.sqrt(((lab_of_srgb(one) - lab_of_srgb(other)) ** 2).sum(-1))
