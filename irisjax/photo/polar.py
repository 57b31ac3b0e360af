"""Between the square texture of the iris plane and the polar cells of `IrisMaps`."""

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from irisjax.photo.unrefracted import HALF_WIDTH

SHAPE = (768, 256)
"""Angles and radii of maps, as in `procedural`."""
_MOST_SAMPLES = 16  # of a cell along each side: coarse maps of fine textures


def to_polar(
    values: Float[np.ndarray, "size size"],
    pupil_radius: float,
    iris_radius: float,
    shape: tuple[int, int] = SHAPE,
) -> Float[np.ndarray, "angles radii"]:
    """Means over polar cells: rows from +x towards +y, columns from the pupil's edge to the root.

    Bilinear samples, at least one a texel along each side of a cell. Holes have to be filled
    before. Radii in mm. **Raises:** `ValueError` for radii that are no iris within the texture.
    """
    if not 0 < pupil_radius < iris_radius <= HALF_WIDTH:
        raise ValueError(
            f"pupil_radius = {pupil_radius:g} mm and iris_radius = {iris_radius:g} mm must rise "
            f"within (0, {HALF_WIDTH:g}] mm"
        )
    if min(shape) < 2:
        raise ValueError(f"shape {shape} of polar maps is below (2, 2)")
    angles, radii = shape
    texel = 2 * HALF_WIDTH / len(values)
    widest = 2 * np.pi * iris_radius / angles, (iris_radius - pupil_radius) / radii
    fine = [int(np.clip(np.ceil(width / texel), 1, _MOST_SAMPLES)) for width in widest]
    turn = (np.arange(angles * fine[0]) + 0.5) * (2 * np.pi / (angles * fine[0]))
    out = (np.arange(radii * fine[1]) + 0.5) / (radii * fine[1])
    # A cell's outer part covers more of it.
    place = pupil_radius + (iris_radius - pupil_radius) * out
    weight = place.reshape(radii, fine[1])
    weight = (weight / weight.sum(1, keepdims=True)).astype(np.float32)
    column = (np.cos(turn)[:, None] * place + HALF_WIDTH) / texel - 0.5
    row = (HALF_WIDTH - np.sin(turn)[:, None] * place) / texel - 0.5
    samples = ndimage.map_coordinates(
        values.astype(np.float32), np.stack([row, column]), order=1, mode="nearest"
    )
    cells = samples.reshape(angles, fine[0], radii, fine[1]).mean(1)
    return np.einsum("arf,rf->ar", cells, weight)


def from_polar(
    values: Float[np.ndarray, "angles radii"],
    radius: Float[np.ndarray, "*s"],
    angle: Float[np.ndarray, "*s"],
    pupil_radius: float,
    iris_radius: float,
) -> Float[np.ndarray, "*s"]:
    """Values of polar cells at distances from the axis (mm) and angles (radians), linear between
    the cells' middles and constant beyond the first and last.
    """
    angles, radii = values.shape
    ring = np.concatenate([values[-1:], values, values[:1]]).astype(np.float32)
    row = np.asarray(angle) % (2 * np.pi) * (angles / (2 * np.pi)) + 0.5
    column = (np.asarray(radius) - pupil_radius) * (radii / (iris_radius - pupil_radius)) - 0.5
    return ndimage.map_coordinates(ring, np.stack([row, column]), order=1, mode="nearest")
