"""`irisjax compare-groups`: two groups of eyes, or one group measured twice."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli import batch
from irisjax.cli import options as opt
from irisjax.cli.report import print_table
from irisjax.cli.sentences import interval
from irisjax.infer.model_comparison import Interval
from irisjax.infer.parameters import unit_of
from irisjax.infer.populations import KERNELS, PRIOR, population
from irisjax.infer.priors import AbstractPrior
from irisjax.infer.repeatability import agreement, intraclass_correlation
from irisjax.io.fits import FittedEyes, read_fits
from irisjax.io.tables import csv_of
from irisjax.numerics.streams import key_of

_PRODUCT = ("melanin_load", "abl_fraction")  # abl_melanin
_FEWEST = 5  # effective draws of an eye below which its draws do not cover the group's distribution
_NORMAL = (
    "likelihood of each eye: normal, the fit divided by its prior (--posteriors emcee gives "
    "draws); where the shrinkage is above 0.5 means and spreads can be off by more than their "
    "intervals"
)
_EYES = 201  # simulated eyes of a group, from whose quantiles the spread of a product is computed
_Row = dict[str, str | Interval]


class Groups(opt.Group, panel="Groups"):
    first: Path = opt.argument(
        "results of irisjax fit --batch: the folder or its fits.csv", "A", ...
    )
    second: Path = opt.argument("results of the other group", "B", ...)
    paired: bool = opt.flag("the same eyes, measured twice: repeatability, by their names")
    doubtful: bool = opt.flag("use eyes of status doubtful too")
    output: Path | None = opt.output("for the table, as CSV; it is printed too", "FILE")
    seed: int = opt.seeded("results")


@opt.grouped
def compare_groups_command(groups: Groups) -> None:
    """Compare the pigments of two groups of eyes, with intervals.

    For example: irisjax compare-groups fits_control fits_treated

    The eyes of each group are fitted again under a prior that they share: a mean and a
    spread for each parameter, which are inferred. With --paired the groups are the same
    eyes measured twice, matched by their names.
    """
    if groups.output is not None:
        io.check_writable(groups.output)
    status = (batch.OK, batch.DOUBTFUL) if groups.doubtful else (batch.OK,)
    one, two = (read_fits(path, status) for path in (groups.first, groups.second))
    _check_alike(one, two)
    for path, fitted in ((groups.first, one), (groups.second, two)):
        if fitted.left_out:
            examples = ", ".join(f"{n} ({s})" for n, s in list(fitted.left_out.items())[:8])
            opt.notice(f"{path}: {len(fitted.left_out)} eyes are left out: {examples}")
    remarks, rows = _repeatability(one, two) if groups.paired else _compare(one, two, groups.seed)
    cells = [{n: x if isinstance(x, str) else interval(x) for n, x in r.items()} for r in rows]
    columns = {name: [row[name] for row in cells] for name in cells[0]}
    print_table([], columns, remarks, title="value (95 % interval)")
    if groups.output is not None:
        io.write_atomically(groups.output, _table(remarks, rows).encode())


def _check_alike(one: FittedEyes, two: FittedEyes) -> None:
    if set(one.priors) != set(two.priors):
        lists = " and ".join(", ".join(e.priors) for e in (one, two))
        raise ValueError(f"the groups have different free parameters: {lists}")
    if one.process != two.process:
        message = f"the groups were fitted by different processes, {one.process} and {two.process}"
        raise ValueError(f"{message}: fit both by one --process")
    if differing := [n for n in one.priors if repr(one.priors[n]) != repr(two.priors[n])]:
        raise ValueError(f"the groups were fitted with different priors of {differing[0]}")


@eqx.filter_jit
def _values(prior: AbstractPrior, z: Any) -> Any:
    return jax.tree.map(prior.value, z)


def _compare(one: FittedEyes, two: FittedEyes, seed: int) -> tuple[list[str], list[_Row]]:
    """Compare two groups; return remarks, and a row for each parameter."""
    key = key_of(seed)
    has_draws = one.draws is not None and two.draws is not None
    populations = [
        population(
            e.z, e.covariance, e.draws if has_draws else None, e.width if has_draws else 1.0,
            key=jax.random.fold_in(key, i),
        )
        for i, e in enumerate((one, two))
    ]  # fmt: skip
    random, typical, spread = np.random.default_rng([seed, 1]), [{}, {}], [{}, {}]
    for group, means, spreads in zip(populations, typical, spread, strict=True):
        deviations = group.spread[:, None] * random.standard_normal((1, _EYES, len(one.priors)))
        eyes = {}
        for i, (name, prior) in enumerate(one.priors.items()):
            mean, sd = group.mean[:, i], group.spread[:, i]
            middle, low, high = map(np.asarray, _values(prior, (mean, mean - sd, mean + sd)))
            means[name], spreads[name] = middle, (high - low) / 2
            if name in _PRODUCT:
                eyes[name] = np.asarray(_values(prior, mean[:, None] + deviations[..., i]))
        if len(eyes) == len(_PRODUCT):
            low, high = np.percentile(np.prod(list(eyes.values()), axis=0), (16, 84), axis=1)
            spreads["abl_melanin"] = (high - low) / 2
            means["abl_melanin"] = np.prod([means[n] for n in _PRODUCT], axis=0)
    rows: list[_Row] = []
    for i, name in enumerate(typical[0]):
        row: _Row = {"parameter": name, "unit": unit_of(name)}
        a, b = (means[name] for means in typical)
        row |= {"mean_a": Interval.of(a), "mean_b": Interval.of(b)}
        row |= {"difference": Interval.of(b - a), "p_b_above_a": f"{(b > a).mean():.3g}"}
        row |= {f"spread_{tag}": Interval.of(spread[k][name]) for k, tag in enumerate("ab")}
        for tag, group in zip("ab", populations, strict=True):
            is_parameter = i < len(one.priors)
            row[f"shrinkage_{tag}"] = f"{group.shrinkage[i]:.2g}" if is_parameter else ""
        rows.append(row)
    counts = f"{len(one.names)} eyes in a, {len(two.names)} in b, fitted by {one.process}"
    return [
        f"{counts}; difference: b less a",
        "mean: the typical eye (mean in the coordinate in which the fits' prior is normal)",
        "spread: half of the range of the central 68 % of eyes",
        _method([group.fewest for group in populations]) if has_draws else _NORMAL,
        f"priors: {PRIOR}; shrinkage: share by which an eye's own value is drawn to the mean",
        f"the fits' priors: {'; '.join(f'{n} ~ {p}' for n, p in one.priors.items())}",
    ], rows


def _method(fewest: Sequence[float]) -> str:
    """Describe the eyes' likelihoods, and warn if too few draws lie within the groups."""
    counts = " and ".join(f"{n:.0f}" for n in fewest)
    text = f"likelihood of each eye: a mixture fitted to {KERNELS} draws, divided by their prior"
    text = f"{text}; the group's distribution leaves {counts} effective ones or more"
    if min(fewest) >= _FEWEST:
        return text
    return f"WARNING: {text}, too few: means and spreads can be off by more than their intervals"


def _repeatability(one: FittedEyes, two: FittedEyes) -> tuple[list[str], list[_Row]]:
    """Compare repeated measurements of the eyes that are in both; return remarks, and a row for
    each parameter.
    """
    names = [name for name in one.names if name in two.names]
    if len(names) < 3:
        message = f"{len(names)} eyes have the same name in both and can be used"
        raise ValueError(f"--paired takes three or more: {message}")
    values = [e.values[[e.names.index(n) for n in names]] for e in (one, two)]
    pairs = {n: np.stack([v[:, i] for v in values], 1) for i, n in enumerate(one.priors)}
    if set(_PRODUCT) <= set(pairs):
        pairs["abl_melanin"] = np.prod([pairs[n] for n in _PRODUCT], axis=0)
    rows: list[_Row] = []
    for name, x in pairs.items():
        within, limits = intraclass_correlation(x), agreement(x[:, 0], x[:, 1])
        row = {"icc_agreement": within.agreement, "icc_consistency": within.consistency}
        row |= {"bias": limits.bias, "lower_limit": limits.lower, "upper_limit": limits.upper}
        rows.append({"parameter": name, "unit": unit_of(name), **row})
    return [
        f"{len(names)} eyes measured twice, fitted by {one.process}",
        "icc_agreement: ICC(2,1), icc_consistency: ICC(3,1) [Shrout & Fleiss 1979]",
        "bias: mean of b less a; limits: bias ± 1.96 sd of the differences [Bland & Altman 1986]",
    ], rows


def _table(remarks: Sequence[str], rows: Sequence[_Row]) -> str:
    """Return CSV with a row for each parameter, after comments with the remarks."""
    table = []
    for row in rows:
        cells: dict[str, str] = {}
        for name, x in row.items():
            ends = [x] if isinstance(x, str) else [f"{v:.6g}" for v in x]
            cells |= dict(zip((name, f"{name}_q2.5", f"{name}_q97.5"), ends, strict=False))
        table.append(cells)
    header = "".join(f"# {line}\n" for line in (*remarks, f"irisjax {ij.__version__}"))
    return header + csv_of([list(table[0]), *(list(cells.values()) for cells in table)])
