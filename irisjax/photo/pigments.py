"""Pigments from the colours of windows: least squares, F09's simplex [F09 Eqs. 13, 14], posterior.

A photograph is light times an unknown exposure, through a camera of unknown white balance and
contrast. These are free beside the four concentrations, which they make less certain.

Other errors of the model are integrated out of the likelihood. An iris is not as thick as the
average one and its relief shades otherwise. Both differ from iris to iris, from ring to ring of
one, and from window to window of a ring: normal errors of three levels, as in an analysis of
variance with random effects, where those of neighbouring windows are correlated. In the logarithms
of the channels, an error of the thickness of the whole or of a ring is proportional to the model's
own response to it, and one of light is equal in all channels. The scatter of the windows of a ring
and the spread of the rings are estimated from the photograph itself: irides contain more than
pigments and thickness, may have another colour around the pupil, and light may fall off as that of
no lamp of the model does.
"""

import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float
from scipy import linalg as scipy_linalg
from scipy import stats
from scipy.stats import qmc

from irisjax._types import PRNGKey, Scalar
from irisjax.infer.importance import Start, importance_sample
from irisjax.infer.least_squares import least_squares, levenberg_marquardt
from irisjax.infer.priors import AbstractPrior, LogNormal
from irisjax.numerics import linear
from irisjax.numerics.chunks import map_rows
from irisjax.numerics.streams import words_of
from irisjax.photo.windows import ANGLES, RINGS, Windows
from irisjax.tissue.iris import CONCENTRATIONS, Iris

_PHEOMELANIN_PER_EUMELANIN = 0.226  # with which F09 begins [F09 Section 5.2]
PRIORS: dict[str, AbstractPrior] = {
    "abl_eumelanin": LogNormal(1.0, 1.6),
    "abl_pheomelanin": LogNormal(0.25, 1.6),
    "stroma_eumelanin": LogNormal(0.08, 1.2),
    "stroma_pheomelanin": LogNormal(0.05, 1.6),
    "hemoglobin": LogNormal(0.15, 0.8),
    "scattering_scale": LogNormal(1.5, 1.0),
    "room": LogNormal(0.1, 1.2),
    "exposure": LogNormal(1.0, 0.7),
    "red_gain": LogNormal(1.0, 0.08),
    "blue_gain": LogNormal(1.0, 0.08),
    "contrast": LogNormal(1.0, 0.05),
}
"""Free parameters and their priors.

Concentrations: LB06's levels, from 0.045 to 4.3 mg/ml of eumelanin in the ABL and from 0.009 to
0.58 in the stroma, and what photographed irides require. Haemoglobin: LB06's and what their redness
requires, up to five times as much. Scattering: a factor on the iris's own, whose fibrils scatter
seven times as much as LB06's: photographed irides require 10 to 40 times. Room: radiance of light
from all round beside lamps whose irradiance is π together, if lamps were inferred from highlights.
Camera: exposure relative to that of a white sheet in the given light, white balance of red and blue
against green, and the power with which values grow with light.
"""
FREE_NAMES = tuple(PRIORS)
PIGMENT_UNITS = dict.fromkeys(FREE_NAMES, "") | dict.fromkeys(CONCENTRATIONS, "mg/ml")
PIGMENT_UNITS["hemoglobin"] = "mmol/l"
# RMS of ln photograph over model in the windows, channels weighted by brightness, above which a fit
# is doubtful: of irides with uneven pigments the intervals of an even one hold the mean melanin of
# the ABL in 80 of 100 below, 57 up to 0.55, and 29 beyond (experiments/clone_uneven.py).
_WINDOWS_OFF = 0.33
_UNUSUAL = 3.0  # standard deviations of its prior beyond which a parameter is doubtful
_STEPS = 60, 50  # most of a turn of least squares, and of a stage of the simplex
_TURNS = 3  # of least squares under fixed covariances, and of these
_CLOSE = 1e-3  # tolerance of the search, in standard deviations of the prior
# Standard deviation of the logarithm of the exposure that mirror images tell, which is 2 to 6 % too
# little in simulated photographs; a camera's curve adds to it.
_EXPOSURE_SPREAD = 0.15
_FLOOR = 0.01  # of the photograph's mean, below which colours do not count
# Searches begin at the priors' medians, at these with one of the first six parameters `_FAR`
# standard deviations off, and at the most probable of draws that are `_DISTINCT` in one parameter.
# The posterior often has several maxima: a dark iris in much light and one that scatters strongly
# in little, or a stroma that shows and one that a pigment makes opaque. From four fixed starts the
# highest was missed in two of six photographs of people.
_FAR, _MOVED = 3.0, 6
_DRAWN, _SEARCHES, _DISTINCT = 2048, 8, 1.5
_NEAR = 2.0  # standard deviations within which two searches have found one maximum
_LOWER = 12.0  # by which a maximum's log density is lower than the highest and does not matter
EFFECTIVE, _ROUNDS = 4096, 32
"""Effective draws of a posterior that are wanted; most rounds of importance sampling for them."""
_ROWS = 12  # densities computed at a time
_EUMELANIN, _PHEOMELANIN = slice(0, 4, 2), slice(1, 4, 2)  # of the concentrations, which are first
_OF_CONCENTRATIONS: list[Any] = [PRIORS[name] for name in CONCENTRATIONS]
_CENTRES = np.log([prior.median for prior in _OF_CONCENTRATIONS]).reshape(2, 2).T
_SCALES = np.reshape([prior.spread for prior in _OF_CONCENTRATIONS], (2, 2)).T
WindowColours = Float[Array, "windows 3"]
_Present = Bool[ArrayLike, " windows"]
_Covariances = tuple[Float[Array, "rings 3 3"], Float[Array, "means means"]]


class Spreads(NamedTuple):
    """Standard deviations of the logarithms of thickness, light, and each channel by itself."""

    thickness: float
    light: float
    channel: float


WHOLE = Spreads(0.15, 0.1, 0.0)
"""Errors of a whole iris: assumed. Errors of single channels are the camera's white balance."""
RING = Spreads(0.12, 0.08, 0.02)
"""Errors of the rings of one iris, by its collarette, folds and colours: assumed; the light of
those of `procedural` differs by 0.01.
"""
SPREAD_FACTORS = 2.0 ** np.arange(4)  # on `RING`, with a 1/x prior: the photograph decides
_GREEN = np.array([0.55, 0.33, 0.15])  # response of a green iris to thickness
PRIOR_COVARIANCE = 0.04**2 + 0.06**2 * np.outer(_GREEN, _GREEN) + 0.007**2 * np.eye(3)
"""Prior covariance of a window's channels about its ring: light, thickness, each by itself."""
PRIOR_WINDOWS = 5.0  # number of windows that the prior counts for
ALONG_RAYS, ALONG_RINGS = 0.6, 0.3
"""Correlation of the errors of a window with those of the next one outwards, and round the iris:
fibres and the gaps between them run radially through several rings, and sectors are wider than a
window. Correlations are 0.5 and 0.35 in six photographs of people, 0.65 and 0.15 in irides of
`procedural`. Taken for independent, a bright sector looks like light from its side.
"""
_RING_CORRELATION = scipy_linalg.circulant(
    ALONG_RINGS ** np.minimum(np.arange(ANGLES), ANGLES - np.arange(ANGLES))
)


class PigmentFit(NamedTuple):
    """The best pigments and camera.

    Attributes:
        values: Values by name.
        z: The same as standard normal numbers of their priors.
        covariance: Covariance of `z` in normal approximation.
        rms: Root mean square of ln photograph over model in the windows, per channel.
        steps: Number of steps.
        converged: Whether the search ended by itself.
        log: Course of the search, a row of numbers by name for each turn.
        others: Other maxima of the posterior, the highest first.
        log_density: Logarithm of the posterior density, without constants; NaN of the simplex's.
    """

    values: dict[str, float]
    z: Float[np.ndarray, " free"]
    covariance: Float[np.ndarray, "free free"]
    rms: Float[np.ndarray, "3"]
    steps: int
    converged: bool
    log: tuple[dict[str, float], ...] = ()
    others: tuple["PigmentFit", ...] = ()
    log_density: float = math.nan

    def maxima(self) -> Iterator["PigmentFit"]:
        """Yield all maxima, each with the rest as its others."""
        every = self._replace(others=()), *self.others
        for i, one in enumerate(every):
            yield one._replace(others=every[:i] + every[i + 1 :])

    def iris(self, base: Iris) -> Iris:
        """Return the iris of these pigments."""
        values = {name: jnp.asarray(value) for name, value in self.values.items()}
        return iris_of_concentrations(values, base)


class Estimate(NamedTuple):
    """A parameter as estimated from its samples.

    Attributes:
        low: The 2.5 % quantile.
        high: The 97.5 % quantile.
        contraction: One minus the variance over the prior's, in the coordinate in which the prior
            is a standard normal; 0 if the photograph does not constrain the parameter.
    """

    median: float
    sd: float
    low: float
    high: float
    contraction: float


class PigmentPosterior(NamedTuple):
    """Samples of the posterior.

    Attributes:
        samples: Values of each parameter, by name.
        estimates: The same in numbers.
        z: The samples as standard normal numbers of their priors.
        effective: Number of effective draws.
        rounds: Rounds of importance sampling, of `importance.DRAWS` draws each.
        converged: Whether there are enough effective draws.
    """

    samples: dict[str, Float[np.ndarray, " samples"]]
    estimates: dict[str, Estimate]
    z: Float[np.ndarray, "samples free"]
    effective: float
    rounds: int
    converged: bool


def parameter_values(z: Float[Array | np.ndarray, " free"]) -> dict[str, Any]:
    """Return the parameters, by name, of standard normal numbers (free,)."""
    return {name: prior.value(z[i]) for i, (name, prior) in enumerate(PRIORS.items())}


def predicted_colours(values: dict[str, Any], windows: Windows, base: Iris) -> Array:
    """Return the linear values of a photograph of the iris, (windows, 3)."""
    return _recorded(values, windows.radiance(iris_of_concentrations(values, base), values["room"]))


def log_posterior(z: Float[Array, " free"], windows: Windows, base: Iris) -> Scalar:
    """Return the logarithm of the posterior density of z (free,), without constants."""
    return _log_posterior_of(_log_ratios(parameter_values(z), windows, base), z, windows)


def fit_pigments(windows: Windows, base: Iris) -> PigmentFit:
    """Fit the pigments by least squares through the differentiable renderer, from several starts.

    Steps of Levenberg and Marquardt alternate with estimates of the covariances of the errors.
    """
    starts = _starts(windows, base)
    results = jax.tree.map(np.asarray, _searches(starts, windows, base))
    (z, log_density), (steps, converged), spread = results
    best, *others = _maxima(z[:, -1], spread, log_density[:, -1])
    log = []
    for place in np.ndindex(len(starts), _TURNS):
        row = {"start": place[0] + 1, "turn": place[1] + 1, "steps": steps[place]}
        row |= {"log_density": log_density[place]}
        log.append(_numbers(row | parameter_values(jnp.asarray(z[place]))))

    def fit(i: int) -> PigmentFit:
        known = z[i, -1], spread[i], windows, base, int(np.sum(steps)), bool(converged[i, -1])
        return _fit(*known, log, float(log_density[i, -1]))

    return fit(best)._replace(others=tuple(map(fit, others)))


def exposures_for(fit: PigmentFit, windows: Windows, base: Iris) -> Float[np.ndarray, "3"]:
    """Return the exposures of the channels with which windows, of other maps than those of the fit,
    are on average as bright as the photograph's, in the fit's white balance.
    """
    return np.asarray(_rms_and_exposures(jnp.asarray(fit.z), windows, base)[1])


def doubt_of_exposures(fit: PigmentFit) -> Float[np.ndarray, "3 3"]:
    """Return the covariance of the logarithms of the channels' exposures, in normal approximation.

    `contrast`, which acts much as they do within the range of an iris, is left out.
    """
    slope = np.asarray(_slope_of_exposures(fit.z))
    return slope @ fit.covariance @ slope.T


def sd_of_abl_melanin(fit: PigmentFit) -> float:
    """Return the standard deviation of the logarithm of the ABL's melanin, in normal
    approximation.
    """
    held = np.array([fit.values[name] for name in CONCENTRATIONS[:2]])
    slope = held / held.sum() * _SCALES[:, 0]
    return float(np.sqrt(slope @ fit.covariance[:2, :2] @ slope))


def mean_misfit(fit: PigmentFit, windows: Windows) -> float:
    """Return the root mean square of ln photograph over model in the windows, over all channels
    weighted by brightness.
    """
    weights = np.maximum(windows.colour[windows.present].mean(0), 0)
    return float(np.sqrt(np.average(fit.rms**2, weights=weights + 1e-9)))


def misfits(fit: PigmentFit, windows: Windows) -> list[str]:
    """Return sentences on where the model does not follow the photograph, or follows it only with
    values that hardly any eye has.
    """
    doubts = []
    if mean_misfit(fit, windows) > _WINDOWS_OFF:
        doubts.append(
            "one set of pigments does not follow the colours of the iris (off by factors of "
            f"{', '.join(f'{f:.2f}' for f in np.exp(fit.rms))} in R, G, B over it, RMS): its "
            "intervals are too narrow; where texels have pigments of their own, the interval of "
            "their mean melanin allows for it"
        )
    for name, z in zip(FREE_NAMES, fit.z, strict=True):
        if abs(z) > _UNUSUAL:
            low, high = (float(PRIORS[name].value(s)) for s in (-1.96, 1.96))
            unit = f" {PIGMENT_UNITS[name]}" if PIGMENT_UNITS[name] else ""
            doubts.append(
                f"{name} is {fit.values[name]:.3g}{unit}, far from what is usual ({low:.2g} to "
                f"{high:.2g}): the model may not fit this photograph"
            )
    if not fit.converged:
        doubts.append("the search for the pigments did not converge")
    return doubts


def strange_white(fit: PigmentFit, windows: Windows) -> Float[np.ndarray, "3"] | None:
    """Return the colour of the white of the eye over that of a usual one in the light of the fit;
    `None` if it is not unusual.
    """
    if np.abs(_errors_of_light(fit.values, windows)[:3]).max() < _UNUSUAL:
        return None
    return windows.white.colour / np.exp(np.asarray(_log_white(fit.values, windows)))


def simplex(
    windows: Windows,
    base: Iris,
    known: Mapping[str, float] | None = None,
    max_steps: int = _STEPS[1],
) -> PigmentFit:
    """Fit the pigments by F09's search  [F09 Section 5.2].

    Nelder and Mead's simplex finds the eumelanins with pheomelanin tied to them, then the two
    ratios. The log has the values and the relative RMS at each stage.

    Args:
        windows: The windows.
        base: Iris that fixes everything but melanins and scattering.
        known: Values of the other free parameters by name: F09 measured exposure and light before.
            Those that are not given keep the medians of their priors.
        max_steps: Most steps of a stage.
    """
    log: list[dict[str, float]] = []
    rest = {n: float(p.value(0.0)) for n, p in PRIORS.items() if n not in CONCENTRATIONS}
    rest |= known or {}
    z = np.array([PRIORS[n].standard(rest[n]) if n in rest else 0.0 for n in FREE_NAMES])
    medians = [PRIORS[name].value(0.0) for name in ("abl_eumelanin", "stroma_eumelanin")]
    # Logarithms of the eumelanins, and of the ratios.
    logs = [jnp.log(jnp.asarray(v, float)) for v in (medians, [_PHEOMELANIN_PER_EUMELANIN] * 2)]
    steps, converged = 0, True
    for stage in (0, 1):
        both = logs[stage], logs[1 - stage]
        fixed = windows, base, {n: jnp.asarray(v) for n, v in rest.items()}
        logs[stage], count, result = _simplex_stage(*both, *fixed, stage == 0, max_steps)
        steps, converged = steps + int(count), converged and bool(result)
        values = _concentrations(*logs)
        z[:4] = [PRIORS[name].standard(values[name]) for name in CONCENTRATIONS]
        rms = _rms_and_exposures(jnp.asarray(z), windows, base)[0].mean()
        log.append(_numbers(values | {"steps": count, "rms": rms}))
    return _fit(z, np.eye(len(FREE_NAMES)), windows, base, steps, converged, log)


def sample_pigments(
    windows: Windows, base: Iris, best: PigmentFit, *, key: PRNGKey
) -> PigmentPosterior:
    """Sample the posterior of concentrations, light and camera by `importance_sample`, from all
    maxima on that the fit has found; the base fixes everything but melanins and scattering.
    """
    approximations = []
    for known in (best, *best.others):
        middle, slope = map(np.asarray, _totals_and_slope(jnp.asarray(known.z)))
        approximations.append(Start(middle, slope @ known.covariance @ slope.T))
    start, *others = approximations
    random = np.random.RandomState(words_of(key))
    density = partial(_densities, (windows, base))
    found = importance_sample(
        density, start, random, others=others, rounds=_ROUNDS, effective=EFFECTIVE
    )
    values = map_rows(_values_of_draws, found.samples, EFFECTIVE)
    z = values.pop("z")
    estimates = {}
    for i, name in enumerate(FREE_NAMES):
        low, median, high = (float(v) for v in np.quantile(values[name], [0.025, 0.5, 0.975]))
        sd, contraction = float(values[name].std()), float(1 - z[:, i].var())
        estimates[name] = Estimate(median, sd, low, high, contraction)
    samples = {name: values[name] for name in FREE_NAMES}
    return PigmentPosterior(samples, estimates, z, found.effective, found.rounds, found.enough)


def iris_of_concentrations(values: dict[str, Any], base: Iris) -> Iris:
    """Return the iris of four concentrations (mg/ml of each layer); a factor on scattering and the
    haemoglobin (mmol/l) may be given with them.
    """
    scale = values.get("scattering_scale", 1.0) * base.scattering_scale
    blood = {"hemoglobin": values["hemoglobin"]} if "hemoglobin" in values else {}
    return base.with_layers(values).replace(scattering_scale=scale, **blood)


def log_likelihood(log_ratios: WindowColours, response: WindowColours, present: _Present) -> Scalar:
    """Return the logarithm of the density of errors, without constants.

    That of the rings' means is a mixture of normal densities over `SPREAD_FACTORS`. That of windows
    about them, less what their neighbours tell (`ALONG_RAYS`), is a matrix t: the normal density
    with the inverse Wishart prior of its covariance integrated out [Gelman et al. 2013,
    Section 3.6].

    Args:
        log_ratios: Logarithms of photograph over model, ring after ring.
        response: Derivatives of the model's by that of thickness; their means in rings count.
        present: Windows that count.
    """
    within, free, _, densities = _error_levels(log_ratios, response, present)
    # JAX has a formula for 3 × 3, and calls no LAPACK for it.
    of_windows = free * jnp.log(jnp.linalg.det(within))  # noqa: TID251
    return jax.nn.logsumexp(densities) - 0.5 * of_windows.sum()


def whitened_errors(
    log_ratios: WindowColours, present: _Present, fixed: _Covariances
) -> Float[Array, " values"]:
    """Return errors as numbers of unit variance, under fixed covariances."""
    _, means, differences = _in_rings(log_ratios, present)
    within, between = fixed
    rows, _ = jax.vmap(jax.vmap(linear.whiten, (None, 0)))(_roots(within), differences)
    row, _ = linear.whiten(linear.cholesky(between), means.ravel())
    return jnp.concatenate([rows.ravel(), row])


def covariances(
    log_ratios: WindowColours, response: WindowColours, present: _Present
) -> _Covariances:
    """Return the most likely covariance of a window's channels about its ring's mean, and that of
    the rings' means weighted by the probability of each factor.

    With it a step of least squares is one of expectation and maximisation over `SPREAD_FACTORS`.
    """
    within, _, between, densities = _error_levels(log_ratios, response, present)
    share = jax.nn.softmax(densities)
    inverse = (share[:, None, None] * jax.vmap(_inverse)(between)).sum(0)
    return within, _inverse(0.5 * (inverse + inverse.T))


def _recorded(values, radiance):
    """Values that the camera records for radiances."""
    # Negative values, out of sRGB's range, have no power: the curve continues in a straight line.
    positive = jnp.maximum(radiance, 1e-4)
    return _exposures(values) * (positive ** values["contrast"] + (radiance - positive))


def _exposures(values):
    red, blue = values["red_gain"], values["blue_gain"]
    return values["exposure"] * jnp.stack([red, jnp.ones_like(red), blue])


def _errors_of_light(values, windows: Windows):
    """Errors of the exposure that mirror images tell and of the colour of the white of the eye, in
    standard deviations, (4,). A bound that is kept is no error.
    """
    error = (jnp.log(values["exposure"]) - jnp.log(windows.exposure)) / _EXPOSURE_SPREAD
    mirrored = jnp.where(windows.at_least & (error > 0), 0.0, error)
    of_white = windows.white.root @ (_log_white(values, windows) - jnp.log(windows.white.colour))
    return jnp.append(of_white, mirrored)


def _log_white(values, windows: Windows):
    """Logarithms of the values that the camera records of a usual white."""
    light = windows.white.light + windows.in_room * values["room"]
    radiance = windows.white.reflectance * light
    return jnp.log(_exposures(values)) + values["contrast"] * jnp.log(radiance)


def _log_ratios(values, windows: Windows, base: Iris):
    """Logarithms of photograph over model, (windows, 3), and the derivatives of the model's by that
    of the stroma's thickness.

    With differences relative to the photograph instead, a black model would be off by one
    everywhere, which a common factor would explain.
    """
    floor = _FLOOR * windows.colour.mean(where=windows.present[:, None])
    recorded = jnp.maximum(windows.colour, 0) + floor
    lowest = 0.1 * floor

    def log_ratios_of(radiance):
        # A channel out of sRGB's range may be negative; the logarithm keeps a slope there.
        modelled = _recorded(values, radiance) + floor
        bent = lowest * jnp.exp(jnp.minimum(modelled / lowest - 1, 0.0))
        log_ratios = jnp.log(recorded / jnp.where(modelled > lowest, modelled, bent))
        return jnp.where(windows.present[:, None], log_ratios, 0.0)

    iris = iris_of_concentrations(values, base)
    radiance, slope = windows.radiance_and_slope(iris, values["room"])
    log_ratios, slope_of_ratios = jax.jvp(log_ratios_of, (radiance,), (slope,))
    return log_ratios, -slope_of_ratios


def _starts(windows: Windows, base: Iris) -> Float[np.ndarray, "starts free"]:
    """Return where searches begin: near and far from the priors' medians, and where they are most
    probable among draws of the priors.
    """
    free = [i for i, n in enumerate(FREE_NAMES) if n != "room" or windows.in_room]
    draws = stats.norm.ppf(qmc.Sobol(len(free), rng=0).random(_DRAWN))
    x = np.zeros((_DRAWN, len(FREE_NAMES)))
    x[:, free] = draws
    densities = _densities((windows, base), x)
    chosen = np.zeros((0, len(FREE_NAMES)))
    for row in x[np.argsort(-densities, kind="stable")]:
        if (np.abs(row - chosen).max(-1) > _DISTINCT).all():
            chosen = np.append(chosen, row[None], axis=0)
        if len(chosen) == _SEARCHES:
            break
    drawn = np.asarray(map_rows(_values_of_draws, chosen, EFFECTIVE)["z"])
    moved = _FAR * np.eye(_MOVED, len(FREE_NAMES))
    return np.concatenate([np.zeros((1, len(FREE_NAMES))), moved, -moved, drawn])


def _maxima(z, covariances, log_density) -> list[int]:
    """Return which searches found maxima of their own, the highest first."""
    found: list[int] = []
    for i in np.argsort(-log_density, kind="stable"):  # `log_posterior` is never NaN
        if found and log_density[i] <= log_density[found[0]] - _LOWER:
            break
        away = [z[i] - z[k] for k in found]
        squares = (d @ np.linalg.solve(covariances[k], d) for k, d in zip(found, away, strict=True))
        if all(square > _NEAR**2 for square in squares):
            found.append(int(i))
    return found


def _log_posterior_of(log_ratios, z, windows: Windows):
    """The logarithm of the posterior density, from the result of `_log_ratios` at z."""
    differences, response = log_ratios
    density = log_likelihood(differences, response, windows.present)
    errors = _errors_of_light(parameter_values(z), windows)
    density -= 0.5 * ((z**2).sum() + (errors**2).sum())
    return jnp.where(jnp.isfinite(density), density, -jnp.inf)


@eqx.filter_jit
def _searches(starts, windows, base):
    # The program holds the model twice, at a start and with its derivatives: all else is computed
    # from what these return.
    def residuals(z, weight, fixed):
        del weight  # the priors count in full
        values = parameter_values(z)
        log_ratios = _log_ratios(values, windows, base)
        errors = whitened_errors(log_ratios[0], windows.present, fixed)
        return jnp.concatenate([errors, _errors_of_light(values, windows), z]), log_ratios

    def turn(state, _):
        z, (differences, response) = state
        fixed = covariances(differences, response, windows.present)
        solver = levenberg_marquardt(_CLOSE, _CLOSE)
        found = least_squares(residuals, fixed, z, solver=solver, max_steps=_STEPS[0])
        converged = found.result == optx.RESULTS.successful
        density = _log_posterior_of(found.aux, found.x, windows)
        result = (found.x, density), (found.steps, converged), found.covariance
        return (found.x, found.aux), result

    def search(start):
        log_ratios = _log_ratios(parameter_values(start), windows, base)
        turns, counts, covariance = jax.lax.scan(turn, (start, log_ratios), None, _TURNS)[1]
        return turns, counts, covariance[-1]

    return jax.lax.map(search, starts)


def _concentrations(eumelanin, ratios):
    abl, stroma = jnp.exp(eumelanin)
    first, second = jnp.exp(ratios)
    return dict(zip(CONCENTRATIONS, (abl, first * abl, stroma, second * stroma), strict=True))


@eqx.filter_jit
def _simplex_stage(start, others, windows, base, rest, eumelanin: bool, max_steps: int):
    def cost(x, _):
        concentrations = _concentrations(x, others) if eumelanin else _concentrations(others, x)
        log_ratios, _ = _log_ratios({**concentrations, **rest}, windows, base)
        return (log_ratios**2).mean(where=windows.present[:, None])

    solution = optx.minimise(
        cost, optx.NelderMead(1e-4, 1e-6), start, max_steps=max_steps, throw=False
    )
    return solution.value, solution.stats["num_steps"], solution.result == optx.RESULTS.successful


def _fit(
    z, covariance, windows, base, steps: int, converged: bool, log, log_density: float = math.nan
) -> PigmentFit:
    values = _numbers(parameter_values(jnp.asarray(z)))
    rms = np.asarray(_rms_and_exposures(jnp.asarray(z), windows, base)[0])
    known = values, z, covariance, rms, steps, converged, tuple(log)
    return PigmentFit(*known, log_density=log_density)


def _numbers(row: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in row.items()}


@eqx.filter_jit
def _rms_and_exposures(z, windows, base):
    """Relative differences per channel, and exposures as bright as the photograph. Channels keep
    the balance of the fit: a tint of the iris that the model does not follow is not one of the
    light, which would show on the white of the eye.
    """
    values, present = parameter_values(z), windows.present[:, None]
    log_ratios, _ = _log_ratios(values, windows, base)
    brightness = jnp.maximum(windows.colour.mean(0, where=present), 0.0)
    factor = (log_ratios.mean(0, where=present) * brightness).sum() / brightness.sum()
    exposures = _exposures(values) * jnp.exp(factor)
    return jnp.sqrt((log_ratios**2).mean(0, where=present)), exposures


def _error_levels(log_ratios, response, present):
    """The most likely covariance within rings, the windows that count for each, and the covariances
    of their means for each factor with the logarithms of their densities.
    """
    number, means, differences = _in_rings(log_ratios, present)
    along = _in_rings(response, present)[1]
    scatter = PRIOR_WINDOWS * jnp.asarray(PRIOR_COVARIANCE)
    scatter = scatter + jnp.einsum("rni,rnj->rij", differences, differences)
    free = PRIOR_WINDOWS + jnp.maximum(number - 1, 0)
    within = scatter / free[:, None, None]

    def covariance_of(level: Spreads):
        squares = level.thickness**2 * along[:, None, :, None] * along[None, :, None, :]
        return squares + level.light**2 + level.channel**2 * jnp.eye(3)

    rings = jnp.arange(RINGS)
    # Variance of a mean. Means of neighbouring rings are correlated too, which is little beside
    # `RING`.
    counted = jnp.asarray(present, within.dtype).reshape(RINGS, ANGLES)
    correlated = jnp.einsum("ra,ab,rb->r", counted, _RING_CORRELATION, counted)
    of_mean = within * (correlated / jnp.maximum(number, 1) ** 2)[:, None, None]
    factors = jnp.asarray(SPREAD_FACTORS**2)[:, None, None, None]
    own = factors * covariance_of(RING)[rings, rings] + of_mean
    has_windows = (number > 0)[:, None, None]
    between = covariance_of(WHOLE) * (has_windows[:, None] & has_windows[None])
    between = jnp.broadcast_to(between, (len(SPREAD_FACTORS), *between.shape))
    # Rings without windows are independent with a variance of 1.
    between = between.at[:, rings, rings].add(jnp.where(has_windows, own, jnp.eye(3)))
    between = between.transpose(0, 1, 3, 2, 4).reshape(-1, 3 * RINGS, 3 * RINGS)
    rows, logs = jax.vmap(linear.whiten, (0, None))(_roots(between), means.ravel())
    density = -0.5 * (rows**2).sum(-1) - logs.sum(-1)
    return within, free, between, density - jnp.log(jnp.asarray(SPREAD_FACTORS))


_roots = jax.vmap(linear.cholesky)


def _inverse(a):
    return linear.solve(a, jnp.eye(len(a)))


def _in_rings(values, present):
    """Number of windows of each ring, their mean values, and the differences from it: of these,
    what the windows next to them do not tell, scaled to the same variance.

    Approximation: rings next to one another scatter equally. On average they do within a half.
    """
    counted = jnp.asarray(present).reshape(RINGS, ANGLES, 1)
    by_ring = values.reshape(RINGS, ANGLES, 3)
    number = counted.sum(1)[:, 0]

    def centred(values):
        means = jnp.where(counted, values, 0).sum(1) / jnp.maximum(number, 1)[:, None]
        return means, jnp.where(counted, values - means[:, None], 0)

    means, differences = centred(by_ring)
    inner, seen = (jnp.pad(x, ((1, 0), (0, 0), (0, 0)))[:-1] for x in (differences, counted))
    along_rays = _unexplained(differences, inner, counted & seen, ALONG_RAYS)
    # The windows further in may be others than those of the ring, and have another mean.
    _, differences = centred(along_rays)
    before, seen = (jnp.roll(x, 1, 1) for x in (differences, counted))
    return number, means, _unexplained(differences, before, counted & seen, ALONG_RINGS)


def _unexplained(values, neighbours, seen, correlation: float):
    """Subtract from values what the neighbours that are seen tell of them; the rest is scaled to
    the same variance.
    """
    rest = (values - correlation * neighbours) / math.sqrt(1 - correlation**2)
    return jnp.where(seen, rest, values)


@eqx.filter_jit
def _slope_of_exposures(z):
    return jax.jacfwd(lambda z: jnp.log(_exposures(parameter_values(z))))(z)


@eqx.filter_jit
def _totals_and_slope(z):
    return _totals(z), jax.jacfwd(_totals)(z)


@eqx.filter_jit
def _values_of_draws(x):
    z = jax.vmap(_parts)(x)
    return {"z": z, **jax.vmap(parameter_values)(z)}


def _densities(model: tuple[Windows, Iris], x) -> np.ndarray:
    with ThreadPoolExecutor(2) as pool:  # one program is too small for two cores
        return map_rows(partial(_density, model), np.asarray(x, np.float64), _ROWS, pool.map)


@eqx.filter_jit
def _density(model, x):
    windows, base = model
    return jax.vmap(lambda row: log_posterior(_parts(row), windows, base))(x)


def _totals(z):
    """Coordinates (free,) of the draws: for each layer the logarithms of its melanin and of
    eumelanin over pheomelanin, scaled about the priors' medians, in place of the two.

    Colours constrain the total, which bends the posterior of either alone. The Jacobian's
    determinant is constant.
    """
    eumelanin = _CENTRES[0] + _SCALES[0] * z[_EUMELANIN]
    pheomelanin = _CENTRES[1] + _SCALES[1] * z[_PHEOMELANIN]
    total = jnp.logaddexp(eumelanin, pheomelanin) - jnp.logaddexp(*_CENTRES)
    share = (eumelanin - pheomelanin) - (_CENTRES[0] - _CENTRES[1])
    z = z.at[_EUMELANIN].set(total / _SCALES[0])
    return z.at[_PHEOMELANIN].set(share / (_SCALES[0] * math.sqrt(2)))


def _parts(x):
    """The inverse of `_totals`."""
    total = _SCALES[0] * x[_EUMELANIN] + jnp.logaddexp(*_CENTRES)
    share = _SCALES[0] * math.sqrt(2) * x[_PHEOMELANIN] + (_CENTRES[0] - _CENTRES[1])
    logs = total + jax.nn.log_sigmoid(share), total + jax.nn.log_sigmoid(-share)
    x = x.at[_EUMELANIN].set((logs[0] - _CENTRES[0]) / _SCALES[0])
    return x.at[_PHEOMELANIN].set((logs[1] - _CENTRES[1]) / _SCALES[1])
