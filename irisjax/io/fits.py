"""Results of `irisjax fit --batch`: a row for each eye, and the covariances of its parameters."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from irisjax.infer.parameters import PARAMETERS, kind
from irisjax.infer.populations import KERNELS, WIDTH
from irisjax.infer.priors import AbstractPrior, prior_of
from irisjax.io.tables import naming

COVARIANCES = ("eye", "parameter", "prior", "other", "covariance")
"""Columns of the file of covariances."""
CONVERGED = "converged"
"""Entry of the column `posterior` of an eye whose chain is long enough."""
LIKELIHOOD = "likelihood.npz"
"""File of an eye's `likelihood_draws`, an array for each parameter."""


class FittedEyes(NamedTuple):
    """Eyes of a group, fitted with the same free parameters and priors.

    Attributes:
        names: Names of the eyes.
        priors: Priors by name of the parameters, except gain and noise, which are the instrument's.
        values: Most probable values, in the parameters' units.
        z, covariance: Most probable values and their covariance, marginalised over the gain, in the
            coordinates in which priors are standard normal.
        process: Name of the light's process in commands.
        left_out: Names of eyes that are not used, and their status.
        draws: Draws of the posteriors in these coordinates; `None` unless every eye has a
            converged posterior (`--posteriors`).
        width: Standard deviation of the priors of these draws: that of `likelihood_draws` where
            every eye has them, or 1.
    """

    names: tuple[str, ...]
    priors: dict[str, AbstractPrior]
    values: Float[np.ndarray, "eyes parameters"]
    z: Float[np.ndarray, "eyes parameters"]
    covariance: Float[np.ndarray, "eyes parameters parameters"]
    process: str
    left_out: dict[str, str]
    draws: Float[np.ndarray, "eyes draws parameters"] | None
    width: float


def covariance_rows(
    eye: str, priors: Mapping[str, AbstractPrior], covariance: Float[np.ndarray, "free free"]
) -> list[dict[str, str]]:
    """Return the rows of an eye in a file of covariances, in the parameters' units."""
    return [
        dict(zip(COVARIANCES, (eye, n, repr(prior), other, f"{x:.12g}"), strict=True))
        for (n, prior), row in zip(priors.items(), covariance, strict=True)
        for other, x in zip(priors, row, strict=True)
    ]


def covariances_beside(path: Path) -> Path:
    """Return the file of covariances of a table of eyes."""
    return path.with_name(f"{path.stem}-covariance.csv")


def read_covariances(path: Path) -> dict[str, list[dict[str, str]]]:
    """Read the rows of each eye of a file of covariances; none of one that is not there."""
    groups: dict[str, list[dict[str, str]]] = {}
    if path.exists():
        for row in _rows(path, COVARIANCES):
            groups.setdefault(row["eye"], []).append(row)
    return groups


def read_fits(path: Path, status: Iterable[str] = ("ok",)) -> FittedEyes:
    """Read the eyes of a folder or table of `irisjax fit --batch` that have such a status.

    Raises:
        ValueError: For another table, fewer than two eyes, and eyes that were not fitted alike.
    """
    path = path / "fits.csv" if path.is_dir() else path
    rows = _rows(path, ("eye", "status"))
    beside = covariances_beside(path)
    stored, eyes, left = read_covariances(beside), {}, {}
    if not stored:
        raise ValueError(f"{beside}: not there, or empty; irisjax fit --batch -o writes it")
    for row in rows:
        usable = row["status"] in tuple(status) and row["eye"] in stored
        (eyes if usable else left)[row["eye"]] = row if usable else row["status"]
    if len(eyes) < 2:
        message = f"{path}: {len(eyes)} of {len(rows)} eyes can be used; a group needs two or more"
        raise ValueError(f"{message} with status {' or '.join(status)}")
    with naming(path):
        priors = _common("priors", [{r["parameter"]: r["prior"] for r in stored[n]} for n in eyes])
        process = _common("processes", [row.get("process", "") for row in eyes.values()])
        values = _numbers(eyes.values(), list(priors))
        _numbers(eyes.values(), [f"{name}_sd" for name in priors])
    with naming(beside):
        size = len(priors)
        matrices = [_numbers(stored[name], ["covariance"]) for name in eyes]
        if any(len(x) != size**2 for x in matrices):
            raise ValueError("an eye lacks some covariances; irisjax fit --batch writes all")
        covariance = np.reshape(matrices, (len(eyes), size, size))
        free_priors = {n: prior_of(p, *PARAMETERS[kind(n)].support) for n, p in priors.items()}
    z, slope = np.empty_like(values), np.empty_like(values)
    for i, prior in enumerate(free_priors.values()):
        z[:, i], slope[:, i] = _in_standard(prior, values[:, i])
    if (wrong := ~np.isfinite(z / slope).all(axis=1)).any():
        raise ValueError(f"{path}: {list(eyes)[np.argmax(wrong)]} lies at the end of its prior")
    covariance = covariance / (slope[:, :, None] * slope[:, None, :])
    cols = [i for i, name in enumerate(free_priors) if kind(name) not in ("gain", "noise")]
    if not cols:
        raise ValueError(f"{path}: no parameter of the iris is free")
    free, draws = {n: free_priors[n] for i, n in enumerate(free_priors) if i in cols}, None
    wide = [path.parent / name / LIKELIHOOD for name in eyes]
    reach = all(file.exists() for file in wide)
    if all(row.get("posterior") == CONVERGED for row in eyes.values()):
        if reach:
            draws = np.stack([np.stack([x[n] for n in free], 1) for x in map(np.load, wide)])
        else:
            draws = np.stack([_draws(path.parent / name / "posterior.nc", free) for name in eyes])
    return FittedEyes(
        tuple(eyes), free, values[:, cols], z[:, cols], covariance[:, cols][:, :, cols], process,
        left, draws, WIDTH if reach else 1.0,
    )  # fmt: skip


def _draws(path: Path, priors: Mapping[str, AbstractPrior]) -> np.ndarray:
    """Read draws from a posterior's file, spread evenly over its walkers and steps."""
    import h5netcdf

    with h5netcdf.File(path) as file:
        variables = file["posterior"].variables
        draws = [_in_standard(prior, np.ravel(variables[n]))[0] for n, prior in priors.items()]
    index = np.linspace(0, draws[0].size - 1, KERNELS).astype(int)
    return np.stack([np.asarray(x)[index] for x in draws], axis=1)


@eqx.filter_jit
def _in_standard(
    prior: AbstractPrior, values: np.ndarray | jax.Array
) -> tuple[jax.Array, jax.Array]:
    z = prior.standard(jnp.asarray(values))
    return z, jax.jvp(prior.value, (z,), (jnp.ones_like(z),))[1]


def _rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    table = csv.DictReader(path.read_text(encoding="utf-8").splitlines())
    if not set(columns) <= set(table.fieldnames or ()):
        raise ValueError(f"{path}: is no table of irisjax fit --batch")
    return list(table)


def _numbers(rows: Iterable[Mapping[str, str]], columns: Sequence[str]) -> np.ndarray:
    numbers = []
    for row in rows:
        for name in columns:
            try:
                numbers.append(float(row[name]))
            except (KeyError, ValueError, TypeError):
                raise ValueError(f"{row['eye']} has no number in a column {name}") from None
    return np.reshape(numbers, (-1, len(columns)))


def _common(quantity, values):
    if any(one != values[0] for one in values):
        raise ValueError(f"its eyes were fitted with different {quantity}; fit them in one batch")
    return values[0]
