"""What the data tell and what they do not, from the curvature at the best fit."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from irisjax.infer.fit import Fit
from irisjax.infer.parameters import OF_POWER_LAW, kind
from irisjax.infer.problem import Problem

_WORDS = {
    "melanin_load": "load", "abl_fraction": "fraction", "pheomelanin_share": "pheomelanin share",
    "hemoglobin": "haemoglobin", "saturation": "saturation", "stroma_thickness": "stroma thickness",
    "abl_thickness": "ABL thickness", "scattering_scale": "scattering", "gain": "gain",
    "reduced_scattering": "reduced scattering", "rayleigh_share": "Rayleigh share",
    "scattering_power": "scattering power", "anisotropy": "anisotropy",
}  # fmt: skip


class Direction(NamedTuple):
    """A combination of parameters Π value^exponent and how well the data alone know it (relative
    sd).
    """

    exponents: dict[str, float]
    relative: float

    def __str__(self):
        above = [_power(n, e) for n, e in self.exponents.items() if e > 0]
        below = [_power(n, -e) for n, e in self.exponents.items() if e < 0]
        text = " × ".join(above) or "1"
        return text + (
            f" / ({' × '.join(below)})" if len(below) > 1 else f" / {below[0]}" if below else ""
        )


class Information(NamedTuple):
    """Fisher information of the data alone in the logarithms of the parameters.

    - `names`: parameters, noise left out; `fisher`: (names, names).
    - `directions`: its eigenvectors from the best known to the worst.
    - `alone`: relative sd of each parameter with all others free, without priors; infinite where
        unknown.
    - `correlation`: of load and fraction given data and priors, or nan.
    - `trades`: of each free number of a power law of scattering, the share of its prior's width
        that data and priors leave, the parameter it trades with most, and their correlation.
    """

    names: tuple[str, ...]
    fisher: np.ndarray
    directions: list[Direction]
    alone: dict[str, float]
    correlation: float
    trades: dict[str, tuple[float, str, float]]


def information(problem: Problem, fit: Fit) -> Information:
    """Fisher information at a fit."""
    kept = [i for i, n in enumerate(problem.free) if not n.startswith("noise")]
    names = tuple(problem.free[i] for i in kept)
    jacobian, value, slope = (x[..., kept] for x in slopes(problem, fit.z))
    in_logs = jacobian / slope * value
    fisher = in_logs.T @ in_logs
    eigenvalues, vectors = np.linalg.eigh(fisher)
    directions = []
    for k in range(len(names))[::-1]:
        v = vectors[:, k] / np.abs(vectors[:, k]).max()
        v = v * np.sign(v[np.argmax(np.abs(v))])
        shown = {n: float(e) for n, e in zip(names, v, strict=True) if abs(e) >= 0.2}
        directions.append(
            Direction(
                shown, float(1 / np.sqrt(max(eigenvalues[k], 1e-30)) / np.abs(vectors[:, k]).max())
            )
        )
    unknown = eigenvalues < 1e-12 * eigenvalues.max()
    spread = (
        vectors
        @ np.diag(np.where(unknown, np.inf, 1 / np.where(unknown, 1, eigenvalues)))
        @ vectors.T
    )
    with np.errstate(invalid="ignore"):
        alone = {
            n: float(np.sqrt(x)) if np.isfinite(x) else np.inf
            for n, x in zip(names, np.diag(spread), strict=True)
        }
    correlation, c = np.nan, np.asarray(fit.covariance)
    if {"melanin_load", "abl_fraction"} <= set(problem.free):
        a, b = (problem.free.index(n) for n in ("melanin_load", "abl_fraction"))
        correlation = float(c[a, b] / np.sqrt(c[a, a] * c[b, b]))
    return Information(names, fisher, directions, alone, correlation, _trades(problem, c, kept))


def in_words(found: Information) -> list[str]:
    """The best and the worst known combination, and each parameter by itself."""
    best, worst = found.directions[0], found.directions[-1]
    lines = [
        f"best known: {best}, to {_percent(best.relative)}",
        f"least known: {worst}, to {_percent(worst.relative)}",
    ]
    load, fraction = found.alone.get("melanin_load"), found.alone.get("abl_fraction")
    if load is not None and fraction is not None:
        a, b = found.names.index("melanin_load"), found.names.index("abl_fraction")
        product = _combination(found.fisher, a, b)
        lines.append(
            f"load × fraction (the melanin of the ABL) is known to {_percent(product)}, the load "
            f"alone to "
            f"{_percent(load)}, the fraction alone to {_percent(fraction)} (data only, without "
            f"priors)"
        )
    for name, (left, partner, correlation) in found.trades.items():
        told = "not told by the data" if left > 0.9 else f"{100 * left:.0f} % of its prior's width"
        ridge = f"; trades with {_word(partner)} (correlation {correlation:+.2f})"
        lines.append(f"{_word(name)}: {told}{ridge if abs(correlation) > 0.3 else ''}")
    return lines


def _trades(problem: Problem, covariance, kept: list[int]) -> dict[str, tuple[float, str, float]]:
    """`Information.trades`, in the priors' coordinates, in which a prior's width is one."""
    width = np.sqrt(np.diag(covariance))
    # A parameter that the data do not see at all has no width here, and trades with none.
    seen = np.where(width > 0, width, 1.0)
    correlation = covariance / np.outer(seen, seen)
    out = {}
    for i in (i for i in kept if kind(problem.free[i]) in OF_POWER_LAW):
        others = [k for k in kept if k != i]
        if others:
            most = max(others, key=lambda k: abs(correlation[i, k]))
            out[problem.free[i]] = (
                float(width[i]),
                problem.free[most],
                float(correlation[i, most]),
            )
    return out


def _combination(fisher, a: int, b: int) -> float:
    values, vectors = np.linalg.eigh(fisher)
    direction = np.zeros(len(fisher))
    direction[[a, b]] = 1
    parts = (vectors.T @ direction) ** 2
    return float(np.sqrt((parts / np.maximum(values, 1e-30)).sum()))


def _percent(x: float) -> str:
    if not np.isfinite(x) or x > _UNKNOWN:
        return "no limit"
    return f"a factor of {np.exp(x):.2g}" if x > 1 else f"{100 * x:.2g} %"


_UNKNOWN = 3.0  # a factor of twenty


def _word(name: str) -> str:
    return _WORDS[kind(name)] + (f"@{name.partition('@')[2]}" if "@" in name else "")


def _power(name: str, exponent: float) -> str:
    word = _word(name)
    return word if abs(exponent - 1) < 0.05 else f"{word}^{exponent:.1f}"


def slopes(problem: Problem, z) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian of the residuals (data, free), values of the free parameters, and their slopes, in
    the priors' coordinates.
    """
    jacobian, values, each = _slopes(problem.unnamed(), jnp.asarray(z))
    return np.asarray(jacobian), np.asarray(values), np.asarray(each)


@eqx.filter_jit
def _slopes(problem: Problem, z):
    """Jacobian of the residuals; values, and their slopes: each depends on its own coordinate."""
    natural = jax.jvp(lambda x: problem.natural(x), (z,), (jnp.ones_like(z),))
    return jax.jacfwd(lambda x: problem.residuals(x))(z), *natural
