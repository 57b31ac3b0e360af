"""Pigments from the colours of windows: least squares, F09's simplex, and a posterior  [F09
Section 5.2, Eqs. 13, 14].

A photograph is light times an unknown exposure, through a camera of unknown white balance and
contrast: these are free beside the four concentrations, and what they hide is not told. What the
model gets wrong beside that is integrated out, see `window_noise`.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.priors import AbstractPrior, LogNormal
from irisjax.photo.concentrations import CONCENTRATIONS, iris_of
from irisjax.photo.window_noise import covariances, log_likelihood, whitened
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

PHEOMELANIN_PER_EUMELANIN = 0.226
"""That F09 begins with [F09 Section 5.2]."""

PRIORS: dict[str, AbstractPrior] = {
    "abl_eumelanin": LogNormal(1.0, 1.3),
    "abl_pheomelanin": LogNormal(0.25, 1.3),
    "stroma_eumelanin": LogNormal(0.2, 1.3),
    "stroma_pheomelanin": LogNormal(0.05, 1.3),
    "scattering_scale": LogNormal(1.0, 0.5),
    "room": LogNormal(0.1, 1.2),
    "exposure": LogNormal(1.0, 0.7),
    "red_gain": LogNormal(1.0, 0.08),
    "blue_gain": LogNormal(1.0, 0.08),
    "contrast": LogNormal(1.0, 0.05),
}
"""What is free and its prior.

Concentrations: LB06's loads and shares of the two layers, a factor 3.7 either way. Scattering: a
factor on the iris's own. Room: radiance of light from all round beside lamps whose irradiance is π
together, where lamps were told from their highlights. Camera: exposure over that of a white sheet
in the stated light, white balance of red and blue against green, and the power by which its values
grow with light.
"""
NAMES = tuple(PRIORS)
UNITS = {name: "mg/ml" if name in CONCENTRATIONS else "" for name in NAMES}
_CAMERA = ("exposure", "red_gain", "blue_gain", "contrast")
_TURNS = 3  # of least squares under covariances that are held, and of these
_CLOSE = 1e-3  # of a prior's standard deviation, to which least squares are told
_FLOOR = 0.01  # of the photograph's mean, below which colours are not told apart


class Fit(NamedTuple):
    """The best pigments and camera.

    - `values` by name; `z`: the same as standard normal numbers of their priors, with their
        `covariance` (normal approximation). `rms`: of the
        logarithms of photograph over model in the windows, per channel.
    - `steps`: that it took; `converged`: whether it ended of itself. `log`: how it went, a row of
        numbers by name each turn.
    """

    values: dict[str, float]
    z: Float[np.ndarray, " free"]
    covariance: Float[np.ndarray, "free free"]
    rms: Float[np.ndarray, "3"]
    steps: int
    converged: bool
    log: tuple[dict[str, float], ...] = ()


def values_of(z) -> dict[str, Any]:
    """The parameters, by name, of standard normal numbers (free,)."""
    return {name: prior.value(z[i]) for i, (name, prior) in enumerate(PRIORS.items())}


def predicted(values: dict[str, Any], windows: Windows, base: Iris) -> Float[Array, "windows 3"]:
    """Linear values of a photograph of the iris in each window."""
    return _taken(values, windows.radiance(iris_of(values, base), values["room"]))


def _taken(values, radiance):
    """Values that the camera makes of radiances."""
    # What is darker than nothing, out of sRGB's range, has no power: straight on from a small one.
    least = 1e-4
    held = jnp.maximum(radiance, least)
    powered = held ** values["contrast"] + (radiance - held)
    return _exposures(values) * powered


def _exposures(values):
    """Of the three channels."""
    return values["exposure"] * jnp.stack(
        [values["red_gain"], jnp.ones_like(values["red_gain"]), values["blue_gain"]]
    )


def _off(values, windows: Windows, base: Iris):
    """Logarithms of photograph over model, (windows, 3), and the derivatives of the model's by that
    of the stroma's thickness.

    Of logarithms: relative to the photograph, a model that is black would be off by one everywhere,
    and a common factor would explain it.
    """
    floor = _FLOOR * windows.colour.mean(where=windows.present[:, None])
    seen = jnp.maximum(windows.colour, 0) + floor
    least = 0.1 * floor

    def of(radiance):
        # Out of sRGB's range a channel may be below zero; it stays a slope.
        shown = _taken(values, radiance) + floor
        low = least * jnp.exp(jnp.minimum(shown / least - 1, 0.0))
        off = jnp.log(seen / jnp.where(shown > least, shown, low))
        return jnp.where(windows.present[:, None], off, 0.0)

    radiance, slope = windows.radiance_and_slope(iris_of(values, base), values["room"])
    off, change = jax.jvp(of, (radiance,), (slope,))
    return off, -change


def log_probability(z, windows: Windows, base: Iris):
    """Logarithm of the posterior density of z (free,), without constants."""
    found = log_likelihood(*_off(values_of(z), windows, base), windows.present)
    found -= 0.5 * (z**2).sum()
    return jnp.where(jnp.isfinite(found), found, -jnp.inf)


def least_squares(windows: Windows, base: Iris, steps: int = 60) -> Fit:
    """The best pigments by Levenberg and Marquardt's steps through the differentiable renderer, in
    turns with the covariances of errors; the best of a few starts.
    """
    free = [i for i, n in enumerate(NAMES) if n != "room" or windows.room is not None]
    starts = np.zeros((len(_STARTS), len(free)))
    starts[:, : len(CONCENTRATIONS)] = _STARTS
    (found, log_density), (taken, ended), covariance = _searched(
        jnp.asarray(starts), windows, base, tuple(free), steps
    )
    best = int(np.nanargmax(np.asarray(log_density[:, -1])))
    z = np.zeros(len(NAMES))
    z[free] = np.asarray(found[best, -1])
    spread = np.eye(len(NAMES))
    spread[np.ix_(free, free)] = np.asarray(covariance[best])
    log = []
    for start, turn in np.ndindex(len(starts), _TURNS):
        there = np.zeros(len(NAMES))
        there[free] = np.asarray(found[start, turn])
        counted = {"start": start + 1, "turn": turn + 1, "steps": taken[start, turn]}
        row = counted | {"log_density": log_density[start, turn]} | values_of(jnp.asarray(there))
        log.append({name: float(v) for name, v in row.items()})
    return _fit(z, spread, windows, base, int(np.sum(taken)), bool(ended[best, -1]), log)


_STARTS = np.array(
    [[0.0] * 4, [-1.5, -1.5, -1.0, -1.0], [1.0, 0.0, 1.0, 0.0], [-1.0, 1.0, -1.0, 1]]
)


@eqx.filter_jit
def _searched(starts, windows, base, free: tuple[int, ...], steps: int):
    def every(some):
        return jnp.zeros(len(NAMES)).at[jnp.asarray(free)].set(some)

    def residuals(some, held):
        off, _ = _off(values_of(every(some)), windows, base)
        return jnp.concatenate([whitened(off, windows.present, held), some])

    def turn(some, _):
        held = covariances(*_off(values_of(every(some)), windows, base), windows.present)
        solver = levenberg_marquardt(_CLOSE, _CLOSE)
        found = optx.least_squares(residuals, solver, some, held, max_steps=steps, throw=False)
        ended = found.result == optx.RESULTS.successful
        density = log_probability(every(found.value), windows, base)
        told = (found.value, density), (found.stats["num_steps"], ended), held
        return found.value, told

    def one(start):
        found, (reached, counted, held) = jax.lax.scan(turn, start, None, _TURNS)
        last = jax.tree.map(lambda c: c[-1], held)
        jacobian = jax.jacfwd(lambda x: residuals(x, last))(found)
        return reached, counted, jnp.linalg.inv(jacobian.T @ jacobian)

    return jax.lax.map(one, starts)


def exposures_for(fit: Fit, windows: Windows, base: Iris) -> Float[np.ndarray, "3"]:
    """Exposures of the channels with which the model's windows are on average as bright as the
    photograph's, for windows of other maps than those of the fit.
    """
    return np.asarray(_matched(jnp.asarray(fit.z), windows, base))


@eqx.filter_jit
def _matched(z, windows, base):
    values = values_of(z)
    off, _ = _off(values, windows, base)
    return _exposures(values) * jnp.exp(off.mean(0, where=windows.present[:, None]))


def simplex(windows: Windows, base: Iris, steps: int = 50) -> Fit:
    """F09's search: Nelder and Mead's simplex for the eumelanins with pheomelanin tied to them,
    then for the two ratios; exposure and white balance stay as stated  [F09 Section 5.2]. Its log
    has the values and the relative RMS at each stage.
    """
    log: list[dict[str, float]] = []
    z = np.zeros(len(NAMES))
    ratios = np.full(2, PHEOMELANIN_PER_EUMELANIN)
    eumelanin = np.array(
        [PRIORS["abl_eumelanin"].value(0.0), PRIORS["stroma_eumelanin"].value(0.0)]
    )
    taken, ended = 0, True
    for stage in ("eumelanin", "ratios"):
        start = jnp.log(jnp.asarray(eumelanin if stage == "eumelanin" else ratios, float))
        held = jnp.log(jnp.asarray(ratios if stage == "eumelanin" else eumelanin, float))
        found, count, result = _downhill(start, held, windows, base, stage == "eumelanin", steps)
        if stage == "eumelanin":
            eumelanin = np.exp(np.asarray(found))
        else:
            ratios = np.exp(np.asarray(found))
        taken, ended = taken + int(count), ended and bool(result)
        values = _four(jnp.log(jnp.asarray(eumelanin)), jnp.log(jnp.asarray(ratios)))
        for i, name in enumerate(CONCENTRATIONS):
            z[i] = float(PRIORS[name].standard(values[name]))
        log.append(
            {n: float(values[n]) for n in CONCENTRATIONS}
            | {"steps": float(count), "rms": float(_rms(z, windows, base).mean())}
        )
    return _fit(z, np.eye(len(NAMES)), windows, base, taken, ended, log)


def _four(eumelanin, ratios):
    abl, stroma = jnp.exp(eumelanin)
    first, second = jnp.exp(ratios)
    return dict(zip(CONCENTRATIONS, (abl, first * abl, stroma, second * stroma), strict=True))


@eqx.filter_jit
def _downhill(start, held, windows, base, eumelanin: bool, steps: int):
    rest = {n: p.value(jnp.zeros(())) for n, p in PRIORS.items() if n not in CONCENTRATIONS}

    def cost(x, _):
        four = _four(x, held) if eumelanin else _four(held, x)
        off, _ = _off({**four, **rest}, windows, base)
        return (off**2).mean(where=windows.present[:, None])

    found = optx.minimise(cost, optx.NelderMead(1e-4, 1e-6), start, max_steps=steps, throw=False)
    return found.value, found.stats["num_steps"], found.result == optx.RESULTS.successful


def _fit(z, covariance, windows, base, steps: int, ended: bool, log) -> Fit:
    values = {n: float(v) for n, v in values_of(jnp.asarray(z)).items()}
    return Fit(values, z, covariance, _rms(z, windows, base), steps, ended, tuple(log))


def _rms(z, windows: Windows, base: Iris) -> np.ndarray:
    """Relative differences per channel."""
    return np.asarray(_rms_of(jnp.asarray(z), windows, base))


@eqx.filter_jit
def _rms_of(z, windows, base):
    off, _ = _off(values_of(z), windows, base)
    return jnp.sqrt((off**2).mean(0, where=windows.present[:, None]))
