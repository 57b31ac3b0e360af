"""A picture of what was found in a photograph, to be looked at first."""

import numpy as np
from PIL import Image, ImageDraw

from irisjax.measure.colour import srgb_encode
from irisjax.photo.clone import Lit, Outlined, Posed
from irisjax.photo.edges import reduce_picture
from irisjax.photo.masks import place_of_part
from irisjax.photo.photograph import Colours, Ellipse
from irisjax.render.project import onto_picture

_LONG = 1200  # px along the long side
# Blue beside green is told apart by those who do not tell red from green.
_LIMBUS, _PUPIL, _LAMP = (0, 255, 0), (80, 160, 255), (255, 255, 0)
_HIDDEN = np.array([255.0, 0.0, 255.0])
_MOST_LAMPS = 12  # an environment has more


def draw_overlay(found: Outlined) -> Colours:
    """Return the photograph, sRGB-encoded, with the outlines of limbus (green) and pupil (blue),
    the pixels of the iris that something hides (tinted), and mirror images of lamps (yellow).
    """
    photograph, outlines = found.photograph, found.boundaries
    scale = min(1.0, _LONG / max(photograph.shape))
    small = np.clip(reduce_picture(photograph.pixels, scale), 0, 1)
    levels = 255 * np.asarray(srgb_encode(small))
    if isinstance(found, Posed):
        row, column = ((np.arange(n) + 0.5) / scale - 0.5 for n in levels.shape[:2])
        there = _on_part(found, column, row[:, None])
        iris = outlines.limbus.scaled(scale).mask(levels.shape[:2])
        iris &= ~outlines.pupil.scaled(scale).mask(levels.shape[:2])
        hidden = iris & ~found.clear[there]
        levels = np.where(hidden[..., None], 0.6 * levels + 0.4 * _HIDDEN, levels)
    image = Image.fromarray(np.round(levels).astype(np.uint8))
    draw, along = ImageDraw.Draw(image), np.linspace(0, 2 * np.pi, 361)
    both = (outlines.limbus, _LIMBUS), (outlines.pupil, _PUPIL)
    size = max(3.0, 0.03 * outlines.limbus.scaled(scale).mean_radius)
    lamps = _lamps(found) if isinstance(found, Lit) else []
    both += tuple((Ellipse(at, (size / scale, size / scale)), _LAMP) for at in lamps)
    for outline, colour in both:
        line = [(float(x), float(y)) for x, y in outline.scaled(scale).points(along)]
        draw.line(line, fill=colour, width=max(1, round(size / 6)))
    return np.asarray(image) / 255


def _on_part(found: Posed, column, row):
    """Rows and columns of the camera's picture nearest to places of the photograph."""
    (x, y), _, reduction = place_of_part(found.boundaries.limbus)
    left, top = found.pose.corner
    rows, columns = found.clear.shape
    across, down = (column - x) / reduction - left, (row - y) / reduction - top
    return (
        np.clip(np.rint(down), 0, rows - 1).astype(int),
        np.clip(np.rint(across), 0, columns - 1).astype(int),
    )


def _lamps(found: Lit) -> list[tuple[float, float]]:
    """Find the columns and rows at which the photograph shows lamps mirrored in the cornea."""
    seen, lamps = found.view.mirror, found.lighting.lamps
    if seen is None or lamps is None:
        return []
    (x, y), _, reduction = place_of_part(found.boundaries.limbus)
    left, top = found.pose.corner
    directions = np.stack([np.asarray(c) for c in seen.mirror], -1)
    directions = onto_picture(seen, directions, found.clear.shape)
    places = []
    for towards in np.asarray(lamps.towards)[:_MOST_LAMPS]:
        row, column = np.unravel_index(np.argmax(directions @ towards), found.clear.shape)
        right, down = (reduction * (n + 0.5) - 0.5 for n in (left + column, top + row))
        places.append((float(x + right), float(y + down)))
    return places
