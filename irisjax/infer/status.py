"""How a fit or a chain ended, by name: searches that failed apart from data that do not fit."""

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer


class FitStatus(eqx.Enumeration):
    """Outcome of a least-squares fit; the first of these that holds, from the bottom up."""

    successful = ""
    misfit = (
        "the search converged, but the model does not produce these data: chi-square is far above "
        "its degrees of freedom at the stated noise"
    )
    disagreement = (
        "one start alone reached the lowest cost while others converged elsewhere; there may be a "
        "lower one: give more starts"
    )
    not_converged = "the search did not converge within its steps"
    solver_failed = (
        "least squares or the transport solver failed at the best point found; see `steps` and "
        "`Problem.status`"
    )


class ChainStatus(eqx.Enumeration):
    """Outcome of a sampling run: whether the chain is long enough, or what it lacks first."""

    successful = ""
    stuck = "a walker never moved"
    few_autocorrelation_times = "the chain has too few autocorrelation times"
    few_effective_samples = "the chain has too few effective samples"
    not_mixed = "walkers disagree (R-hat)"


def throw(status, reason: str = "") -> None:
    """Raise `ValueError` with the reason if a concrete status is not success; ignore a traced one.

    Args:
        status: An item of `FitStatus` or `ChainStatus`, or a batch of them.
        reason: Figures to say in place of the item's own words.
    """
    if isinstance(status._value, Tracer):
        return
    codes = np.asarray(status._value)
    if codes.any():
        said = reason or (
            says(status) if codes.ndim == 0 else "some of the batch failed; see status"
        )
        raise ValueError(said)


def says(status) -> str:
    """The words of one concrete status, empty for success."""
    # Equinox knows no words for a NumPy scalar, which is what an item of a batch is.
    return status._enumeration[jax.tree.map(np.asarray, status)]
