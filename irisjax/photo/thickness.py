"""Thickness of the stroma from the brightness of a photograph: brighter is thicker  [F09 4.2]."""

import math

import jax.numpy as jnp
import numpy as np
import scipy.fft
from jaxtyping import Bool, Float

from irisjax.grow.procedural import stroma_profile
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.photo.filling import Gaussian, fill, masked_mean

Texture = Float[np.ndarray, "size size"]

MEASURED = Range(2.25, 5.0, "mm")
"""Distances from the axis between which the iris's thickness was measured  [F09 Fig. 8]."""
SIGMA = 0.5
"""Width of the blur by scattering within the tissue, mm  [F09 Section 4.2.1]."""
BETA = 0.350
"""Thickness that goes with encoded values from 0 to 1, mm  [F09 Section 4.2.1]."""
WIDTH = 0.8
"""Standard deviation of the neighbourhood whose mean Eq. 5 takes off, mm."""
LEAST = 0.03
"""Thickness to which the map is clamped, mm: the floor of a deep crypt."""
MOST = 1.5
"""Greatest thickness of the map that luminance and a response give, mm."""
SHADE_WIDTH, SHADE_SHARE = 0.4, 0.5
"""In the shade: width of the neighbourhood, mm, and share of the contrast that is believed. Light
that falls off within less than a millimetre makes contrast as thickness does; in simulated
photographs the two correlate by 0.3 to 0.5 there, and by 0.8 to 0.9 elsewhere.
"""
TYPICAL = 0.4
"""Mean thickness of a stroma, mm: of shading's share in the contrast."""
OTHER = 0.25
"""What else makes contrast: standard deviation of ln luminance by pigment, vessels and folds (about
0.05) over that of ln thickness (about 0.2), both assumed.
"""
MID_GREY = 0.18
"""Linear luminance to which the surroundings of each texel are exposed."""
ITERATIONS = 10
"""Of Richardson and Lucy: more sharpen noise."""
_RESPONSES = Range(-5, 5)  # next to 0 where the stroma is opaque
_LEAST_RESPONSE = 1e-3  # below it the Fourier factor of shading would be 0 / 0


def generic_thickness(radius: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Stroma of an average iris at distances from the axis (mm), mm  [F09 Section 4.2.1].

    The quadratic through ultrasound's 0.645, 0.457 and 0.372 mm at 2.25, 3.5 and 5 mm, less 0.07 mm
    of IPE and 0.05675 mm of ABL. Constant inside and outside of these radii: 0.645 mm is the
    thickest place of an iris, where the quadratic would reach 1.3 mm, and it would rise again
    beyond 5.08 mm.
    """
    within = np.clip(np.asarray(radius, np.float32), MEASURED.low, MEASURED.high)
    return np.asarray(stroma_profile(jnp.asarray((within - 2.0) / 3.5)))


def intensity(relative: Texture) -> Texture:
    """Pixel values as a photograph holds them whose surroundings are exposed to mid-grey; 0.46
    where `relative` luminance is 1.

    β of Eq. 7 belongs to encoded values in [0, 1]. They pass 1 where a texel is over 5.5 times as
    bright as its surroundings.
    """
    linear = MID_GREY * np.maximum(relative, np.float32(0))
    return np.asarray(srgb_encode(linear), np.float32)


def relative_luminance(
    luminance: Texture,
    valid: Bool[np.ndarray, "size size"],
    width_mm: float,
    millimetres_per_texel: float,
) -> Texture:
    """Linear luminance over its mean round about; 1 where not valid.

    So neither the exposure nor a shadow that falls across the eye tells in the thickness. Of black
    surroundings nothing is known: 1.
    """
    around = masked_mean(luminance, valid, width_mm / millimetres_per_texel)
    known = valid & (around > 1e-6)
    return np.where(known, luminance / np.where(known, around, 1), 1).astype(np.float32)


def contrast(
    luminance: Texture,
    valid: Bool[np.ndarray, "size size"],
    shade: Bool[np.ndarray, "size size"] | None,
    millimetres_per_texel: float,
    width_mm: float = WIDTH,
) -> Texture:
    """Contrast of linear luminance to its mean round about; 0 where not valid.

    Texels in the `shade`, where lamps hardly reach, and those beside it are compared each with
    their own kind only, for light falls off steeply between them. `width_mm`: of the neighbourhood.
    """
    shade = np.zeros_like(valid) if shade is None else shade & valid
    whole = np.zeros(valid.shape, np.float32)
    kinds = (valid & ~shade, width_mm, 1.0), (shade, min(width_mm, SHADE_WIDTH), SHADE_SHARE)
    for kind, width, share in kinds:
        if not kind.any():
            continue
        relative = relative_luminance(luminance, kind, width, millimetres_per_texel)
        found = local_normalisation(relative, kind, width, millimetres_per_texel)
        whole[kind] = np.float32(share) * found[kind]
    return whole


def local_normalisation(
    values: Texture,
    valid: Bool[np.ndarray, "size size"],
    width_mm: float,
    millimetres_per_texel: float,
) -> Texture:
    """`values` less their mean around each texel, 0 where not valid  [F09 Eq. 5].

    The neighbourhood is a Gaussian of standard deviation `width_mm`; only valid texels count.
    """
    check_range("width_mm", width_mm, Range(0, np.inf, "mm", above=True))
    mean = masked_mean(values, valid, width_mm / millimetres_per_texel)
    return np.where(valid, values - mean, np.float32(0)).astype(np.float32)


def deconvolve(
    normalised: Texture,
    valid: Bool[np.ndarray, "size size"],
    sigma_mm: float,
    millimetres_per_texel: float,
    iterations: int = ITERATIONS,
) -> Texture:
    """Sharpened by Richardson's and Lucy's method with a Gaussian of `sigma_mm`  [F09 Eq. 6].

    The method wants light, which is positive: an offset of 1 is added and taken off again. It
    begins with the picture itself, so what is finer than the Gaussian stays as it was. Texels that
    are not valid say nothing: they are filled at first, then only the valid ones are explained. The
    mean over these is kept; 0 elsewhere. `sigma_mm` 0 changes nothing.

    **Raises:** `ValueError` for values of −1 and below, and widths and counts out of range.
    """
    check_range("sigma_mm", sigma_mm, Range(0, 2, "mm"))
    check_whole("iterations", iterations, 0, 1000)
    check_range("values to deconvolve", normalised[valid], Range(-1, np.inf, above=True))
    if not valid.any():
        raise ValueError("no texel is valid: there is nothing to deconvolve")
    if sigma_mm == 0 or iterations == 0:
        return np.where(valid, normalised, np.float32(0))
    sigma = sigma_mm / millimetres_per_texel
    box = tuple(_extent(np.any(valid, axis=axis)) for axis in (1, 0))
    shown, wide = valid[box], int(np.ceil(3 * sigma))
    around = np.pad(shown, wide)
    # The tissue goes on beyond what is shown: without it the edges would seem dark.
    light = np.pad(fill(1 + normalised[box].astype(np.float32), ~shown), wide, mode="edge")
    spread = Gaussian(around.shape, sigma, periodic=True)
    weight = spread(around)
    told = weight > 1e-3
    estimate = light
    for _ in range(iterations):
        seen = np.maximum(spread(estimate), np.float32(1e-6))
        ratio = spread(np.where(around, light / seen, 0)) / np.where(told, weight, 1)
        estimate = np.where(told, estimate * ratio, estimate)
    found = estimate[around] - np.float32(1)
    kept = normalised[valid].mean(dtype=np.float64) - found.mean(dtype=np.float64)
    whole = np.zeros(valid.shape, np.float32)
    whole[valid] = found + np.float32(kept)
    return whole


def thickness(
    radius: Texture, deconvolved: Texture, beta: float = BETA
) -> tuple[Texture, Bool[np.ndarray, "size size"]]:
    """Stroma's thickness (mm), and which texels had to be clamped to `LEAST`  [F09 Eq. 7]."""
    check_range("beta", beta, Range(0, 5, "mm"))
    found = generic_thickness(radius) + np.float32(beta) * deconvolved
    return np.maximum(found, np.float32(LEAST)), found < LEAST


def relative_thickness(
    radius: Texture, contrast: Texture, response: float
) -> tuple[Texture, Bool[np.ndarray, "size size"]]:
    """In place of Eq. 7: the generic thickness times (1 + contrast)^g, g = response / (response² +
    `OTHER`²).

    `contrast`: of linear luminance, relative to the surroundings. `response`: of the logarithm of
    luminance to that of thickness, which the model tells (ILIT: 0.6 for a blue iris, 0.5 for a
    green one, 0.2 to 0.3 for a brown one); F09's β stands for about 5. Where all of the contrast
    came from thickness g would be 1 / response; this is the linear estimate of least mean square
    error, and promises little where thickness hardly shows. **Returns:** as `thickness`.
    """
    check_range("response", response, _RESPONSES)
    power = response / (response**2 + OTHER**2)
    grown = np.maximum(1 + contrast, np.float32(1e-3)) ** np.float32(power)
    found = generic_thickness(radius) * grown
    clamped = (found < LEAST) | (found > MOST)
    return np.clip(found, LEAST, MOST), clamped


def unshade(
    contrast: Texture,
    valid: Bool[np.ndarray, "size size"],
    slopes: tuple[float, float],
    response: float,
    millimetres_per_texel: float,
) -> Texture:
    """Contrast of linear luminance as it would be without relief.

    Light from aside brightens what rises towards it, so a picture holds the thickness and its
    derivative. To first order contrast is `response` h / T + s · ∇h, h being the deviation from the
    mean thickness T; in Fourier space that is one factor, which is divided out.

    `slopes`: s along x and y, mm per mm: minus the share of the unevenness that stands out towards
    the cornea (0.3 in `procedural`) times the lights' horizontal over their vertical components,
    in the chamber, means weighted by irradiance. (0, 0) changes nothing.
    """
    check_range("slopes", slopes, Range(-2, 2))
    check_range("response", response, _RESPONSES)
    if slopes == (0, 0):
        return contrast
    # Relief shades an iris, too, whose thickness does not show.
    response = math.copysign(max(abs(response), _LEAST_RESPONSE), response)
    known = np.where(valid, contrast, np.float32(0))
    shape = [scipy.fft.next_fast_len(n + n // 8, real=True) for n in valid.shape]
    up = -scipy.fft.fftfreq(shape[0], millimetres_per_texel).astype(np.float32)[:, None]
    right = scipy.fft.rfftfreq(shape[1], millimetres_per_texel).astype(np.float32)
    of_height = np.float32(response / TYPICAL)
    along = np.float32(2 * np.pi) * (np.float32(slopes[0]) * right + np.float32(slopes[1]) * up)
    factor = of_height + np.complex64(1j) * along
    flat = np.asarray(scipy.fft.rfft2(known, shape)) * (of_height / factor)
    found = np.asarray(scipy.fft.irfft2(flat, shape))[: valid.shape[0], : valid.shape[1]]
    return np.where(valid, found, np.float32(0))


def _extent(line) -> slice:
    """From the first to the last that is true."""
    where = np.flatnonzero(line)
    return slice(int(where[0]), int(where[-1]) + 1)
