"""Every texel its own pigments: three numbers of each place of an iris, from its colour.

F09 has one pair of melanins a layer for a whole iris. Real irides have rings, sectors and spots of
other colours. Where the global fit of `photo.pigments` ends, each pixel of the photograph is solved
for its eumelanin and its pheomelanin, relative to the fitted iris, and for the strength of its
stroma, which is thickness times scattering. The response that is inverted is the renderer's own,
with the photograph's own light. What it cannot say stays as a map of its own.
"""

import functools
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from PIL import Image
from scipy import ndimage
from scipy.stats import qmc

from irisjax.anatomy.eye import Eye
from irisjax.numerics.checks import Range
from irisjax.numerics.chunks import map_chunks, map_rows
from irisjax.numerics.interpolation import chebyshev
from irisjax.photo.edges import map_channels
from irisjax.photo.filling import fill_by_texture
from irisjax.photo.photograph import Brightness, Colours, Mask
from irisjax.photo.pigments import iris_of_concentrations
from irisjax.photo.texture import MAP_SHAPE, Refraction, fill_holes, half_size, sampled
from irisjax.render import picture
from irisjax.render import polynomials as products
from irisjax.render.illumination import Illumination
from irisjax.render.project import IrisPixels, View, scatter_to_picture
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.shading import IrisModel, scale_ranges
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, cell_centres
from irisjax.tissue.pigments import extinction
from irisjax.transport.radiative.tabulated import DEEPEST

NAMES = ("stroma", "eumelanin", "pheomelanin")
"""What is sought at each texel, in the order of `Scales`."""
FACTORS = Scales(
    stroma=np.array([0.03, 60.0]),
    eumelanin=np.array([0.01, 20.0]),
    pheomelanin=np.array([0.01, 50.0]),
)
"""Factors on the fitted iris within which texels are sought at first."""
KEPT = Range(0.25, 4.0)
"""Photograph over model: what is kept of it."""
OUTSIDE = 0.04
"""Error of an encoded channel above which a colour is none that the model can make."""
GAINS = (1.0, 2.0, 0.5, 4.0, 8.0)
"""Factors on the fitted exposure that are tried, the likely ones first."""
PROCESS_DOUBT = np.array([[0.36, -0.22, -0.01], [-0.22, 0.78, -0.15], [-0.01, -0.15, 0.20]])
"""Mean products of the errors of the logarithms of `NAMES` by the choice of the process: colours of
irides of the priors of `photo.pigments`, by radiative transfer, read by ILIT
(experiments/texels_by_process.py). In the median ILIT finds 0.56 times the strength of the stroma
and 1.4 times the eumelanin. Nothing in a colour tells which process made it.
"""
PRIOR_SD = 1.5
"""Standard deviation of the logarithms about the fitted iris, at the coarsest level."""
CHANNEL_NOISE = 0.006
"""Least standard deviation of an encoded channel: rounding, JPEG, the model."""
POWER, DARK = 1 / 2.4, 1e-3
"""Of the encoding in which errors are alike, and its straight part."""
_FINER = 0.5  # of the logarithms between a level and the next coarser one
_STEPS = 12, 5, 4, 4  # most of Levenberg and Marquardt at each level, from the coarsest
_BEYOND = 0.3  # of the logarithms of the finest pixels, beyond those of the next coarser
_SLIGHT = 0.1  # twice the log density that a chunk's last step gains, or promised if refused
_LONGEST, _DAMPING = 1.5, 1e-3  # longest step of a logarithm; damping of the first one
# Share of pixels `OUTSIDE` up to which no other exposure is wanted. So many may be lamps and lashes
# that the mask has missed, to which no exposure belongs: the errors of a few decide their RMS.
_ENOUGH = 0.03
_TRIED = 1024  # most coarsest pixels that decide on the exposure and between maxima
_SHADED = 0.1  # share in the shade from which a coarsest pixel does not count
_BRIGHTNESS = 6.0  # weight of the mean of the channels' errors beside their own
_COLOURS = 9  # logarithm to base 2 of the number of colours at which the search begins
_ROWS, _ROWS_COARSEST = 1 << 13, 1 << 10  # pixels solved at a time
_REACHED = 0.8  # of the optical depths of radiative transfer's table: ranges are widened
_SHORTEST = 400.0  # nm, wavelength of a picture's bands at which the stroma scatters most
_MARGIN = 0.7  # of the logarithms, beyond those found, for the table of all levels


class OwnPigments(NamedTuple):
    """An iris whose texels have their own pigments.

    Attributes:
        iris: The iris that the maps are relative to: their medians.
        maps: Thickness of the stroma, eumelanin, pheomelanin and residual.
        deviations: Standard deviations of the logarithms of `NAMES`, (3, angles, radii): by the
            photograph's noise, the prior about the fitted iris and about the neighbourhood, and the
            doubts about the exposures and the process (`PROCESS_DOUBT`).
        common: The part of `deviations` that is by the exposures and the process, median of all
            texels: an error that they have in common.
        melanin_sd: Standard deviation of the logarithm of a texel's melanin in the ABL, eumelanin
            and pheomelanin together, by the same causes as `deviations`; median of all texels.
        correlation: Median correlation of the errors of each pair of `NAMES`, (3, 3).
        hidden: Cells that the photograph does not show, (angles, radii), filled from beside.
        outside: Share of pixels whose colour is none that the model can make.
        explained: Share of the variance of the encoded colours that the pigments explain.
        gain: Factor on the exposure of the global fit.
        error: Largest error of the table that was inverted, relative to the brightest texel.
        light: Light on the pixels of the iris, see `AbstractIntegrator.illuminate`.
    """

    iris: Iris
    maps: IrisMaps
    deviations: Float[np.ndarray, "3 angles radii"]
    common: Float[np.ndarray, "3"]
    melanin_sd: float
    correlation: Float[np.ndarray, "3 3"]
    hidden: Bool[np.ndarray, "angles radii"]
    outside: float
    explained: float
    gain: float
    error: float
    light: Any

    def abl_melanin(self, eye: Eye) -> float:
        """Return the mean concentration of the ABL's melanin, mg/ml, over the area that the
        photograph shows.

        An iris that is fitted as an even one has the melanin with which it has the mean colour;
        where melanin varies, the dark places hold more of it than they take of the light.
        """
        area = np.asarray(eye.ring_area(cell_centres(self.hidden.shape)[1])) * ~self.hidden
        held = self.iris.layer_concentrations()
        melanin = sum(held[f"abl_{n}"] * np.asarray(getattr(self.maps, n)) for n in NAMES[1:])
        return float(np.average(melanin, weights=area))


class Seen(NamedTuple):
    """What the pixels of a picture show, channels and functions last.

    Attributes:
        target: Radiance of the iris in the photograph.
        light: The functions of directions and light, (rows, columns, tints × functions).
        logs: Where the search begins: the prior's centre.
        known: Pixels that count.
    """

    target: Colours
    light: Float[np.ndarray, "rows columns functions"]
    logs: Float[np.ndarray, "rows columns 3"]
    known: Mask


class TexelResponse(NamedTuple):
    """The iris's response over ranges of the three numbers.

    Attributes:
        coefficients: Those of the products of polynomials.
        ranges: Of the three numbers.
        degrees: Degrees of the polynomials.
        error: Largest error, relative to the brightest texel.
        made: The response that pictures are drawn with.
    """

    coefficients: Float[Array, "products functions channels"]
    ranges: Scales
    degrees: tuple[int, ...]
    error: float
    made: Any

    def spans(self) -> Float[Array, "3 2"]:
        """Smallest and largest value of each number."""
        return jnp.stack([jnp.asarray(r, jnp.float32) for r in self.ranges if r is not None])


class Local(NamedTuple):
    """Pixels with their own numbers.

    Attributes:
        logs: Logarithms of the factors `NAMES`; at pixels that do not count filled from beside.
        covariance: Of the logarithms; 0 elsewhere.
        common: The variances in it that are by the exposures.
        off: Model less photograph, encoded; 0 elsewhere.
    """

    logs: Float[np.ndarray, "rows columns 3"]
    covariance: Float[np.ndarray, "rows columns 3 3"]
    common: Float[np.ndarray, "rows columns 3"]
    off: Float[np.ndarray, "rows columns 3"]


class Coarse(NamedTuple):
    """An iris whose coarse pixels are solved.

    Attributes:
        scene: The scene of the global fit, without maps.
        seen: The pixels that see the iris.
        exposure: Exposures of the channels.
        illumination: Light on the pixels of the iris, see `AbstractIntegrator.illuminate`.
        levels: What its pixels show, the finest first.
        respond: Returns the response over ranges, of the scene or of another.
        factors: Ranges that may be asked for.
        gain: Factor on the exposures.
        tried: The coarsest pixels that were solved: all, or as many as decide.
        local: Their numbers.
    """

    scene: Scene
    seen: IrisPixels
    exposure: Float[np.ndarray, "3"]
    illumination: Any
    levels: list[Seen]
    respond: Callable[..., TexelResponse]
    factors: Scales
    gain: float
    tried: Mask
    local: Local

    @property
    def error(self) -> float:
        """Root mean square of model less photograph, encoded."""
        return _rms(self.local.off[self.tried])

    @property
    def is_within(self) -> bool:
        """Whether the model can make the colours, under the exposures that were given."""
        return self.gain == 1 and _are_within(self.local.off[self.tried])


def solve_coarse(
    target: Colours,
    known: Mask,
    shaded: Mask,
    usual: Brightness,
    scene: Scene,
    view: View,
    tables: Illumination | None,
    exposure: Float[np.ndarray, "3"],
) -> Coarse:
    """Solve the coarsest pixels of an iris.

    Args:
        target: Radiance of the iris in the photograph, under the fitted exposure.
        known: Pixels that show the iris and nothing else, whose numbers are sought.
        shaded: Pixels in a shadow, whose edge the model knows to a few degrees only: the coarsest
            ones do not count, since their colours would ask for another exposure.
        usual: Logarithm of the stroma's usual thickness there over that of the scene's iris.
        scene: The scene of the global fit, without maps.
        view: What its camera sees.
        tables: Its tables of light.
        exposure: Exposures of the channels.
    """
    shape, iris, seen = known.shape, scene.tissue, view.iris
    integrator: Any = scene.integrator
    assert seen is not None
    front = IrisModel(scene.eye, iris, IrisMaps())
    _, exits = integrator.texels(seen, front, Scales())
    illumination = integrator.illuminate(seen, scene.all_lights(), front, tables, None)
    light, mixtures = illumination
    light = np.asarray(light) if exits is None else np.asarray(light) * np.asarray(exits)
    by_pixel = np.moveaxis(light, -1, 0).reshape(light.shape[-1], -1)

    # Ranges of the number types that those of the maps will have, so that one program serves both.
    small = jnp.ones((2, 2), jnp.float32)
    alike = scale_ranges(iris, IrisMaps(stroma_depth=small, eumelanin=small, pheomelanin=small))

    def respond(ranges: Scales, scene: Scene = scene) -> TexelResponse:
        ranges = jax.tree.map(lambda r, like: jnp.asarray(r, like.dtype), ranges, alike)
        response: Any = picture.respond(scene, ranges)
        terms = response.coefficients
        terms = terms if mixtures is None else jnp.einsum("pkc,kr->prc", terms, mixtures)
        return TexelResponse(terms, ranges, response.degrees, float(response.error), response)

    functions = scatter_to_picture(seen, by_pixel, shape)
    logs = np.stack([usual, 0 * usual, 0 * usual], -1)
    target, functions, logs = (np.asarray(x, np.float32) for x in (target, functions, logs))
    levels = [Seen(target, functions, logs, known)]
    share = shaded[..., None].astype(np.float32)
    for _ in _STEPS[1:]:
        levels.append(_halved(levels[-1]))
        share = half_size(share)
    lit = levels[-1].known & (share[..., 0] < _SHADED)
    levels[-1] = levels[-1]._replace(known=lit if lit.any() else levels[-1].known)
    factors = factors_within_table(scene)
    tried = levels[-1]._replace(known=_some_of(levels[-1].known))
    gain, local = find_gain(tried, respond(factors), exposure)
    found = gain, tried.known, local
    return Coarse(scene, seen, exposure, illumination, levels, respond, factors, *found)


def colour_iris(
    coarse: Coarse,
    shown: Mask,
    doubt: Float[np.ndarray, "3 3"],
    cells_of: Callable[[tuple[int, int]], Refraction],
    processes: Float[np.ndarray, "3 3"] = PROCESS_DOUBT,
) -> OwnPigments:
    """Solve the texels of an iris.

    Args:
        coarse: Its coarse pixels.
        shown: Pixels whose residual is kept: those that are known, and the rim that fades into the
            pupil.
        doubt: Covariance of the logarithms of the exposures.
        cells_of: Returns where the middles of so many angles and radii of cells appear.
        processes: Covariance of the logarithms of `NAMES` by the choice of the process.
    """
    scene, seen, exposure, illumination, levels, respond, factors, gain, tried, coarsest = coarse
    target, _, _, known = levels[0]
    shape, iris = known.shape, scene.tissue
    integrator: Any = scene.integrator
    response = respond(ranges_about(coarsest, tried, factors))
    logs, before = solve_levels(levels, response, exposure, gain)
    middle = np.median(logs[known], axis=0)
    iris = moved_iris(iris, np.exp(middle))

    # Cells about as fine as the photograph's pixels, of few sizes, so that programs are shared.
    per_mm = scene.camera.size[0] / float(scene.camera.width)
    pupil, root = float(scene.eye.pupil_radius), float(scene.eye.iris_radius)
    angles, radii = (
        count << int(np.clip(np.ceil(np.log2(side * per_mm / count)), 0, 2))
        for count, side in zip(MAP_SHAPE, (2 * np.pi * root, root - pupil), strict=True)
    )
    cells = cells_of((angles, radii))

    def polar(values: Float[np.ndarray, "rows columns channels"], where: Mask) -> np.ndarray:
        filled = np.moveaxis(fill_holes(values, ~where), -1, 0)
        return np.stack([sampled(c, cells.row, cells.column) for c in filled])

    hidden = sampled(shown.astype(np.float32), cells.row, cells.column) * cells.visible < 0.5

    def maps_of(logs: np.ndarray, residual: np.ndarray | None = None) -> IrisMaps:
        stroma, *melanins = map(jnp.asarray, np.exp(logs))
        held: dict[str, Any] = dict(zip(NAMES[1:], melanins, strict=True))
        if residual is not None:
            held["residual"] = jnp.asarray(np.exp(np.moveaxis(residual, 0, -1)))
        return IrisMaps(stroma_depth=stroma * iris.stroma_thickness, **held)

    # The finest pixels with a table as narrow as the picture's: its errors count where the iris is
    # dark.
    logs = logs - middle
    ends = logs[known].min(0) - _BEYOND, logs[known].max(0) + _BEYOND
    low, high = (end[:, None, None] for end in ends)
    ranges = scale_ranges(iris, maps_of(np.repeat(np.concatenate([low, high], 1), 2, axis=2)))
    response = respond(ranges, scene.replace(iris=iris))
    local = _level(levels[0], (logs, before), response, exposure, gain, _STEPS[-1], doubt=doubt)
    logs = polar(local.logs, known)
    off, encoded = local.off[known], (np.maximum(target * exposure, 0) + DARK)[known] ** POWER
    explained = 1 - (off**2).sum() / ((encoded - encoded.mean(0)) ** 2).sum()

    # What the maps themselves leave, after all interpolation.
    parts = integrator.texels(seen, IrisModel(scene.eye, iris, maps_of(logs)), ranges)
    drawn = picture.within_gamut(response.made.shade(seen, parts, illumination))
    drawn = np.maximum(scatter_to_picture(seen, np.asarray(drawn).T, shape), 1e-9)
    ratio = np.where(shown[..., None], target / gain / drawn, 1.0).astype(np.float32)
    residual = polar(np.log(np.clip(ratio, KEPT.low, KEPT.high)), shown)
    filled = fill_by_texture(np.concatenate([logs, residual]), hidden)
    maps = maps_of(np.clip(filled[: len(NAMES)], low, high), filled[len(NAMES) :])
    covariance = local.covariance[known] + processes
    held = iris.layer_concentrations()
    melanins = np.exp(local.logs[known][:, 1:]) * [held[f"abl_{name}"] for name in NAMES[1:]]
    share = melanins / melanins.sum(1, keepdims=True)
    of_melanin = np.einsum("ni,nij,nj->n", share, covariance[:, 1:, 1:], share)
    sds = np.sqrt(np.einsum("...ii->...i", covariance))
    correlation = np.median(covariance / (sds[:, :, None] * sds[:, None]), axis=0)
    sds[:, 1:] = np.sqrt(sds[:, 1:] ** 2 + _variance_by_exchange(covariance[:, 1:, 1:]))
    deviations = np.zeros((*shape, len(NAMES)), np.float32)
    deviations[known] = sds
    return OwnPigments(
        iris,
        maps,
        polar(deviations, known),
        np.sqrt(np.median(local.common[known], axis=0) + np.diag(processes)),
        float(np.sqrt(np.median(of_melanin))),
        correlation,
        hidden,
        float((np.abs(off).max(-1) > OUTSIDE).mean()),
        float(explained),
        gain,
        response.error,
        illumination,
    )


def _variance_by_exchange(
    covariance: Float[np.ndarray, "texels 2 2"],
) -> Float[np.ndarray, "texels 2"]:
    """Return what the normal approximation lacks of the variances of the melanins' logarithms.

    The two absorb alike. If one is a standard deviation more or less than was found, the other
    makes up for it linearly in its concentration, down to nothing, not in its logarithm.
    """
    variances = np.einsum("...ii->...i", covariance)
    slopes = np.maximum(-covariance[:, :1, 1] / variances[:, ::-1], 0)
    other = np.sqrt(variances[:, ::-1])
    squares = [
        np.log(np.maximum(1 + slopes * (1 - np.exp(side * other)), np.exp(-2 * PRIOR_SD))) ** 2
        for side in (-1, 1)
    ]
    return np.maximum(np.mean(squares, axis=0) - slopes**2 * other**2, 0)


def moved_iris(iris: Iris, factors: Float[np.ndarray, "3"]) -> Iris:
    """The iris with factors `NAMES` on it, its stroma as thick as before: what scatters and absorbs
    there is denser instead.
    """
    stroma, eumelanin, pheomelanin = (float(f) for f in factors)
    values = iris.layer_concentrations()
    for name in values:
        values[name] *= eumelanin if name.endswith("eumelanin") else 1
        values[name] *= pheomelanin if name.endswith("pheomelanin") else 1
        values[name] *= stroma if name.startswith("stroma") else 1
    others = "oxyhemoglobin", "deoxyhemoglobin", "lutein", "zeaxanthin"
    denser = iris.replace(**{name: getattr(iris, name) * stroma for name in others})
    return iris_of_concentrations({**values, "scattering_scale": stroma}, denser)


def find_gain(
    coarsest: Seen, response: TexelResponse, exposure: Float[np.ndarray, "3"]
) -> tuple[float, Local]:
    """Find what the fitted exposure is to be multiplied by.

    An iris that is lit more is less bright itself, and its colours may be more saturated. Where the
    fitted exposure leaves colours outside of what the model can make, the others of `GAINS` are
    tried.

    Args:
        coarsest: What the coarsest pixels show.
        response: The response over `FACTORS`.
        exposure: Exposures of the channels: errors are alike in the encoded photograph.

    Returns:
        The factor, and the numbers of the pixels.
    """
    solutions, errors = {}, {}
    for gain in GAINS:
        solutions[gain] = _coarsest(coarsest, response, exposure, gain)
        differences = solutions[gain].off[coarsest.known]
        errors[gain] = _rms(differences)
        if _are_within(differences):
            return gain, solutions[gain]
    gain = next(g for g in GAINS if errors[g] <= 1.1 * min(errors.values()))
    return gain, solutions[gain]


def _rms(differences: Float[np.ndarray, "pixels 3"]) -> float:
    return float(np.sqrt((differences**2).mean()))


def _are_within(differences: Float[np.ndarray, "pixels 3"]) -> bool:
    """Whether so few colours are none that the model can make that no other exposure is wanted."""
    return bool((np.abs(differences).max(-1) > OUTSIDE).mean() <= _ENOUGH)


def solve_levels(
    levels: list[Seen], response: TexelResponse, exposure: Float[np.ndarray, "3"], gain: float
) -> tuple[np.ndarray, np.ndarray]:
    """Solve all levels but the finest, the coarsest first, each near the numbers of the coarser
    one. Edges stay: a photograph outweighs a prior of this width wherever it shows them.

    Returns:
        Logarithms at the finest pixels, and their covariance as a prior of these.
    """
    local = _coarsest(levels[-1], response, exposure, gain)
    for coarser, level, steps in zip(levels[:1:-1], levels[-2:0:-1], _STEPS[1:-1], strict=True):
        near = _enlarged(local, coarser.known, level.known.shape)
        local = _level(level, near, response, exposure, gain, steps)
    return _enlarged(local, levels[1].known, levels[0].known.shape)


def ranges_about(local: Local, known: Mask, factors: Scales) -> Scales:
    """Return ranges about the numbers of a coarse level, for a table with a smaller error."""
    low, high = np.quantile(local.logs[known], [0.002, 0.998], axis=0)
    spans = [np.exp([a - _MARGIN, b + _MARGIN]) for a, b in zip(low, high, strict=True)]
    return Scales(None, *(np.clip(s, *r) for s, r in zip(spans, factors[1:], strict=True)))


def factors_within_table(scene: Scene) -> Scales:
    """Return `FACTORS`; by radiative transfer the stroma ends where its table of depths does."""
    if not isinstance(scene.integrator, RadiativeIntegrator):
        return FACTORS
    depth = float(scene.tissue.layers(extinction([_SHORTEST])).stroma_scattering[0])
    low, high = FACTORS.stroma
    return FACTORS._replace(stroma=np.array([low, min(high, _REACHED * DEEPEST / depth)]))


def _coarsest(level: Seen, response: TexelResponse, exposure, gain: float) -> Local:
    """Solve the coarsest level: the way down from the nearest of many colours, for on the way from
    the fitted iris there may be other minima.
    """
    low, high = np.log(np.asarray(response.spans())).T
    draws = qmc.Sobol(3, scramble=False).random_base2(_COLOURS)
    candidates = jnp.asarray(low + (high - low) * draws, jnp.float32).T
    near = level.logs, np.broadcast_to(PRIOR_SD**2 * np.eye(3), (*level.known.shape, 3, 3))
    return _level(level, near, response, exposure, gain, _STEPS[0], PRIOR_SD, candidates)


def _enlarged(local: Local, known: Mask, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The logarithms of a coarser level, and their covariance as a prior of the next finer one."""
    size = shape[1], shape[0]

    def enlarged(values: np.ndarray) -> np.ndarray:
        return map_channels(values, lambda c: c.resize(size, Image.Resampling.BILINEAR))

    covariance = enlarged(fill_holes(local.covariance, ~known).reshape(*known.shape, 9))
    finer = _FINER**2 * np.eye(3, dtype=np.float32)
    return enlarged(local.logs), covariance.reshape(*shape, 3, 3) + finer


def _level(
    level: Seen,
    near: tuple[np.ndarray, np.ndarray],
    response: TexelResponse,
    exposure: np.ndarray,
    gain: float,
    steps: int,
    spread: float = _FINER,
    candidates: Array | None = None,
    doubt: np.ndarray | None = None,
) -> Local:
    """Solve the pixels of a level about the numbers of another one, which are `near` with their
    covariance as a prior; the search begins there too, or at the best of the candidates.
    """
    known, tints = level.known, level.light.shape[-1] // response.coefficients.shape[1]
    logs, before = near
    exposed_target = level.target * np.asarray(exposure, np.float32)
    noise = max(_noise(exposed_target, known), CHANNEL_NOISE)
    exposed = jnp.asarray(exposure * gain, jnp.float32)
    parts = logs, level.target / np.float32(gain), level.light, before
    rows = tuple(np.asarray(part[known], np.float32) for part in parts)
    brightest = np.quantile(exposed_target[known], 0.99, axis=0)
    table_error = jnp.asarray(response.error * brightest, jnp.float32)
    doubts = jnp.asarray(np.zeros((3, 3)) if doubt is None else doubt, jnp.float32)
    numbers = exposed, jnp.float32(noise), jnp.float32(spread), jnp.asarray(steps)
    settings = response.coefficients, response.spans(), *numbers, candidates, table_error, doubts
    solve = functools.partial(_solved, response.degrees, tints, settings)
    with ThreadPoolExecutor(2) as pool:
        rows_a_call = _ROWS if candidates is None else _ROWS_COARSEST
        results = map_rows(solve, rows, rows_a_call, pool.map)
    pictures: list[Any] = [np.zeros((*known.shape, *r.shape[1:]), np.float32) for r in results]
    for picture_of, values in zip(pictures, results, strict=True):
        picture_of[known] = values
    return Local(fill_holes(pictures[0], ~known), *pictures[1:])


@eqx.filter_jit
def _solved(degrees: tuple[int, ...], tints: int, settings, rows):
    """Logarithms, their covariances and the variances in these by the exposures, and the errors of
    the channels, of rows of pixels.
    """
    coefficients, spans, exposure, noise, spread, steps, candidates, table_error, doubts = settings
    coefficients = coefficients.astype(spans.dtype)
    low, high = jnp.log(spans).T[..., None]
    first, last = jnp.log1p(products.BEND * spans).T[..., None]
    flat_coefficients = coefficients.reshape(coefficients.shape[0], -1).T
    product_degrees = np.array(products.product_degrees(degrees)).T
    prior = 1 / spread**2
    eye = jnp.eye(3, dtype=spans.dtype)[..., None]

    def encoded(radiance):
        return (jnp.maximum(radiance * exposure[:, None], 0.0) + DARK) ** POWER

    def polynomials(z):
        """Polynomials of the numbers, and their derivatives by the logarithms."""
        bent = 1 + products.BEND * jnp.exp(z)
        place = jnp.clip((jnp.log(bent) - first) * (2 / (last - first)) - 1, -1, 1)
        moved = (bent - 1) / bent * (2 / (last - first))
        both = [chebyshev(x, d + 1) for x, d in zip(place, degrees, strict=True)]
        values, slopes = ([jnp.stack(b[i]) for b in both] for i in (0, 1))
        return values, [s * m for s, m in zip(slopes, moved, strict=True)]

    def response(terms):
        """The response without light, (functions, channels, pixels)."""
        rows = [t[k] for t, k in zip(terms, product_degrees, strict=True)]
        values = flat_coefficients @ functools.reduce(jnp.multiply, rows)
        return values.reshape(*coefficients.shape[1:], -1)

    def total(terms):
        """Sum over the first axis, term by term: XLA's reduction takes longer than the product."""
        return functools.reduce(jnp.add, list(terms))

    colours = None if candidates is None else response(polynomials(candidates)[0])

    def solve(pixels):
        centre, target, light, before = pixels
        wanted, light = encoded(target), light.reshape(tints, -1, light.shape[-1])
        # The error of the table counts most where the encoding is steep: in the dark.
        weight = 1 / (noise**2 + (POWER * wanted ** (1 - 1 / POWER) * table_error[:, None]) ** 2)
        light = jnp.moveaxis(light, 1, 0)  # functions, tints, pixels

        def around(z):
            values, slopes = polynomials(z)
            modelled = total(response(values) * light)
            pushed = [
                total(response([slopes[i] if j == i else values[j] for j in range(3)]) * light)
                for i in range(3)
            ]
            lit = jnp.maximum(modelled * exposure[:, None], 0.0) + DARK
            steep = POWER * lit ** (POWER - 1)
            rates = jnp.stack(pushed) * (steep * exposure[:, None])
            error = encoded(modelled) - wanted
            # Colours that the model cannot make keep their brightness.
            dim, dims = error.mean(0), rates.mean(1)
            bright = _BRIGHTNESS * weight.min(0)
            cost = total(weight * error**2) + bright * dim**2 + prior * total((z - centre) ** 2)
            slope = -total(jnp.moveaxis(weight * rates * error, 1, 0)) - bright * dims * dim
            slope = slope - prior * (z - centre)
            channels = zip(weight, jnp.moveaxis(rates, 1, 0), strict=True)
            information = total(w * r[:, None] * r for w, r in channels) + prior * eye
            # The force of a channel's logarithm of exposure on the numbers.
            pull = weight * rates * (steep * (lit - DARK))
            whole = information + bright * dims[:, None] * dims
            return cost, slope, whole, information, pull, error

        def unfinished(state):
            return (state[0] < steps) & (state[1] > _SLIGHT)

        def step(state):
            count, _, *at = state
            z, (cost, slope, matrix, *_), damping = at
            # A logarithm at the end of its range that would leave it is held.
            at_end = ((z <= low) & (slope < 0)) | ((z >= high) & (slope > 0))
            free = jnp.where(at_end, 0.0, 1.0)
            damped = matrix * (1 + damping * eye) * free[:, None] * free + eye * (1 - free)
            move = total(_inverse(damped) * (slope * free)[:, None])  # symmetric
            moved = jnp.clip(z + jnp.clip(move, -_LONGEST, _LONGEST), low, high)
            trial = around(moved)
            better = trial[0] < cost
            choose = functools.partial(jnp.where, better)
            accepted = jax.tree.map(choose, (moved, trial), (z, at[1]))
            # A step that was refused is tried again, shorter: what it promised counts.
            gained = jnp.where(better, cost - trial[0], (slope * move).sum(0)).max()
            return count + 1, gained, *accepted, damping * jnp.where(better, 0.3, 4.0)

        start = centre
        if candidates is not None and colours is not None:
            seen = total(c[..., None] * s[:, None] for c, s in zip(colours, light, strict=True))
            seen = encoded(seen.reshape(3, -1)).reshape(3, *colours.shape[2:], -1)
            error = seen - wanted[:, None]
            away = candidates[..., None] - centre[:, None]
            near = total(weight[:, None] * error**2) + prior * total(away**2)
            near = near + _BRIGHTNESS * weight.min(0) * error.mean(0) ** 2
            best = jnp.argmin(near, axis=0)
            start = candidates[:, best]
        start = jnp.clip(start, low, high)
        begin = start, around(start), jnp.full_like(start[0], _DAMPING)
        begin = jnp.zeros_like(steps), jnp.asarray(jnp.inf, start.dtype), *begin
        *_, z, (*_, information, pull, error), _ = jax.lax.while_loop(unfinished, step, begin)
        # The coarser levels, which a prior is about, move with the exposures as well.
        firm = _inverse(information + (1 / PRIOR_SD**2 - prior) * eye)
        moved = total(f[:, None] * p for f, p in zip(firm, pull, strict=True))
        common = total(moved[:, None, c] * (doubts[c][:, None] * moved).sum(1) for c in range(3))
        known = _inverse(information - prior * eye + _inverse(before))
        return z, known + common, jnp.einsum("iip->ip", common), error

    results = map_chunks(solve, tuple(jnp.moveaxis(r, 0, -1) for r in rows))
    return tuple(jnp.moveaxis(f, -1, 0) for f in results)


def _inverse(a):
    """Inverses of symmetric matrices (3, 3, pixels)."""

    def minor(i: int, j: int):
        p, q, r, s = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return a[p, r] * a[q, s] - a[p, s] * a[q, r]

    cofactors = jnp.stack([jnp.stack([minor(i, j) for j in range(3)]) for i in range(3)])
    return cofactors / (a[0] * cofactors[0]).sum(0)


def _some_of(known: Mask) -> Mask:
    """Return at most `_TRIED` of the pixels, evenly."""
    step = max(math.ceil(known.sum() / _TRIED), 1)
    return known & (np.cumsum(known).reshape(known.shape) % step == 0)


def _halved(level: Seen) -> Seen:
    """Means over squares of 2 × 2 pixels, of those that count."""
    known = level.known[..., None].astype(np.float32)
    count = half_size(known)

    def mean(values):
        return half_size(values * known) / np.maximum(count, 1e-6)

    parts = mean(level.target), mean(level.light), mean(level.logs)
    return Seen(*parts, count[..., 0] > 0.2)


def _noise(values: Colours, known: Mask) -> float:
    """Standard deviation of an encoded channel's noise, by the median  [Immerkær 1996]."""
    encoded = np.maximum(values, 0) ** POWER
    second = ndimage.convolve1d(ndimage.convolve1d(encoded, [1, -2, 1], 0), [1, -2, 1], 1)
    inside = ndimage.binary_erosion(known, np.ones((3, 3)))
    return float(np.median(np.abs(second[inside]))) / (6 * 0.6745) if inside.any() else 0.0
