"""The iris laid flat: refraction undone, holes filled, polar coordinates  [F09 Section 4.1]."""

import functools
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Float, Shaped
from PIL import Image
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from irisjax.anatomy.eye import rings_between
from irisjax.photo.edges import map_channels
from irisjax.photo.photograph import Brightness, Mask
from irisjax.photo.pose import Pose, iris_points, project_iris_points
from irisjax.render import environment
from irisjax.render.project import View, scatter_to_picture

HALF_WIDTH = 6.0  # of a texture, which is centred on the eye's axis, mm
LUMINANCE_WEIGHTS = np.array(environment.LUMINANCE, np.float32)
"""Luminance of linear sRGB's components [IEC 61966-2-1]."""
_LEAST_WEIGHT = 1e-3  # share of a mean's weight on valid texels below which rounding would show
MAP_SHAPE = (768, 256)  # angles and radii of maps, as in `procedural`
_MOST_SAMPLES = 16  # of a cell along each side: coarse maps of fine textures
TEXTURE_SIZE = 1024  # texels along a side of the texture
_REFRACTION_GRID = 64, 33  # angles and radii at which refraction is followed


class Unrefracted(NamedTuple):
    """A square texture of the iris plane, x and y from −6 to 6 mm: x right, row 0 at y = +6.

    Attributes:
        pixels: Linear values on sRGB's primaries, or of other channels.
        valid: Texels that show the iris: neither pupil nor lids, lashes or highlights.
        pupil_radius: In mm, as `iris_radius`.
        pupil_centre: Middle of the pupil, mm from the axis.
    """

    pixels: Float[np.ndarray, "rows columns channels"]
    valid: Mask
    pupil_radius: float
    iris_radius: float
    pupil_centre: tuple[float, float] = (0.0, 0.0)

    @property
    def millimetres_per_texel(self) -> float:
        """Width of a texel, mm."""
        return 2 * HALF_WIDTH / len(self.valid)

    def radius(self) -> Brightness:
        """Return the distance of the texels' middles from the axis, mm."""
        return texels_of(len(self.valid))[0]

    def angle(self) -> Brightness:
        """Return the angle of the texels' middles from +x towards +y, radians in (−π, π]."""
        return texels_of(len(self.valid))[1]

    def luminance(self) -> Brightness:
        """Return the linear luminance."""
        return self.pixels.astype(np.float32) @ LUMINANCE_WEIGHTS

    def to_polar(self, values: np.ndarray, shape: tuple[int, int] = MAP_SHAPE) -> np.ndarray:
        """Return the means of values at the texels over polar cells, see `to_polar`."""
        return to_polar(values, self.pupil_radius, self.iris_radius, shape, self.pupil_centre)

    def from_polar(self, values: Float[np.ndarray, "angles radii"]) -> Brightness:
        """Return values of polar cells at the texels, linear between the middles of cells."""
        angles, radii = values.shape
        ring = np.concatenate([values[-1:], values, values[:1]]).astype(np.float32)
        radius, angle = self.radius(), self.angle()
        point = radius * np.cos(angle), radius * np.sin(angle)
        rings = rings_between(point, self.pupil_centre, self.pupil_radius, self.iris_radius)
        place, x, y = map(np.asarray, rings)
        row = np.arctan2(y, x) % (2 * np.pi) * (angles / (2 * np.pi)) + 0.5
        return sampled(ring, row, place * radii - 0.5)


@functools.lru_cache(maxsize=2)
def texels_of(size: int) -> tuple[Brightness, Brightness]:
    """Return radius (mm) and angle (radians) of the middles of the texels of a texture, as arrays
    that all callers share and none may write to.
    """
    along = ((np.arange(size) + 0.5) * (2 * HALF_WIDTH / size) - HALF_WIDTH).astype(np.float32)
    x, y = along[None, :], -along[:, None]
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    radius.flags.writeable = angle.flags.writeable = False
    return radius, angle


def gaussian_mean(
    values: Shaped[np.ndarray, "rows columns"], sigma: float, margin: bool = True
) -> Brightness:
    """Return a picture convolved with a Gaussian of `sigma` texels, by Fourier transforms.

    For wide Gaussians this is far quicker than `scipy.ndimage.gaussian_filter`. The picture is
    continued by zeros. Without the `margin` opposite edges blur into each other: leave it out only
    where the picture has a margin of its own.
    """
    width = int(np.ceil(4 * sigma)) if margin else 0
    padded: list[Any] = [scipy.fft.next_fast_len(n + width, real=True) for n in values.shape]
    spectrum = np.asarray(scipy.fft.rfft2(values.astype(np.float32), padded))
    spectrum = ndimage.fourier_gaussian(spectrum, sigma, padded[1])
    whole = np.asarray(scipy.fft.irfft2(spectrum, padded))
    return whole[: values.shape[0], : values.shape[1]]


class Refraction(NamedTuple):
    """Columns and rows at which texels appear in a part of a photograph, and which are visible."""

    column: Brightness
    row: Brightness
    visible: Mask

    def pixels(
        self, texels: Mask | tuple[np.ndarray, np.ndarray], shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of the pixels of a part of some `shape` in which texels appear,
        given as a mask or as indices of rows and columns.
        """
        row, column = (
            np.clip(np.rint(v[texels]).astype(int), 0, n - 1)
            for v, n in zip((self.row, self.column), shape, strict=True)
        )
        return row, column


def follow_refraction(pose: Pose, size: int = TEXTURE_SIZE) -> Refraction:
    """Return where the texels of an iris appear in the picture of its camera  [F09 Eqs. 3, 4].

    The renderer finds where a point of the iris appears (`project_points`: Newton's method on the
    path whose entry Fermat's principle selects). Here this is done on a polar grid and interpolated
    by cubic splines.
    """
    eye = pose.eye
    angles, radii = _REFRACTION_GRID
    reach = float(eye.iris_radius)
    turn = np.linspace(0, 2 * np.pi, angles, endpoint=False)
    # Closer together towards the root, where the cornea is steepest.
    radius = reach * np.sin(np.pi / 2 * np.linspace(0, 1, radii))
    points = iris_points(eye, np.outer(np.cos(turn), radius), np.outer(np.sin(turn), radius))
    column, row, visible = project_iris_points(eye, pose.camera, points)
    places = []
    # Each line from the middle ends where the iris is no longer seen.
    visible_radius = np.where(visible, radius, 0).max(1)
    texel_radius, texel_angle = texels_of(size)
    texel_angle = texel_angle % (2 * np.pi)
    # The splines are evaluated on a finer grid, between whose points they are straight to 1e-5 of
    # the iris's width: a tenth of the time that they take at every texel.
    lines, rings = 8 * angles, 4 * (radii - 1)
    turns = 2 * np.pi / lines * np.arange(lines + 1)
    bend = np.pi / 2 / rings
    ring = np.arcsin(np.minimum(texel_radius / reach, 1)) / bend
    on_grid = texel_angle * (lines / (2 * np.pi)), ring
    periodic = np.arange(-4, angles + 4)  # some lines twice: the splines are periodic
    extended = turn[periodic % angles] + 2 * np.pi * (periodic // angles)
    for values in (column, row):
        # Lines go on straight where they are out of sight.
        for line, shown in zip(values, visible, strict=True):
            n = radii if shown.all() else int(np.argmin(shown))
            line[n:] = make_interp_spline(radius[:n], line[:n], k=1)(radius[n:])
        spline = RectBivariateSpline(extended, radius, values[periodic % angles], kx=3, ky=3)
        fine = spline(turns, reach * np.sin(bend * np.arange(rings + 1)))
        places.append(sampled(fine, *on_grid))
    visible_edge = np.interp(texel_angle, extended, visible_radius[periodic % angles])
    return Refraction(places[0], places[1], texel_radius < np.minimum(visible_edge, reach))


def follow_cells(pose: Pose, where: Refraction, shape: tuple[int, int]) -> Refraction:
    """Return where the middles of polar cells appear, as of `to_polar` with `shape`, from where the
    texels do.
    """
    angles, radii = shape
    pupil, root = float(pose.eye.pupil_radius), float(pose.eye.iris_radius)
    turn, out = (np.arange(angles) + 0.5) * (2 * np.pi / angles), (np.arange(radii) + 0.5) / radii
    texel = 2 * HALF_WIDTH / len(where.visible)
    at = _texels_on_rings(turn, out, pupil + (root - pupil) * out, pose.pupil_centre, texel)
    column, row = (sampled(v.astype(np.float32), *at) for v in where[:2])
    return Refraction(column, row, sampled(where.visible.astype(np.float32), *at) > 0.5)


def unrefract(
    pixels: Float[np.ndarray, "rows columns channels"], clear: Mask, pose: Pose, where: Refraction
) -> Unrefracted:
    """Return the texture of an iris from the part of a photograph that its camera shows, and from
    the pixels there that are clear of highlights, lashes and lids.

    Values are interpolated linearly, so the photograph should not be finer than the texture.
    """
    texels = [sampled(c, where.row, where.column) for c in np.moveaxis(pixels, -1, 0)]
    texels = np.stack(texels, -1).astype(np.float32)
    rows, columns = clear.shape
    within = (where.row >= 0) & (where.row <= rows - 1)
    within &= (where.column >= 0) & (where.column <= columns - 1)
    clear_share = sampled(clear.astype(np.float32), where.row, where.column)
    pupil, root = float(pose.eye.pupil_radius), float(pose.eye.iris_radius)
    radius, angle = texels_of(len(clear_share))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    off_pupil = np.hypot(x - pose.pupil_centre[0], y - pose.pupil_centre[1]) > pupil
    shown = where.visible & within
    texels = np.where(shown[..., None], texels, np.float32(0))
    valid = shown & off_pupil & (clear_share > 0.999)
    return Unrefracted(texels, valid, pupil, root, pose.pupil_centre)


def pixels_shown(view: View, visible: Mask, shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels of the part that show what a mask of the flat iris marks as visible."""
    size = TEXTURE_SIZE
    if visible.shape != (size, size):
        raise ValueError(f"the mask of what is visible is {visible.shape}, not {(size, size)}")
    seen = view.iris
    if seen is None:
        return np.zeros(shape, bool)
    x, y = map(np.asarray, seen.point[:2])
    texel = 2 * HALF_WIDTH / size
    column, row = (np.clip(((c + HALF_WIDTH) / texel).astype(int), 0, size - 1) for c in (x, -y))
    return scatter_to_picture(seen, visible[row, column].astype(np.float32), shape) > 0.5


def sampled(
    picture: Shaped[np.ndarray, "rows columns"], row: np.ndarray, column: np.ndarray
) -> np.ndarray:
    """Return a picture's values at rows and columns, interpolated linearly and constant beyond."""
    return ndimage.map_coordinates(picture, np.stack([row, column]), order=1, mode="nearest")


def to_polar(
    values: Brightness,
    pupil_radius: float,
    iris_radius: float,
    shape: tuple[int, int] = MAP_SHAPE,
    pupil_centre: tuple[float, float] = (0.0, 0.0),
) -> Float[np.ndarray, "angles radii"]:
    """Return means over polar cells of a texture without holes.

    The texture is sampled bilinearly, at least once a texel along each side of a cell. Rows run
    from +x towards +y, columns from the pupil's edge to the root; radii are in mm.

    Raises:
        ValueError: If the radii are not those of an iris within the texture.
    """
    if not 0 < pupil_radius < iris_radius <= HALF_WIDTH:
        raise ValueError(
            f"pupil_radius = {pupil_radius:g} mm and iris_radius = {iris_radius:g} mm must rise "
            f"within (0, {HALF_WIDTH:g}] mm"
        )
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
    at = _texels_on_rings(turn, out, place, pupil_centre, texel)
    samples = sampled(values.astype(np.float32), *at)
    cells = samples.reshape(angles, fine[0], radii, fine[1]).mean(1)
    return np.einsum("arf,rf->ar", cells, weight)


def _texels_on_rings(turn, out, place, pupil_centre: tuple[float, float], texel: float):
    """Rows and columns of a texture at angles of rings with radii `place`, a share `out` of the way
    from the pupil, whose middle they have in that share, to the root.
    """
    x, y = (
        along[:, None] * place + (1 - out) * centre
        for along, centre in zip((np.cos(turn), np.sin(turn)), pupil_centre, strict=True)
    )
    return (HALF_WIDTH - y) / texel - 0.5, (x + HALF_WIDTH) / texel - 0.5


def fill_holes(
    pixels: Float[np.ndarray, "rows columns ..."], holes: Mask
) -> Float[np.ndarray, "rows columns ..."]:
    """Fill the holes of a picture smoothly from their surroundings; the rest stays exact.

    Means over ever larger squares, each without the holes, are interpolated linearly: a wide hole
    takes the colours of a wide neighbourhood. Values lie between those outside.
    """
    if holes.all():
        raise ValueError(f"all {holes.size} pixels are holes; there is nothing to fill them from")
    hole, layers = holes[..., None], pixels.reshape(*holes.shape, -1)
    filled = _fill_levels(np.where(hole, 0, layers).astype(np.float32), (~hole).astype(np.float32))
    return np.where(hole, filled, layers).astype(pixels.dtype).reshape(pixels.shape)


def half_size(
    picture: Float[np.ndarray, "rows columns channels"],
) -> Float[np.ndarray, "rows_1 columns_1 channels"]:
    """Return means over squares of 2 × 2 pixels; an odd picture is continued by zeros.

    Sums of slices take a sixth of the time of scikit-image's `downscale_local_mean`.
    """
    rows, columns = picture.shape[:2]
    even = np.pad(picture, ((0, rows % 2), (0, columns % 2), (0, 0)))
    pairs = even[::2] + even[1::2]
    return (pairs[:, ::2] + pairs[:, 1::2]) / 4


def masked_mean(values: Brightness, valid: Mask, sigma: float) -> Brightness:
    """Return the mean of the valid texels around each texel, weighted by a Gaussian of standard
    deviation `sigma` (texels); the mean of all valid ones where every one of them is far.
    """
    if not valid.any():
        raise ValueError("no texel is valid: there is nothing to take a mean of")
    weight = gaussian_mean(valid, sigma)
    far = weight < _LEAST_WEIGHT
    mean = gaussian_mean(np.where(valid, values, 0), sigma) / np.where(far, 1, weight)
    return np.where(far, values[valid].mean(dtype=np.float32), mean)


def _fill_levels(total: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Values whose sums over the known parts are `total`, filled where less than all is known."""
    rows, columns = known.shape[:2]
    if known.all() or rows == columns == 1:
        return total / known
    coarse = [half_size(x) for x in (total, known)]
    # A quarter known is enough for a square to count in full at the next level.
    share = np.maximum(coarse[1], 1e-30)
    weight = np.minimum(4 * coarse[1], 1.0)
    below = _fill_levels(coarse[0] / share * weight, weight)
    size = 2 * below.shape[1], 2 * below.shape[0]
    above = map_channels(below, lambda c: c.resize(size, Image.Resampling.BILINEAR))
    return total + (1 - known) * above[:rows, :columns]
