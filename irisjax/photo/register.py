"""A second photograph of the same eye, brought onto the pixels of the first."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import optimize
from scipy.ndimage import binary_dilation, gaussian_filter, map_coordinates
from skimage.registration import optical_flow_ilk, phase_cross_correlation
from skimage.transform import AffineTransform, downscale_local_mean, warp

from irisjax.photo.masks import cut_part
from irisjax.photo.outlines import find_boundaries
from irisjax.photo.photograph import Colours, Ellipse, Mask, Photograph
from irisjax.photo.texture import LUMINANCE_WEIGHTS, sampled

MOST_OFF = 0.015
"""Greatest distance between the textures of two photographs, of the limbus's radius: those of other
eyes, which the registration forces onto the first, are off by 0.02 to 0.03.
"""
_ANNULUS = (0.4, 0.95)  # of the limbus: most pupils end below, lids and lashes begin above
_WINDOW = 0.1  # of the limbus: where brightness is made even
_SCALES = (1 / 24, 1 / 48, 1 / 96, 1 / 200)  # blurs of the refinement, of the limbus
_POLAR = (64, 1024)  # samples along radius and angle
_MOST = 15_000  # pixels compared at a time
_OUTLYING = 0.3  # differences of textures (standard deviations) that count half
_STEPS, _STILL = 20, 3e-5  # most steps, and relative change at which they end
_WORKING = 300.0  # px; larger irides are compared at about this radius
_LEAST_RADIUS = 20.0  # px, of a limbus with any texture in it


class Registration(NamedTuple):
    """A second photograph on the first one's pixels.

    Attributes:
        pixels: Linear pixels of the second, interpolated bilinearly; 0 where it has none.
        valid: Pixels that the second has and to which no saturated one contributes.
        transform: (2, 3) matrix from (column, row, 1) in the first to (column, row) in the second.
        residual: RMS distance (pixels of the first) by which textures within the limbus still
            differ, over the half of the iris that agrees best; large if the pupil has another size.
        correlation: Correlation of the two textures within the limbus; below about 0.3 they have
            little in common, and the transform is no better than the outlines.
    """

    pixels: Colours
    valid: Mask
    transform: Float[np.ndarray, "2 3"]
    residual: float
    correlation: float

    @property
    def scale(self) -> float:
        """Pixels of the second per pixel of the first, geometric mean of both directions."""
        return _scale(self.transform)

    @property
    def rotation(self) -> float:
        """Radians by which the second shows the eye turned, from right towards the top."""
        (a, b), (c, d) = self.transform[:, :2]
        return float(np.arctan2(b - c, a + d))


class SecondPhotograph(NamedTuple):
    """A second photograph on the pixels of the first one's part; `clear` ones show the iris and
    nothing in front of it.
    """

    registration: Registration
    part: Colours
    clear: Mask


def lay_on_first(
    second: Photograph, first: Photograph, limbus: Ellipse, pupil: Ellipse, cut: tuple[slice, slice]
) -> SecondPhotograph:
    """Lay a second photograph of the same eye on a part of the first.

    The outlines are those in the first, and `cut` has the rows and columns of the part in what
    `cut_part` cuts out for the limbus.

    Raises:
        ValueError: If the second photograph shows another eye.
    """
    registration = register_photographs(second, first, limbus, find_boundaries(second).limbus)
    apart = registration.residual / limbus.semi_axes[0]
    if not apart < MOST_OFF:
        raise ValueError(
            f"{second.name}: its iris does not come to lie on the one of {first.name}: they are "
            f"off by {100 * apart:.1f} % of the limbus's radius, {100 * MOST_OFF:g} % is the most"
        )
    pixels = registration.pixels.astype(np.float32)
    registered = Photograph(pixels, ~registration.valid, second.grey)
    part = cut_part(registered, limbus)
    clear, *_ = part.clear(part.moved(pupil))
    return SecondPhotograph(registration, part.pixels[cut], clear[cut])


def register_photographs(
    second: Photograph, first: Photograph, first_limbus: Ellipse, second_limbus: Ellipse
) -> Registration:
    """Find the affine map between two photographs and resample the second onto the first.

    For pairs such as one through crossed polarisers and one without: highlights and shading differ,
    the iris's texture does not. Centres and sizes of the outlines come first, then the angle by
    phase correlation of the unrolled irides, then all six numbers by least squares on the textures,
    from coarse to fine, in which parts that one of the two lacks have little weight.

    Raises:
        ValueError: If a limbus has its centre outside its photograph or a radius below 20 pixels.
    """
    one, other = _texture(first, first_limbus), _texture(second, second_limbus)
    rotation, scale = _rotation(one, other), other.limbus.mean_radius / one.limbus.mean_radius
    cos, sin = scale * np.cos(rotation), scale * np.sin(rotation)
    # About the limbus, so that all six numbers have one magnitude.
    other_centre, centre = other.limbus.centre, np.array(one.limbus.centre)
    affine = np.array([[cos, sin, other_centre[0]], [-sin, cos, other_centre[1]]])
    points = _points_of_annulus(one, first.name)
    for blur in _SCALES:
        affine = _refine(affine, one, other, points, max(blur * one.limbus.mean_radius, 1.0))
    reduced = np.column_stack([affine[:, :2], affine[:, 2] - affine[:, :2] @ centre])
    residual, correlation = _disagreement(one, other, reduced)
    # Whole numbers are the middles of pixels, reduced ones too.
    matrix = reduced[:, :2] * other.reduction / one.reduction
    offset = matrix @ np.full(2, (1 - one.reduction) / 2)
    offset += other.reduction * (reduced[:, 2] + 0.5) - 0.5
    transform = np.column_stack([matrix, offset])
    pixels, valid = _resample(second, transform, first.shape)
    return Registration(pixels, valid, transform, residual * one.reduction, correlation)


class _Texture(NamedTuple):
    """Luminance less the brightness around it, where it is reliable, and the limbus there."""

    values: np.ndarray
    usable: np.ndarray
    limbus: Ellipse
    reduction: int


def _scale(transform: np.ndarray) -> float:
    return float(np.sqrt(abs(np.linalg.det(transform[:, :2]))))


def _texture(photograph: Photograph, limbus: Ellipse) -> _Texture:
    (x, y), (rows, columns) = limbus.centre, photograph.shape
    if not (0 <= x < columns and 0 <= y < rows):
        raise ValueError(
            f"{photograph.name}: the limbus is centred at column {x:.0f}, row {y:.0f}, out of the "
            f"{columns} × {rows} pixels"
        )
    if not min(limbus.semi_axes) >= _LEAST_RADIUS:
        raise ValueError(
            f"{photograph.name}: the limbus has a radius of {min(limbus.semi_axes):.1f} pixels; "
            f"photographs are registered by irides of at least {_LEAST_RADIUS:.0f}"
        )
    reduction = max(1, round(limbus.mean_radius / _WORKING))
    limbus = limbus.scaled(1 / reduction)
    radius = limbus.mean_radius
    luminance = photograph.pixels @ LUMINANCE_WEIGHTS
    saturated = photograph.saturated
    if reduction > 1:
        rows, columns = (n // reduction * reduction for n in photograph.shape)
        size, share = (reduction, reduction), saturated[:rows, :columns].astype(np.float32)
        luminance = downscale_local_mean(luminance[:rows, :columns], size)
        saturated = downscale_local_mean(share, size) > 0
    usable = np.logical_not(binary_dilation(saturated, iterations=max(2, round(0.01 * radius))))
    inside = limbus.mask(usable.shape) & usable
    dark = max(1e-6, 0.05 * float(np.median(luminance[inside]))) if inside.any() else 1e-6
    # Logarithms turn light that falls off across the iris into an additive term.
    values = np.log(np.maximum(luminance, 0) + dark)
    weight = usable.astype(np.float32)
    blur = partial(gaussian_filter, sigma=_WINDOW * radius, mode="constant", truncate=3.0)
    share = np.maximum(blur(weight), 1e-6)
    values = np.where(usable, values - blur(weight * values) / share, 0)
    spread = np.sqrt(np.maximum(blur(values**2) / share, 1e-8))
    return _Texture(np.clip(values / spread, -3, 3), usable, limbus, reduction)


def _rotation(one: _Texture, other: _Texture) -> float:
    """Radians by which the second shows the eye turned, from right towards the top."""
    unrolled = []
    for texture in (one, other):
        (x, y), radius = texture.limbus.centre, texture.limbus.mean_radius
        blurred = gaussian_filter(texture.values, max(radius / 100, 0.5))
        angle = np.linspace(0, 2 * np.pi, _POLAR[1], endpoint=False)
        reach = radius * np.linspace(*_ANNULUS, _POLAR[0])[:, None]
        unrolled.append(sampled(blurred, y - reach * np.sin(angle), x + reach * np.cos(angle)))
    settings: dict[str, Any] = {"upsample_factor": 10, "normalization": None}
    shift, *_ = phase_cross_correlation(*unrolled, **settings)
    return float(-shift[1] * 2 * np.pi / _POLAR[1])


def _points_of_annulus(one: _Texture, name: str) -> np.ndarray:
    """Pixels of the annulus, (n, 2), evenly thinned out."""
    share = one.limbus.radii(one.usable.shape)
    rows, columns = np.nonzero((share > _ANNULUS[0]) & (share < _ANNULUS[1]) & one.usable)
    if not len(rows):
        raise ValueError(f"{name}: all pixels of the iris are burnt out")
    chosen = np.random.default_rng(0).permutation(len(rows))[:_MOST]
    return np.stack([columns[chosen], rows[chosen]], -1).astype(np.float64)


def _refine(affine, one: _Texture, other: _Texture, points, blur: float) -> np.ndarray:
    """The affine map (2, 3) about the limbus after robust least squares at one scale."""
    target = gaussian_filter(one.values, blur)[points[:, 1].astype(int), points[:, 0].astype(int)]
    image = gaussian_filter(other.values, blur * _scale(affine))
    slopes = np.gradient(image)[::-1]  # along columns, along rows
    image, slopes = image / target.std(), [s / target.std() for s in slopes]
    target = target / target.std()
    radius = one.limbus.mean_radius
    coordinates = np.column_stack([(points - one.limbus.centre) / radius, np.ones(len(points))])
    sizes = np.array([radius, radius, 1.0])

    def sample_second(picture, parameters):
        return sampled(picture, *(parameters.reshape(2, 3) @ coordinates.T)[::-1])

    start = (affine * sizes).ravel()
    keep = sample_second(other.usable.astype(np.float32), start) > 0.99
    if keep.sum() < 100:
        return affine

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return np.where(keep, sample_second(image, parameters) - target, 0)

    def jacobian(parameters: np.ndarray) -> np.ndarray:
        along, down = (sample_second(s, parameters)[:, None] for s in slopes)
        return keep[:, None] * np.concatenate([along * coordinates, down * coordinates], 1)

    solve: Any = optimize.least_squares  # its annotations know no function for the Jacobian
    settings = {"loss": "cauchy", "f_scale": _OUTLYING, "max_nfev": _STEPS, "xtol": _STILL}
    parameters = solve(residuals, start, jacobian, **settings).x
    refined = parameters.reshape(2, 3) / sizes
    change = np.linalg.det(refined[:, :2]) / np.linalg.det(affine[:, :2])
    return refined if 0.7 < change < 1.4 else affine  # textures that have nothing in common


def _resample(second: Photograph, transform: np.ndarray, shape: tuple[int, int]):
    # Pixels of the second that are finer are averaged, as in skimage.transform.resize.
    blur = max(0.0, (_scale(transform) - 1) / 2)
    inverse = AffineTransform(np.vstack([transform, [0, 0, 1]]))
    resample = partial(warp, inverse_map=inverse, output_shape=shape, order=1, preserve_range=True)
    channels = np.moveaxis(second.pixels, -1, 0)
    pixels = [resample(gaussian_filter(c, blur) if blur else c) for c in channels]
    saturated = binary_dilation(second.saturated, iterations=max(1, round(2 * blur)))
    # Beyond the second all is cut off.
    valid = resample(saturated.astype(np.float32), cval=1.0) <= 1e-4
    return np.stack(pixels, -1).astype(np.float32), valid


def _disagreement(one: _Texture, other: _Texture, transform: np.ndarray) -> tuple[float, float]:
    """RMS of the remaining flow between the textures (px), and their correlation."""
    (x, y), (a, _), _ = one.limbus
    step = max(1.0, a / 200)
    column, row = np.meshgrid(np.arange(x - a, x + a, step), np.arange(y - a, y + a, step))
    in_second = np.tensordot(transform, np.stack([column, row, np.ones_like(row)]), 1)
    blur = max(a / 150, step)
    pictures, usable = [], []
    for texture, place, size in ((one, (column, row), 1), (other, in_second, _scale(transform))):
        values = gaussian_filter(texture.values, blur * size)
        pictures.append(sampled(values, *place[::-1]).astype(np.float32))
        known = texture.usable.astype(np.float32)
        usable.append(map_coordinates(known, place[::-1], order=1, cval=0.0) > 0.99)
    share = one.limbus.relative_radius(column, row)
    inside = usable[0] & usable[1] & (share > _ANNULUS[0]) & (share < _ANNULUS[1])
    if inside.sum() < 100:
        return float("inf"), 0.0
    correlation = float(np.corrcoef(*(p[inside] for p in pictures))[0, 1])
    flow = optical_flow_ilk(*pictures, radius=9, num_warp=5)
    remaining = np.hypot(*flow)[inside] * step
    smallest = np.sort(remaining)[: max(1, len(remaining) // 2)]
    return float(np.sqrt((smallest**2).mean())), correlation
