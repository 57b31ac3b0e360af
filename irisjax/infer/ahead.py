"""What a posterior needs beside its search, done by other threads meanwhile."""

import contextlib
import importlib
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.infer.fit import Fit
from irisjax.infer.identifiability import slopes
from irisjax.infer.other_process import Comparison, Interval, compared, optimum, other_of
from irisjax.infer.pieces import density, predicted
from irisjax.infer.problem import Problem
from irisjax.infer.summary import DRAWS, reported


@contextlib.contextmanager
def ahead(problem: Problem, key: PRNGKey) -> Iterator[None]:
    """Meanwhile run what `sample`, `summarise`, `check` and `information` will, at the priors'
    medians. XLA compiles without Python's lock; whatever fails will fail again where it belongs.
    """
    z = np.zeros((1, len(problem.free)))

    def run() -> None:
        with contextlib.suppress(Exception):
            density(problem)(z)
            predicted(problem.unnamed(), jnp.asarray(np.repeat(z, DRAWS, axis=0)), key)
            slopes(problem, z[0])
            reported(problem, z)

    def load() -> None:
        with contextlib.suppress(ImportError):
            importlib.import_module("arviz_stats.base.array")

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        thread.join()
        # What diagnostics need, half a second, while walkers walk.
        threading.Thread(target=load, daemon=True).start()


def other_fit(
    problem: Problem, key: PRNGKey
) -> Callable[[Fit, Mapping[str, Interval]], Comparison]:
    """`compare`, whose fit of the other process begins now: a function of the problem's own fit and
    intervals, which waits for it.
    """
    executor = ThreadPoolExecutor(1, "irisjax-other-process")
    other = problem.by(other_of(problem.process))
    found = executor.submit(optimum, other, key)
    executor.shutdown(wait=False)
    return lambda own, intervals: compared(problem, own, other, found.result(), intervals)
