"""Whether a chain's file belongs to a problem, found out before any work."""

import hashlib
import json
from pathlib import Path

import jax
import numpy as np

from irisjax._types import PRNGKey
from irisjax.infer.problem import Problem
from irisjax.infer.stream import Stream, repair


def check_run(
    problem: Problem, path: str | Path, *, walkers: int, resume: bool, key: PRNGKey
) -> None:
    """Raise, before any work, the `ValueError` that `sample` would."""
    path, free = Path(path), len(problem.free)
    if walkers < 2 * free + 2:
        raise ValueError(
            f"{walkers} walkers are too few for {free} free parameters; give at least "
            f"{2 * free + 2}"
        )
    if not path.exists():
        return
    if not resume:
        raise ValueError(f"{path}: exists; resume it or remove it")
    repair(path)
    if Stream(str(path), name="burn").mark() != fingerprint(problem, walkers, words_of(key)):
        raise ValueError(
            f"{path}: made from other data or settings; it cannot be resumed with these"
        )


def words_of(key: PRNGKey) -> list[int]:
    """The numbers of a key."""
    return [int(word) for word in np.ravel(jax.random.key_data(key))]


def fingerprint(problem: Problem, walkers: int, words: list[int]) -> str:
    """A mark of what a chain belongs to: the problem with all its settings, and the draws."""
    digest = hashlib.sha256(
        json.dumps([walkers, words, problem.free, str(problem.process)]).encode()
    )
    # Structures name what is static: quantity, incidence, cornea, first surface, solver's settings.
    static = [jax.tree.structure((o.instrument, o.covariance_root)) for o in problem.observations]
    quantities = [o.quantity for o in problem.observations]
    form = [problem.priors, static, quantities, jax.tree.structure(problem.solvers)]
    digest.update(repr(form).encode())
    for leaf in jax.tree.leaves((problem.observations, problem.noise, problem.base, problem.fixed)):
        digest.update(np.asarray(leaf).tobytes() if not isinstance(leaf, str) else leaf.encode())
    return digest.hexdigest()
