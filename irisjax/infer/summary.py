"""What a posterior says: medians and intervals, and what the data could not tell."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from irisjax._types import PRNGKey
from irisjax.infer.diagnostics import diagnostics
from irisjax.infer.pieces import predicted
from irisjax.infer.posterior import Chains
from irisjax.infer.problem import Problem, unit_of

QUANTILES = (2.5, 16, 50, 84, 97.5)


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
    flat = z.reshape(-1, z.shape[-1])
    values = _reported(problem, jnp.asarray(flat))
    names = [*problem.free, *(n for n in values if n not in problem.free)]
    return {n: np.asarray(values[n]).reshape(z.shape[:-1]) for n in names}


@jax.jit
def _reported(problem: Problem, z):
    return jax.vmap(lambda x: problem.reported(x))(z)


def summarise(problem: Problem, chains: Chains) -> list[Row]:
    """A row for every free and derived parameter."""
    # What the priors say of derived parameters: an integral over even points, nothing random.
    even = qmc.Sobol(len(problem.free), scramble=False).random_base2(14)
    before, rows = reported(problem, ndtri(even + 2.0**-15)), []
    for name, values in reported(problem, chains.z).items():
        rhat, bulk, tail = diagnostics(values.T)
        if name in problem.free:
            i = problem.free.index(name)
            rhat, bulk, tail = chains.rhat[i], chains.ess_bulk[i], chains.ess_tail[i]
            contraction = 1 - chains.z[..., i].var()
        else:
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


def predictive(problem: Problem, chains: Chains, count: int = 500, *, key: PRNGKey):
    """Draws of the posterior predictive and of the model without noise: two arrays (count, data) an
    observation.
    """
    z = chains.z.reshape(-1, chains.z.shape[-1])
    chosen = jnp.asarray(z[np.linspace(0, len(z) - 1, min(count, len(z))).astype(int)])
    return chosen, *predicted(problem, chosen, jax.random.split(key, len(chosen)))


def check(problem: Problem, chains: Chains, *, key: PRNGKey) -> Check:
    """Posterior predictive checks, by the residuals' size and by their pattern."""
    z, simulated, models = predictive(problem, chains, key=key)
    size, pattern = [], []
    for values in (tuple(o.values for o in problem.observations), simulated):
        total, alike = 0.0, 0.0
        for i, (o, m) in enumerate(zip(problem.observations, models, strict=True)):
            sd = _stated(problem, z, i, m, o)
            r = (np.asarray(values[i]) - np.asarray(m)) / sd
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


def _stated(problem, z, i, model, observation):
    """Standard deviations under each draw."""
    if observation.covariance_root is not None:
        return np.sqrt(
            np.diag(np.asarray(observation.covariance_root @ observation.covariance_root.T))
        )
    return np.asarray(_sds(problem, z, model, i))


@functools.partial(jax.jit, static_argnums=3)
def _sds(problem, z, models, i):
    def one(x, m):
        values = problem.values(x)
        factor = values.get("noise", values.get(f"noise@{i + 1}"))
        sd = problem.noise.sd(problem.observations[i], m, factor)
        # A marginalised discrepancy is part of what the residuals may be.
        return (
            sd
            if problem.noise.discrepancy is None
            else jnp.hypot(sd, problem.noise.discrepancy * m)
        )

    return jax.vmap(one)(z, models)
