"""What the data determine and what they do not, from the curvature at the best fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from irisjax.infer.fit import Fit
from irisjax.infer.parameters import OF_POWER_LAW, kind
from irisjax.infer.problem import Problem

_OF_SCATTERING = "scattering_scale", *OF_POWER_LAW


class Direction(NamedTuple):
    """A combination of parameters, Π value^exponent, the largest exponent of size 1 and small ones
    left out, and the relative standard deviation that the data alone leave it.
    """

    exponents: dict[str, float]
    relative: float


class Information(NamedTuple):
    """Fisher information of the data alone in the logarithms of the parameters, noise left out.

    Attributes:
        directions: Its eigenvectors from the best known to the least known.
        alone: Relative standard deviation of each parameter with all others free; may be infinite.
        trades: For the strength of scattering and each number of a power law that are free: the
            share of the prior's width that is left, the parameter that it is correlated with most,
            and that correlation.
    """

    names: tuple[str, ...]
    fisher: Float[np.ndarray, "names names"]
    directions: list[Direction]
    alone: dict[str, float]
    trades: dict[str, tuple[float, str, float]]

    def of_product(self, one: str, other: str) -> float:
        """Relative standard deviation of the product of two parameters, by the data alone."""
        values, vectors = np.linalg.eigh(self.fisher)
        parts = vectors[self.names.index(one)] + vectors[self.names.index(other)]
        return float(np.sqrt((parts**2 / np.maximum(values, 1e-30)).sum()))


def information(problem: Problem, fit: Fit) -> Information:
    """Compute the Fisher information at a fit."""
    moving = problem.moving
    names, covariance = tuple(problem.free[i] for i in moving), np.asarray(fit.covariance)
    in_logs = np.asarray(fit.jacobian)[:, moving] * [float(fit.values[n]) for n in names]
    fisher = in_logs.T @ in_logs
    eigenvalues, vectors = np.linalg.eigh(fisher)
    directions = []
    for k in range(len(names))[::-1]:
        largest = np.abs(vectors[:, k]).max()
        v = vectors[:, k] / largest
        v = v * np.sign(v[np.argmax(np.abs(v))])
        components = {n: float(e) for n, e in zip(names, v, strict=True) if abs(e) >= 0.2}
        relative = float(1 / np.sqrt(max(eigenvalues[k], 1e-30)) / largest)
        directions.append(Direction(components, relative))
    # Variance of each parameter: infinite along directions of which the data say nothing.
    unknown = eigenvalues < 1e-12 * eigenvalues.max()
    variance = vectors**2 @ np.where(unknown, 0.0, 1 / np.where(unknown, 1.0, eigenvalues))
    variance[(vectors[:, unknown] ** 2).any(axis=1)] = np.inf
    alone = dict(zip(names, np.sqrt(variance).tolist(), strict=True))
    return Information(names, fisher, directions, alone, _trades(problem, covariance, moving))


def _trades(
    problem: Problem, covariance: np.ndarray, moving: list[int]
) -> dict[str, tuple[float, str, float]]:
    """`Information.trades`, in the priors' coordinates, in which a prior's width is one."""
    width = np.sqrt(np.diag(covariance))
    # A parameter on which the data do not depend has no width here, and no correlation.
    scale = np.where(width > 0, width, 1.0)
    correlation, rows = covariance / np.outer(scale, scale), {}
    for i in (i for i in moving if kind(problem.free[i]) in _OF_SCATTERING and len(moving) > 1):
        other = max((k for k in moving if k != i), key=lambda k: abs(correlation[i, k]))
        rows[problem.free[i]] = float(width[i]), problem.free[other], float(correlation[i, other])
    return rows
