"""Posteriors of clones by importance sampling, against ten others together and emcee's chain.

The chain walks among the standard normal numbers of the priors, from the highest maximum that the
search has found; where it is too short or the posterior has several maxima, it need not agree.
"""

import json
import time
from functools import partial
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from tqdm import tqdm

from experiments.common import RESULTS, start, write
from experiments.simulated_photographs import FOLDER
from irisjax.infer.importance import DRAWS, Start
from irisjax.infer.posterior import sample
from irisjax.io.photographs import read_photograph
from irisjax.numerics.chunks import map_rows
from irisjax.photo.clone import CloneSettings, Fitted, clone_eye
from irisjax.photo.pigments import FREE_NAMES, log_posterior, sample_pigments

QUANTILES = (0.025, 0.5, 0.975)
COLUMNS = ("photograph", "maxima", "sampler", "seconds", "densities", "effective", "enough")
COLUMNS += tuple(f"{kind}_at_{100 * q:g}" for kind in ("rms", "most") for q in QUANTILES)
WALKERS, STEPS, ROWS = 48, 1000, 24


def main(key, quick=False, out=RESULTS):
    """Write by how many per cent of probability the quantiles of all parameters are off those of
    ten samples together, root mean square and most (quick: one photograph, a short chain).
    """
    every = json.loads((FOLDER / "truth.json").read_text(encoding="utf-8"))["photographs"]
    files, rows = [p["file"] for p in every][: 1 if quick else None], []
    for file in tqdm(files, unit="photograph", disable=quick):
        *_, found = clone_eye(read_photograph(FOLDER / file), CloneSettings(), last="pigments")
        assert isinstance(found, Fitted)
        rows += _rows(file, found, 200 if quick else STEPS, key)
    about = ("clones of simulated photographs up to their pigments; seconds with compiling",)
    write(out / "clone_sampling.csv", about, COLUMNS, rows)


def _rows(file: str, found: Fitted, steps: int, key):
    known = found.windows, found.base, found.fit
    first, second, *others = jax.random.split(key, 12)
    drawn, seconds = _timed(partial(sample_pigments, *known, key=first))
    more = np.concatenate([sample_pigments(*known, key=k).z for k in others])
    chains, chain_seconds = _timed(partial(_chains, found, steps, second))
    maxima = 1 + len(found.fit.others)
    numbers = drawn.effective, drawn.converged
    yield (
        *(file, maxima, "importance", seconds, DRAWS * drawn.rounds, *numbers),
        *_off(drawn.z, more),
    )
    effective = float(np.minimum(chains.ess_bulk, chains.ess_tail).min())
    densities = WALKERS * chains.steps
    yield (
        *(file, maxima, "emcee", chain_seconds, densities, effective, chains.converged),
        *_off(chains.flat, more),
    )


def _chains(found: Fitted, steps: int, key):
    model, fit = (found.windows, found.base), found.fit

    def log_density(z):
        return map_rows(partial(_densities, model), np.asarray(z, np.float64), ROWS)

    target: Any = SimpleNamespace(names=FREE_NAMES, log_density=log_density)
    approximation = Start(fit.z, fit.covariance)
    return sample(target, approximation, walkers=WALKERS, max_steps=steps, key=key)


@eqx.filter_jit
def _densities(model, z):
    return jax.vmap(lambda row: log_posterior(row, *model))(z)


def _timed(f):
    begin = time.perf_counter()
    return f(), time.perf_counter() - begin


def _off(z, reference) -> list[float]:
    """Return by how many per cent the probabilities below the quantiles of `z`, in the reference,
    differ from those of the quantiles.
    """
    at = np.quantile(z, QUANTILES, axis=0)
    below = (reference[:, None] < at).mean(0)
    off = 100 * np.abs(below - np.array(QUANTILES)[:, None])
    return [*np.sqrt((off**2).mean(1)), *off.max(1)]


if __name__ == "__main__":
    start(main, __doc__)
