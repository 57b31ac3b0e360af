"""A painting in plan: seen from straight ahead, in light from there, without cornea and parallax.

Textures of an iris are polar as in `IrisMaps`: rows angles from +x towards +y, columns radii from
the pupil's edge to the root.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax.anatomy.eye import Eye
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of
from irisjax.numerics.checks import check_whole
from irisjax.ocularist.coats import Painting, over, through
from irisjax.ocularist.composite import look_up
from irisjax.tissue.maps import cell_centres

SHAPE = (256, 64)
"""Angles and radii of textures, unless something else is asked for."""


class Difference(NamedTuple):
    """Colour difference of two textures, CIE 1976 ΔE*ab under D65, a reflectance of 1 being white:
    `mean` over their texels, and what 95 % of them stay below.
    """

    mean: float
    most: float


def plan_view(
    opacity: Float[Array, "coats *texels"], colour: Float[Array, "coats 3"]
) -> Float[Array, "*texels 3"]:
    """Linear reflectance of coats, the bottom one first, each in the light that those above it let
    through; black where all are clear. Differentiable.
    """
    flat = opacity.reshape(len(opacity), -1, 1)
    paint = colour[:, None, :]
    light = jnp.ones((flat.shape[1], 3), jnp.result_type(opacity, colour))

    def down(light, coat):
        return through(light, *coat), light

    def up(behind, coat):
        return over(behind, *coat), None

    _, lights = jax.lax.scan(down, light, (flat, paint), reverse=True)
    seen, _ = jax.lax.scan(up, jnp.zeros_like(light), (flat, paint, lights))
    return seen.reshape(*opacity.shape[1:], 3)


def texture_of(
    painting: Painting, eye: Eye, shape: tuple[int, int] = SHAPE
) -> Float[Array, "angles radii 3"]:
    """A painting's plan view on the iris of an eye, linear reflectance.

    **Raises:** `ValueError` for a painting without coats and for a shape below 2 × 2.
    """
    if not painting.coats:
        raise ValueError("a painting without coats has no colours")
    opacity = jnp.stack([unrolled(coat.opacity, eye, shape) for coat in painting.coats])
    return plan_view(opacity, jnp.stack([coat.colour for coat in painting.coats]))


def unrolled(
    picture: Float[Array, "rows columns *channels"] | np.ndarray,
    eye: Eye,
    shape: tuple[int, int] = SHAPE,
    reach: float | None = None,
) -> Float[Array, "angles radii *channels"]:
    """A square picture of an iris seen from ahead, row 0 at the top, as a polar texture.

    Args:
        picture: One channel, or several last.
        eye: Whose pupil and root the texture runs between.
        shape: (angles, radii).
        reach: Distance of the picture's sides from the axis, mm; by default the root's, as opacity
            maps have it. A photograph's unrefracted texture has 6.

    Raises:
        ValueError: for a picture that is not square, and for a shape below 2 × 2.
    """
    for name, number in zip(("angles", "radii"), shape, strict=True):
        check_whole(name, number, 2)
    given = jnp.asarray(picture, jnp.result_type(float))
    if given.ndim not in (2, 3) or given.shape[0] != given.shape[1] or len(given) < 2:
        raise ValueError(f"a picture of an iris has shape {given.shape}; it must be square")
    side = eye.iris_radius if reach is None else jnp.asarray(reach, given.dtype)
    return _unrolled(given, eye, side, (int(shape[0]), int(shape[1])))


def rolled(texture, eye: Eye, size: int):
    """Indices (rows, columns) into a polar texture's nearest texels of a square picture's, and
    which of these lie on the iris.
    """
    rows, columns = np.shape(texture)[:2]
    along = ((2 * np.arange(size) + 1) / size - 1) * float(eye.iris_radius)
    x, y = along[None, :], -along[:, None]
    place = np.asarray(eye.relative_radius(np.hypot(x, y)))
    row = np.floor(np.arctan2(y, x) * (rows / (2 * np.pi))).astype(int) % rows
    column = np.clip(np.floor(place * columns), 0, columns - 1).astype(int)
    return row, column, (place >= 0) & (place <= 1)


def lab(linear: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """CIE L*a*b* under D65 of linear sRGB."""
    matrix = np.linalg.inv(XYZ_TO_SRGB)
    to_ratio = jnp.asarray(matrix / matrix.sum(1, keepdims=True), linear.dtype)
    return jnp.moveaxis(lab_of(jnp.moveaxis(linear @ to_ratio.T, -1, 0)), 0, -1)


def difference(
    one: Float[Array | np.ndarray, "*s 3"],
    other: Float[Array | np.ndarray, "*s 3"],
    known: Bool[np.ndarray, "*s"] | None = None,
) -> Difference:
    """Of two textures of linear reflectance, over the texels that are `known`."""
    off = np.asarray(_delta(one, other))
    off = off.ravel() if known is None else off[np.asarray(known)]
    return Difference(float(off.mean()), float(np.quantile(off, 0.95)))


@eqx.filter_jit
def _delta(one, other):
    return jnp.sqrt(((lab(one) - lab(other)) ** 2).sum(-1))


@eqx.filter_jit
def _unrolled(picture, eye: Eye, reach, shape: tuple[int, int]):
    angle, radius = (c.astype(picture.dtype) for c in cell_centres(shape))
    away = eye.from_axis(radius).astype(picture.dtype)[None, :]
    x, y = jnp.cos(angle)[:, None] * away, jnp.sin(angle)[:, None] * away
    if picture.ndim == 2:
        return look_up(picture, x, y, reach)
    return jnp.moveaxis(look_up(jnp.moveaxis(picture, -1, 0), x, y, reach), 0, -1)
