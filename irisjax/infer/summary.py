"""What a posterior says: medians and intervals, and what the data could not tell."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from irisjax._types import PRNGKey
from irisjax.infer.parameters import unit_of
from irisjax.infer.pieces import in_rows, predicted
from irisjax.infer.posterior import Chains, mixing
from irisjax.infer.problem import Problem

QUANTILES = (2.5, 16, 50, 84, 97.5)
DRAWS = 500


class Row(NamedTuple):
    """One parameter's posterior.

    `contraction` is 1 − posterior variance / prior variance, in the coordinate where the prior is
    normal.
    """

    parameter: str
    unit: str
    median: float
    sd: float
    q2_5: float
    q16: float
    q84: float
    q97_5: float
    rhat: float
    ess_bulk: float
    ess_tail: float
    contraction: float


class Check(NamedTuple):
    """Posterior predictive checks: the share of simulated data further from the model than the
    measured ones.

    - `p_chi_square`: by Σ of squared residuals; `p_pattern`: by how alike neighbouring residuals
        are.
    - `noise`: median factor on the stated noise, if it was free, else 1.
    """

    p_chi_square: float
    p_pattern: float
    noise: float

    @property
    def warning(self) -> str | None:
        """Why the model cannot have produced the data, or `None`."""
        faults = []
        if self.p_chi_square < 0.01:
            faults.append(f"residuals are larger than the noise (p = {self.p_chi_square:.3g})")
        if self.p_pattern < 0.01:
            faults.append(f"residuals run together over wavelength (p = {self.p_pattern:.3g})")
        if self.noise > 2.5:
            faults.append(f"it takes {self.noise:.1f} times the stated noise")
        return None if not faults else "the model does not produce these data: " + "; ".join(faults)


def reported(problem: Problem, z: np.ndarray) -> dict[str, np.ndarray]:
    """Free and derived parameters of samples z (..., free), by name, in the order of
    `problem.free`.
    """
    values = in_rows(_reported, problem.unnamed(), 4096)(z.reshape(-1, z.shape[-1]))
    names = [*problem.free, *(n for n in values if n not in problem.free)]
    return {n: np.asarray(values[n]).reshape(z.shape[:-1]) for n in names}


@eqx.filter_jit
def _reported(problem: Problem, z):
    return jax.vmap(lambda x: problem.reported(x))(z)


def summarise(problem: Problem, chains: Chains) -> list[Row]:
    """A row for every free and derived parameter."""
    # What the priors say of derived parameters: an integral over even points, nothing random.
    even = qmc.Sobol(len(problem.free), scramble=False).random_base2(14)
    before, rows = reported(problem, ndtri(even + 2.0**-15)), []
    for name, values in reported(problem, chains.z).items():
        if name in problem.free:
            i = problem.free.index(name)
            rhat, bulk, tail = chains.rhat[i], chains.ess_bulk[i], chains.ess_tail[i]
            contraction = 1 - chains.z[..., i].var()
        else:
            # Of a chain too short to be judged nothing is judged.
            judged = np.isfinite(chains.rhat).all()
            rhat, bulk, tail = mixing(values.T) if judged else (np.nan,) * 3
            # Derived: their logarithms, which the priors make nearly normal.
            contraction = 1 - np.log(values).var() / np.log(before[name]).var()
        q = np.percentile(values, QUANTILES)
        rows.append(
            Row(
                name,
                unit_of(name),
                q[2],
                values.std(),
                q[0],
                q[1],
                q[3],
                q[4],
                rhat,
                bulk,
                tail,
                float(contraction),
            )
        )
    return rows


def predictive(problem: Problem, chains: Chains, count: int = DRAWS, *, key: PRNGKey):
    """Draws of the posterior predictive and of the model without noise: their places z (count,
    free), and two arrays (count, data) an observation.
    """
    return _drawn(problem, chains, count, key)[:3]


def _drawn(problem: Problem, chains: Chains, count: int, key: PRNGKey):
    """As `predictive`, and the standard deviations stated there."""
    z = chains.z.reshape(-1, chains.z.shape[-1])
    chosen = jnp.asarray(z[np.linspace(0, len(z) - 1, min(count, len(z))).astype(int)])
    return chosen, *predicted(problem.unnamed(), chosen, key)


def check(problem: Problem, chains: Chains, *, key: PRNGKey) -> Check:
    """Posterior predictive checks, by the residuals' size and by their pattern."""
    _, simulated, models, sds = _drawn(problem, chains, DRAWS, key)
    size, pattern = [], []
    for values in (tuple(o.values for o in problem.observations), simulated):
        total, alike = 0.0, 0.0
        for y, m, sd in zip(values, models, sds, strict=True):
            r = (np.asarray(y) - np.asarray(m)) / np.asarray(sd)
            total = total + (r**2).sum(axis=1)
            alike = alike + (r[:, 1:] * r[:, :-1]).sum(axis=1) / (r**2).sum(axis=1)
        size.append(total)
        pattern.append(alike)
    noise = reported(problem, chains.z).get("noise")
    return Check(
        float((size[1] >= size[0]).mean()),
        float((pattern[1] >= pattern[0]).mean()),
        1.0 if noise is None else float(np.median(noise)),
    )
