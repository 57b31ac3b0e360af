"""What a posterior needs after its search, compiled by a second thread while the search is."""

import contextlib
import threading
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.infer.identifiability import slopes
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

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        thread.join()
