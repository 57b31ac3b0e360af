"""Least squares for every pixel of a hyperspectral cube, and the iris that its maps describe.

Each pixel is fitted by one search, as by `fit` but to a looser tolerance. The search starts near
the most similar spectrum of a table, which contains draws of the priors or fits of pixels spread
over the cube: a few steps of Broyden's method lead there from that spectrum's vector and
derivatives, each at a sixth of the cost of a step with derivatives of its own. Pixels go through
programs of a fixed size, so that each result depends on its own spectrum and the table alone.
"""

import enum
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float
from scipy.special import ndtri
from scipy.stats import qmc

from irisjax.infer import parameters
from irisjax.infer.fit import OFF_PRIOR, Fit, FitStatus, abl_melanin, fit_at, residuals
from irisjax.infer.least_squares import NORMAL_EQUATIONS, least_squares_of_rows
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import kind
from irisjax.infer.problem import Problem
from irisjax.numerics import linear
from irisjax.numerics.chunks import map_rows
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

_ROWS, _BATCH = 64, 16  # pixels of a call, and computed together: more leave the core's cache
_BROYDEN_STEPS, _LONGEST = 5, 1.0  # from a spectrum of the table, and the longest in each of z
_SEARCHED = 512  # pixels of a call that searches, in _BATCH lanes: few lanes idle at its end
# A search ends when z and the residuals, whose standard deviations are about one, move by less. Of
# 16,384 simulated pixels 99 in 100 are then within 0.05 standard deviations of the optimum, and all
# within 0.4 (ILIT; 0.004 and 0.08 by radiative transfer).
_TOLERANCE = 1e-2
_AT_OPTIMUM = 1e-4  # standard deviations
_DRAWS = 2**12  # of the priors

Each = Callable[..., Any]
"""A `map` that applies a function to calls, such as that of a pool of threads."""


class _Dogleg(optx.Dogleg[Any, Any, Any]):
    """Powell's dogleg, which also ends where a Gauss–Newton step would move by less than
    `_AT_OPTIMUM`: rounding may hide there that a step lowers the cost. In standard deviations a
    step is as long as the change of the residuals along it.
    """

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Any, optx.RESULTS]:
        change = optx.two_norm(state.f_info.jac.mv(state.descent_state.newton))
        there = (state.num_steps > 0) & (change < _AT_OPTIMUM)
        return state.terminate | there, state.result


class PixelFlag(enum.IntFlag):
    """Flags of a pixel, which add; 0 is none. A pixel with one of the first three has no fit."""

    MASKED = 1
    NOT_A_NUMBER = 2
    SATURATED = 4
    NOT_CONVERGED = 8
    OFF_PRIOR = 16
    MISFIT = 32
    OUT_OF_DISTRIBUTION = 64
    NO_POSTERIOR = 128


class Starts(NamedTuple):
    """Vectors z of the free parameters, the spectra that they predict, and their derivatives."""

    z: Float[np.ndarray, "starts free"]
    predicted: Float[np.ndarray, "starts data"]
    slopes: Float[np.ndarray, "starts data free"]


class PixelFits(NamedTuple):
    """Fits of pixels.

    Attributes:
        z: The optimum in the priors' normal coordinates.
        values: The fitted parameters in their units, `noise` left out.
        covariance: Of the values, to first order, with the priors' part.
        z_covariance: The same of z; zero for the noise, which is not fitted.
        predicted: The spectrum at the optimum.
        chi_square: Σ of squared residuals over their number.
        flags: A sum of `PixelFlag`.
        names: Of the fitted parameters.
    """

    z: Float[np.ndarray, "pixels free"]
    values: Float[np.ndarray, "pixels fitted"]
    covariance: Float[np.ndarray, "pixels fitted fitted"]
    predicted: Float[np.ndarray, "pixels data"]
    chi_square: Float[np.ndarray, " pixels"]
    flags: Any
    z_covariance: Float[np.ndarray, "pixels free free"]
    names: tuple[str, ...]

    @property
    def sd(self) -> Float[np.ndarray, "pixels fitted"]:
        """Standard deviations of the values."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def abl_melanin(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what `abl_melanin` makes of these fits."""
        return abl_melanin(self.names, self.values, self.covariance)


def prior_starts(problem: Problem, each: Each = map) -> Starts:
    """Return even draws of the priors, with `noise` at its median."""
    draws = ndtri(qmc.Sobol(len(problem.free), scramble=False).random(_DRAWS) + 0.5 / _DRAWS)
    z = np.where([kind(n) == "noise" for n in problem.free], 0.0, draws)
    return starts_at(problem, z, each)


def starts_at(problem: Problem, z: Float[np.ndarray, "starts free"], each: Each = map) -> Starts:
    """Return the starts at some vectors z, such as those of fits."""
    return Starts(z, *map_rows(partial(_linearise, problem.unnamed()), z, _ROWS, each))


def fit_pixels(
    problem: Problem, values: Float[np.ndarray, "pixels data"], starts: Starts, each: Each = map
) -> PixelFits:
    """Fit many spectra of one instrument.

    Args:
        problem: A problem of one observation, whose values are not used.
        values: The spectra.
        starts: Where the searches may start.
        each: How calls are mapped.
    """
    problem, dtype = problem.unnamed(), jnp.result_type(float)
    values = np.asarray(values, dtype)
    table = jax.tree.map(lambda x: jnp.asarray(x, dtype), starts)
    z = map_rows(lambda rows: _initial_z(problem, table, rows), values, _ROWS, each)
    run = partial(_fit_rows, problem)
    # Rows that fill the last call have the number of the last pixel, and are not searched.
    fits = map_rows(run, (values, z, np.arange(len(values))), _SEARCHED, each)
    moving = problem.moving
    slopes = fits["slopes"][:, moving]
    covariance = fits["covariance"][:, moving][:, :, moving]
    outside = (np.abs(fits["z"]) > OFF_PRIOR).any(axis=1)
    flags = PixelFlag.NOT_CONVERGED * ~fits["converged"] + PixelFlag.OFF_PRIOR * outside
    flags += PixelFlag.MISFIT * fits["misfit"]
    return PixelFits(
        fits["z"], fits["values"][:, moving],
        slopes[:, :, None] * covariance * slopes[:, None, :], fits["predicted"],
        fits["chi_square"], flags.astype(np.uint8), fits["covariance"], tuple(problem.fitted),
    )  # fmt: skip


def predict_pixels(
    problem: Problem, values: Mapping[str, Float[np.ndarray, " pixels"]], each: Each = map
) -> Float[np.ndarray, "pixels data"]:
    """Return the spectra of pixels with these values of the free parameters, without noise.

    Raises:
        ValueError: A value lies outside of its prior.
    """
    pairs = dict(zip(problem.free, problem.priors, strict=True))
    with np.errstate(divide="ignore"):  # at the ends of a share, which are refused below
        z = np.stack([np.asarray(prior.standard(values[n])) for n, prior in pairs.items()], axis=-1)
    for i, j in np.argwhere(~np.isfinite(z))[:1]:
        name = problem.free[j]
        raise ValueError(f"{name} = {values[name][i]:g} is outside of its prior {pairs[name]!r}")
    return map_rows(partial(_predicted, problem.unnamed()), z, _ROWS, each)


def iris_of_pixels(
    values: Mapping[str, Any], base: Iris, good: Bool[np.ndarray, "..."] | None = None
) -> Iris:
    """Return the iris of the medians of all parameters, those of
    `good` pixels only, and all else as in `base`.
    """
    good = np.ones(np.shape(values["melanin_load"]), bool) if good is None else good
    medians = {n: float(np.median(np.broadcast_to(v, good.shape)[good])) for n, v in values.items()}
    return parameters.iris_of(medians, base)


def maps_of_pixels(values: Mapping[str, Float[np.ndarray, "angles radii"]], iris: Iris) -> IrisMaps:
    """Return the maps for the renderers, relative to an `iris`, of all parameters at the texels.

    Melanins, their depths and the thickness of the stroma are exact; blood and the strength of
    scattering are the iris's own everywhere: the renderers have no maps of these.
    """
    load, fraction, share = (
        values[n] for n in ("melanin_load", "abl_fraction", "pheomelanin_share")
    )
    depth = values["stroma_thickness"] / float(iris.stroma_thickness)
    height = float(iris.abl_thickness + iris.stroma_thickness)
    inside = float(iris.abl_fraction)
    # A texel keeps the concentrations of each layer: a deeper layer has more pigment.
    stroma = load * (1 - fraction) / (height * (1 - inside) * depth)
    relative = fraction / np.maximum(load * (1 - fraction), 1e-12) * load
    abl = relative * depth * (1 - inside) / inside * float(iris.abl_thickness)
    return IrisMaps(
        abl_depth=jnp.asarray(abl),
        stroma_depth=jnp.asarray(values["stroma_thickness"]),
        eumelanin=jnp.asarray(stroma * (1 - share) / float(iris.eumelanin)),
        pheomelanin=jnp.asarray(stroma * share / float(iris.pheomelanin)),
    )


@eqx.filter_jit
def _predicted(problem: Problem, z: Any) -> Any:
    return jax.lax.map(lambda x: problem.predict(x)[0], z, batch_size=_BATCH)


@eqx.filter_jit
def _linearise(problem: Problem, z: Any) -> Any:
    def one(x):
        return problem.predict(x)[0], jax.jacfwd(lambda x: problem.predict(x)[0])(x)

    return jax.lax.map(one, z, batch_size=_BATCH)


@eqx.filter_jit
def _initial_z(problem: Problem, starts: Starts, values: Any) -> Any:
    """The start of each pixel: the nearest of a table, and steps from there [Broyden 1965]."""
    o = problem.observations[0]
    sd = jax.vmap(lambda v: problem.noise.stated(with_values(o, v), v))(values)
    weights, table = 1 / sd**2, starts.predicted
    costs = weights @ (table * table).T - 2 * (weights * values) @ table.T
    nearest = jnp.argmin(costs + (starts.z * starts.z).sum(1), axis=1)

    def one(row):
        v, sd, k = row

        def point(z, predicted):
            rest = (v - predicted) / sd
            return z, rest, (rest * rest).sum() + (z * z).sum()

        def step(state, _):
            slopes, best = state
            z, rest, lowest = best
            gram = slopes.T @ slopes + jnp.eye(z.size, dtype=z.dtype)
            move = linear.solve(gram, slopes.T @ rest - z)
            move = jnp.clip(move, -_LONGEST, _LONGEST)
            trial = _, new_rest, cost = point(z + move, problem.predict(z + move)[0])
            # Broyden's update corrects, along the step, what the derivatives foretold wrongly. A
            # prediction that is no number ends the steps: nothing after it is better.
            wrong = rest - new_rest - slopes @ move
            slopes = slopes + wrong[:, None] * move / jnp.maximum(move @ move, 1e-30)
            return (slopes, jax.tree.map(partial(jnp.where, cost < lowest), trial, best)), None

        initial = starts.slopes[k] / sd[:, None], point(starts.z[k], starts.predicted[k])
        (_, (z, *_)), _ = jax.lax.scan(step, initial, length=_BROYDEN_STEPS)
        return z

    return jax.lax.map(one, (values, sd, nearest), batch_size=_BATCH)


@eqx.filter_jit
def _fit_rows(problem: Problem, rows: Any) -> dict[str, Any]:
    o, (values, z, numbers) = problem.observations[0], rows
    # Dogleg takes half as many steps as Levenberg and Marquardt's method in curved valleys.
    make: Any = _Dogleg  # type checkers do not see the constructor that it inherits
    solver = make(_TOLERANCE, _TOLERANCE, linear_solver=NORMAL_EQUATIONS)

    def of(values):
        return problem.with_observations(with_values(o, values))

    def pixel_residuals(x, weight, values):
        return residuals(x, weight, of(values))

    def finish(row):
        values, minimum = row
        result: Fit = fit_at(of(values), minimum)
        return {
            "z": result.z, "values": problem.natural(result.z), "slopes": problem.slopes(result.z),
            "covariance": result.covariance, "predicted": result.predicted[0],
            "chi_square": result.chi_square / max(values.size, 1),
            "converged": result.converged, "misfit": result.status == FitStatus.misfit,
        }  # fmt: skip

    minima = least_squares_of_rows(
        pixel_residuals, values, z[:, np.asarray(problem.moving, int)], solver=solver,
        lanes=_BATCH, count=numbers[-1] - numbers[0] + 1,
    )  # fmt: skip
    return jax.lax.map(finish, (values, minima), batch_size=_BATCH)
