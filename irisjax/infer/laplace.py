"""The normal approximation of a posterior at its optimum."""

import numpy as np

from irisjax.infer.fit import Fit
from irisjax.infer.pieces import density
from irisjax.infer.problem import Problem


def laplace(problem: Problem, best: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Optimum and covariance of the normal approximation, the noise at what the residuals say."""
    z, covariance = np.array(best.z, float), np.array(best.covariance, float)
    points = sum(o.values.shape[-1] for o in problem.observations)
    for i, name in enumerate(problem.free):
        if name.startswith("noise"):
            line = np.repeat(z[None], 64, axis=0)
            line[:, i] = np.linspace(-4, 4, 64)
            z[i] = line[int(np.nanargmax(density(problem)(line))), i]
            covariance[i, i] = min(1.0, 1 / (2 * points * 0.25))
    # Rounding must not make it indefinite.
    return z, covariance + 1e-10 * np.eye(z.size)
