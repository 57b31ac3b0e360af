"""Pigments from the colours of windows: least squares, F09's simplex, and a posterior  [F09
Section 5.2, Eqs. 13, 14].

A photograph is light times an unknown exposure, through a camera of unknown white balance and
contrast: these are free beside the four concentrations, and what they hide is not told. The
thickness map is wrong in places; where it is, all channels go up and down together, so the noise of
a window is a common factor and a smaller one for each channel.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from irisjax.infer.priors import AbstractPrior, LogNormal
from irisjax.infer.search import levenberg_marquardt
from irisjax.numerics.programs import program
from irisjax.photo.windows import Windows
from irisjax.tissue.iris import Iris

CONCENTRATIONS = ("abl_eumelanin", "abl_pheomelanin", "stroma_eumelanin", "stroma_pheomelanin")
"""The four that are sought, mg/ml of each layer."""
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
    "common_noise": LogNormal(0.1, 0.7),
    "channel_noise": LogNormal(0.02, 0.7),
}
"""What is free and its prior.

Concentrations: LB06's loads and shares of the two layers, a factor 3.7 either way. Scattering: a
factor on the iris's own. Room: radiance of light from all round beside lamps whose irradiance is π
together, where lamps were told from their highlights. Camera: exposure over that of a white sheet
in the stated light, white balance of red and blue against green, and the power by which its values
grow with light. Noise: relative, of a window as a whole and of each channel.
"""
NAMES = tuple(PRIORS)
UNITS = {name: "mg/ml" if name in CONCENTRATIONS else "" for name in NAMES}
_CAMERA = ("exposure", "red_gain", "blue_gain", "contrast")
_NOISE = ("common_noise", "channel_noise")
LEAST_COMMON, LEAST_CHANNEL = 0.05, 0.02
"""Noise beside the free one, relative: no camera and no model of an iris is better."""
_FLOOR = 0.01  # of the photograph's mean, below which colours are not told apart


class Fit(NamedTuple):
    """The best pigments and camera.

    - `values` by name; `z`: the same as standard normal numbers of their priors, with their
        `covariance` (normal approximation). `rms`: of the
        logarithms of photograph over model in the windows, per channel.
    - `steps`: that it took; `converged`: whether it ended of itself.
    """

    values: dict[str, float]
    z: Float[np.ndarray, " free"]
    covariance: Float[np.ndarray, "free free"]
    rms: Float[np.ndarray, "3"]
    steps: int
    converged: bool


def values_of(z) -> dict[str, Any]:
    """The parameters, by name, of standard normal numbers (free,)."""
    return {name: prior.value(z[i]) for i, (name, prior) in enumerate(PRIORS.items())}


def iris_of(values: dict[str, Any], base: Iris) -> Iris:
    """The iris of four concentrations (mg/ml of each layer) and a factor on the scattering of
    `base`.
    """
    height = base.abl_thickness, base.stroma_thickness
    whole = height[0] + height[1]

    def shared(kind):
        masses = [
            values[f"{layer}_{kind}"] * h
            for layer, h in zip(("abl", "stroma"), height, strict=True)
        ]
        total = masses[0] + masses[1]
        none = total <= 0
        return total / whole, jnp.where(none, 0.5, masses[0] / jnp.where(none, 1.0, total))

    (eumelanin, first), (pheomelanin, second) = shared("eumelanin"), shared("pheomelanin")
    return base.replace(
        eumelanin=eumelanin,
        pheomelanin=pheomelanin,
        abl_fraction=first,
        pheomelanin_abl_fraction=second,
        scattering_scale=values.get("scattering_scale", 1.0) * base.scattering_scale,
    )


def concentrations_of(iris: Iris) -> dict[str, float]:
    """The four concentrations of an iris, mg/ml of each layer."""
    second = iris.pheomelanin_abl_fraction
    shares = iris.abl_fraction, iris.abl_fraction if second is None else second
    whole = iris.abl_thickness + iris.stroma_thickness
    found = {}
    for kind, share in zip(("eumelanin", "pheomelanin"), shares, strict=True):
        mass = getattr(iris, kind) * whole
        found[f"abl_{kind}"] = float(mass * share / iris.abl_thickness)
        found[f"stroma_{kind}"] = float(mass * (1 - share) / iris.stroma_thickness)
    return {name: found[name] for name in CONCENTRATIONS}


def predicted(values: dict[str, Any], windows: Windows, base: Iris) -> Float[Array, "windows 3"]:
    """Linear values of a photograph of the iris in each window."""
    radiance = windows.radiance(iris_of(values, base), values["room"])
    # What is darker than nothing, out of sRGB's range, has no power: straight on from a small one.
    least = 1e-4
    held = jnp.maximum(radiance, least)
    powered = held ** values["contrast"] + (radiance - held)
    gains = jnp.stack([values["red_gain"], jnp.ones_like(values["red_gain"]), values["blue_gain"]])
    return values["exposure"] * gains * powered


def _off(values, windows: Windows, base: Iris):
    """Logarithms of photograph over model, (windows, 3), and the standard deviations of the pixels'
    means.

    Of logarithms: relative to the photograph, a model that is black would be off by one everywhere,
    and a common factor would explain it.
    """
    floor = _FLOOR * windows.colour.mean(where=windows.present[:, None])
    seen = jnp.maximum(windows.colour, 0) + floor
    # Out of sRGB's range a channel may be below zero; it stays a slope.
    shown = predicted(values, windows, base) + floor
    least = 0.1 * floor
    shown = jnp.where(shown > least, shown, least * jnp.exp(jnp.minimum(shown / least - 1, 0.0)))
    off = jnp.log(seen / shown)
    return jnp.where(windows.present[:, None], off, 0.0), windows.error / seen


def log_probability(z, windows: Windows, base: Iris):
    """Logarithm of the posterior density of z (free,), without constants."""
    values = values_of(z)
    off, pixels = _off(values, windows, base)
    own = values["channel_noise"] ** 2 + LEAST_CHANNEL**2 + pixels**2  # (windows, 3)
    common = values["common_noise"] ** 2 + LEAST_COMMON**2
    # Of a diagonal and a common factor [Sherman & Morrison 1950].
    weights = 1 / own
    total = weights.sum(1)
    squares = (off**2 * weights).sum(1) - common * (off * weights).sum(1) ** 2 / (
        1 + common * total
    )
    determinant = jnp.log(own).sum(1) + jnp.log1p(common * total)
    found = -0.5 * jnp.where(windows.present, squares + determinant, 0).sum() - 0.5 * (z**2).sum()
    return jnp.where(jnp.isfinite(found), found, -jnp.inf)


def least_squares(windows: Windows, base: Iris, steps: int = 60) -> Fit:
    """The best pigments by Levenberg and Marquardt's steps through the differentiable renderer,
    with the noise's priors at their medians; the best of a few starts.
    """
    free = [i for i, n in enumerate(NAMES) if n not in _NOISE]
    free = [i for i in free if NAMES[i] != "room" or windows.room is not None]
    starts = np.zeros((len(_STARTS), len(free)))
    starts[:, : len(CONCENTRATIONS)] = _STARTS
    found, cost, taken, ended, covariance = _searched(
        jnp.asarray(starts), windows, base, tuple(free), steps
    )
    best = int(np.nanargmin(np.asarray(cost)))
    z = np.zeros(len(NAMES))
    z[free] = np.asarray(found[best])
    spread = np.eye(len(NAMES))
    spread[np.ix_(free, free)] = np.asarray(covariance[best])
    return _fit(z, spread, windows, base, int(np.sum(taken)), bool(ended[best]))


_STARTS = np.array(
    [[0.0] * 4, [-1.5, -1.5, -1.0, -1.0], [1.0, 0.0, 1.0, 0.0], [-1.0, 1.0, -1.0, 1]]
)


def _residuals(some, args):
    windows, base, free = args
    z = jnp.zeros(len(NAMES)).at[jnp.asarray(free)].set(some)
    values = values_of(z)
    off, pixels = _off(values, windows, base)
    own = jnp.sqrt(values["channel_noise"] ** 2 + (pixels**2).mean(where=windows.present[:, None]))
    mean = off.mean(1, keepdims=True)
    # Three numbers of a window: its mean, which the common factor moves too, and the rest.
    common = jnp.sqrt(own**2 / 3 + values["common_noise"] ** 2)
    return jnp.concatenate([(mean / common).ravel(), ((off - mean) / own).ravel(), some])


@program
def _searched(starts, windows, base, free: tuple[int, ...], steps: int):
    def one(start):
        args = windows, base, free
        found = optx.least_squares(
            lambda x, _: _residuals(x, args),
            levenberg_marquardt(1e-5, 1e-5),
            start,
            max_steps=steps,
            throw=False,
        )
        residuals = _residuals(found.value, args)
        jacobian = jax.jacfwd(lambda x: _residuals(x, args))(found.value)
        covariance = jnp.linalg.inv(jacobian.T @ jacobian)
        ended = found.result == optx.RESULTS.successful
        return found.value, (residuals**2).sum(), found.stats["num_steps"], ended, covariance

    return jax.lax.map(one, starts)


def simplex(windows: Windows, base: Iris, steps: int = 50) -> tuple[Fit, list[dict[str, float]]]:
    """F09's search: Nelder and Mead's simplex for the eumelanins with pheomelanin tied to them,
    then for the two ratios; exposure and white balance stay as stated  [F09 Section 5.2].

    **Returns:** the fit, and the values and relative RMS at each stage.
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
    return _fit(z, np.eye(len(NAMES)), windows, base, taken, ended), log


def _four(eumelanin, ratios):
    abl, stroma = jnp.exp(eumelanin)
    first, second = jnp.exp(ratios)
    return dict(zip(CONCENTRATIONS, (abl, first * abl, stroma, second * stroma), strict=True))


@program
def _downhill(start, held, windows, base, eumelanin: bool, steps: int):
    rest = {n: p.value(jnp.zeros(())) for n, p in PRIORS.items() if n not in CONCENTRATIONS}

    def cost(x, _):
        four = _four(x, held) if eumelanin else _four(held, x)
        off = _off({**four, **rest}, windows, base)[0]
        return (off**2).mean(where=windows.present[:, None])

    found = optx.minimise(cost, optx.NelderMead(1e-4, 1e-6), start, max_steps=steps, throw=False)
    return found.value, found.stats["num_steps"], found.result == optx.RESULTS.successful


def _fit(z, covariance, windows, base, steps: int, ended: bool) -> Fit:
    values = {n: float(v) for n, v in values_of(jnp.asarray(z)).items()}
    return Fit(values, z, covariance, _rms(z, windows, base), steps, ended)


def _rms(z, windows: Windows, base: Iris) -> np.ndarray:
    """Relative differences per channel."""
    return np.asarray(_rms_of(jnp.asarray(z), windows, base))


@program
def _rms_of(z, windows, base):
    off = _off(values_of(z), windows, base)[0]
    return jnp.sqrt((off**2).mean(0, where=windows.present[:, None]))
