"""Strokes of varying width, drawn into a picture."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_PACE = 0.7  # pixels between places along a stroke whose neighbours are drawn


@eqx.filter_jit
def stamp_strokes(
    strokes: Float[Array, "strokes points 3"], shape: tuple[int, int], parts: int, width: int
) -> Float[Array, "rows columns"]:
    """Share of each pixel that strokes cover: columns, rows and radii of points along each, in
    pixels. Between two points `parts` cross-sections of `width` pixels are drawn, see `sections`.
    """
    rows, columns = shape
    start, step = strokes[:, :-1].reshape(-1, 3), jnp.diff(strokes, axis=1).reshape(-1, 3)
    (x, y, r), (dx, dy, dr) = (a.T[:, :, None, None] for a in (start, step))
    square = dx * dx + dy * dy + 1e-9
    length = jnp.sqrt(square)
    t = ((jnp.arange(parts) + 0.5) / parts)[:, None]
    offsets = jnp.arange(width) - width // 2
    # The pixels nearest to the places, and how far these lie from the stroke itself.
    j = jnp.round(x + t * dx - offsets * dy / length)
    i = jnp.round(y + t * dy + offsets * dx / length)
    u, v = j - x, i - y
    fraction = jnp.clip((u * dx + v * dy) / square, 0, 1)
    distance = jnp.sqrt((u - fraction * dx) ** 2 + (v - fraction * dy) ** 2 + 1e-9)
    radius = r + fraction * dr
    cover = jnp.minimum(distance + 0.5, radius) - jnp.maximum(distance - 0.5, -radius)
    in_picture = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
    index = jnp.where(in_picture, i * columns + j, rows * columns).astype(jnp.int32)
    # Made at once: in the loop of the scatter they are made number by number.
    cover, index = jax.lax.optimization_barrier((jnp.clip(cover, 0, 1), index))
    cells = jnp.zeros(rows * columns, cover.dtype)
    return cells.at[index].max(cover, mode="drop").reshape(shape)


def stroke_sections(longest: float, widest: float) -> tuple[int, int]:
    """Numbers `parts` and `width` for `stamp_strokes`, of strokes whose points are `longest` pixels
    apart at most and which are `widest` pixels wide. Few different ones: each is a program.
    """
    return 8 * -(-int(longest / _PACE + 1) // 8), 2 * int(widest / 2 + 2) + 1
