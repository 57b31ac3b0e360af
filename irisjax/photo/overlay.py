"""Pictures of what was found in a photograph, to be looked at first."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage
from skimage import measure

from irisjax.measure.colour import srgb_encode
from irisjax.photo.clone import Lit, Outlined, Posed
from irisjax.photo.edges import reduce_picture
from irisjax.photo.eye_colour import RINGS, EyeColour, RegionColour, depth_in_iris
from irisjax.photo.masks import Part, part_geometry
from irisjax.photo.photograph import Colours, Ellipse
from irisjax.render.project import scatter_to_picture

_LONG = 1200  # px along the long side
# Blue beside green is told apart by those who do not tell red from green.
_LIMBUS, _PUPIL, _LAMP = (0, 255, 0), (80, 160, 255), (255, 255, 0)
_HIDDEN = np.array([255.0, 0.0, 255.0])
_MOST_LAMPS = 12  # an environment has more
_SIDE = 560  # px, of the square with the eye beside its colours
_SWATCH, _LINE, _MARGIN = 64, 20, 14  # px
_RING, _WHITE, _HIDDEN_LINE = (255, 255, 255), (255, 235, 0), (255, 0, 255)


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


def draw_colours(colours: EyeColour, part: Part, pupil: Ellipse) -> Colours:
    """Return the eye, sRGB-encoded, with the borders of its rings (white), of what is taken for the
    white of the eye (yellow) and of what is not used of the iris (magenta), beside its colours,
    with L*a*b* and 95 % intervals.
    """
    scale = _SIDE / len(part.pixels)
    encoded = np.asarray(srgb_encode(np.clip(part.pixels, 0, 1)))
    levels = Image.fromarray(np.round(255 * encoded).astype(np.uint8)).resize((_SIDE, _SIDE))
    both = [("dominant", region) for region in colours.dominant]
    rows: Sequence[tuple[str, RegionColour]] = [*colours.regions.items(), *both]
    height = max(_SIDE, len(rows) * (_SWATCH + _MARGIN) + _MARGIN)
    image = Image.new("RGB", (_SIDE + 400, height), (255, 255, 255))
    image.paste(levels)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    depth = depth_in_iris(part.outside.shape, pupil, part.limbus)
    borders = sorted({border for ring in RINGS.values() for border in ring})
    lines = [(contour, _RING) for border in borders for contour in _contours(depth, border)]
    used = colours.visible | (depth < borders[0]) | (depth > borders[-1])
    lines += [(contour, _HIDDEN_LINE) for contour in _contours(used.astype(float), 0.5)]
    white = ndimage.binary_closing(colours.white.pixels, iterations=3).astype(float)
    lines += [(contour, _WHITE) for contour in _contours(white, 0.5)]
    for contour, colour in lines:
        draw.line([(float(x), float(y)) for x, y in scale * (contour[:, ::-1] + 0.5)], colour, 1)
    for number, (name, region) in enumerate(rows):
        top, left = _MARGIN + number * (_SWATCH + _MARGIN), _SIDE + _MARGIN
        fill = tuple(int(level) for level in np.round(255 * region.srgb))
        draw.rectangle((left, top, left + _SWATCH, top + _SWATCH), fill)
        share = f"{100 * region.share:.0f} % {'visible' if name != 'dominant' else 'of the iris'}"
        spans = [f"{a:.0f}…{b:.0f}" for a, b in zip(region.low, region.high, strict=True)]
        text = f"{name}, {share}", "L* {:.0f}  a* {:.0f}  b* {:.0f}".format(*region.lab)
        for line, words in enumerate((*text, f"95 %: {',  '.join(spans)}")):
            at = left + _SWATCH + _MARGIN, top + line * _LINE
            draw.text(at, words, (0, 0, 0), font)
    return np.asarray(image) / 255


def _contours(values, level: float) -> list[np.ndarray]:
    """Rows and columns of lines of one level; short ones are noise."""
    return [line for line in measure.find_contours(values, level) if len(line) > 60]


def _on_part(found: Posed, column, row):
    """Rows and columns of the camera's picture that have places of the photograph."""
    (x, y), _, reduction = part_geometry(found.boundaries.limbus)
    left, top = found.pose.corner
    rows, columns = found.clear.shape
    # Pixel n of the part has those of the photograph from n to n + 1 times the reduction.
    row_in_part = np.floor((row - y + 0.5) / reduction).astype(int) - top
    column_in_part = np.floor((column - x + 0.5) / reduction).astype(int) - left
    return np.clip(row_in_part, 0, rows - 1), np.clip(column_in_part, 0, columns - 1)


def _lamps(found: Lit) -> list[tuple[float, float]]:
    """Find the columns and rows at which the photograph shows lamps mirrored in the cornea."""
    film, lamps = found.view.mirror, found.lighting.lamps
    if film is None or lamps is None:
        return []
    (x, y), _, reduction = part_geometry(found.boundaries.limbus)
    left, top = found.pose.corner
    directions = np.stack([np.asarray(c) for c in film.mirror], -1)
    directions = scatter_to_picture(film, directions, found.clear.shape)
    places = []
    for towards in np.asarray(lamps.towards)[:_MOST_LAMPS]:
        row, column = np.unravel_index(np.argmax(directions @ towards), found.clear.shape)
        right, down = (reduction * (n + 0.5) - 0.5 for n in (left + column, top + row))
        places.append((float(x + right), float(y + down)))
    return places
