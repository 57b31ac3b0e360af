"""What `irisjax fit` prints and writes: table, summary, posterior, figures; one eye or many."""

import csv
import io as text_io
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.infer import other_process
from irisjax.infer.ahead import ahead, other_fit
from irisjax.infer.diagnostics import predictive_score
from irisjax.infer.fit import fit, words_for
from irisjax.infer.identifiability import in_words, information
from irisjax.infer.other_process import Interval
from irisjax.infer.parameters import kind, unit_of
from irisjax.infer.pieces import pointwise
from irisjax.infer.posterior import Chains, sample, words_of
from irisjax.infer.posterior import check_run as check_run
from irisjax.infer.problem import Problem
from irisjax.infer.store import copy_of
from irisjax.infer.summary import Check, Row, check, predictive, reported, summarise
from irisjax.plot.beside import Later, here
from irisjax.transport.process import AbstractProcess, option_of

COLUMNS = (
    "parameter",
    "unit",
    "median",
    "sd",
    "q2.5",
    "q16",
    "q84",
    "q97.5",
    "rhat",
    "ess_bulk",
    "ess_tail",
    "contraction",
    "process",
    "other_process",
    "other_value",
    "other_q2.5",
    "other_q97.5",
    "differs",
)
_MOST_NUMBERS = 1 << 24  # of log likelihoods in a file: 128 MB


def progress_bar(quiet: bool = False):
    """Steps on a terminal; before the first it says what takes so long. Open it before the problem
    is stated.
    """
    from tqdm import tqdm

    # Wrong input ends in one line: what stands here is wiped until there are steps.
    bar = tqdm(
        unit="step", bar_format="{desc}", leave=False, disable=quiet or not sys.stderr.isatty()
    )
    bar.set_description_str("compiling (quicker from the second run on) ...")
    return bar


def key_of(sampler: Mapping[str, Any]):
    """The key of a run."""
    return jax.random.key(sampler["seed"], impl="threefry2x32")


def one(
    problem: Problem,
    folder: Path,
    sampler: Mapping[str, Any],
    bar,
    *,
    resume: bool,
    files: bool,
    quiet: bool = False,
    draw: Callable[..., Later] = here,
) -> bool:
    """Fit, sample, print and write, with progress on `bar`; returns whether the chain is long
    enough.
    """
    key = key_of(sampler)

    def progress(n: int, word: str):
        first = not bar.disable and bar.bar_format is not None
        if first:
            bar.reset()  # compiling does not count as time for steps
            bar.bar_format, bar.leave = None, True
        bar.set_description_str(word, refresh=first)
        bar.update(n - bar.n)

    other = other_fit(problem, jax.random.fold_in(key, 5))
    with ahead(problem, key):
        best = fit(problem, key=jax.random.fold_in(key, 1))
    data = sum(o.values.shape[-1] for o in problem.observations)
    moving = sum(kind(n) != "noise" for n in problem.free)
    if data < moving:
        _say(
            f"{data} value{'s' * (data > 1)} for {moving} parameters: at least {moving - data} of "
            f"them keep their priors whatever was measured",
            quiet,
        )
    if not bool(best.converged):
        _say(f"least squares: {words_for(best.status)}; the sampler starts there", quiet)
    chains = sample(
        problem, best, store=folder / "chain.h5", walkers=sampler["walkers"], resume=resume,
        max_steps=sampler["max_steps"], progress=progress, key=key,
    )  # fmt: skip
    bar.set_description_str("summary")
    # Another process draws meanwhile.
    pictures, simulated = _figures(problem, chains, key, draw) if files else ({}, ())
    rows = summarise(problem, chains)
    tested = check(problem, chains, key=jax.random.fold_in(key, 2))
    intervals = {r.parameter: Interval(r.median, r.q2_5, r.q97_5) for r in rows}
    compared = other(best, intervals)
    by_other = other_process.comparison_in_words(compared)
    lines = [
        *by_other,
        *in_words(information(problem, best)),
        *_cautions(problem, rows, tested, chains),
    ]
    if files:
        bar.set_description_str("files")
        table = summary_csv(rows, problem.process, compared)
        likelihoods = _write(problem, folder, chains, table, lines, key, simulated, pictures)
        score, error = predictive_score(likelihoods, chains.ess_bulk.mean() / chains.z[..., 0].size)
        lines.append(
            f"predictive score {score:.1f} ± {error:.1f} (PSIS-LOO): compare it with that of "
            f"another --process"
        )
        if chains.converged:
            copy_of(folder / "chain.h5").unlink(missing_ok=True)
    bar.close()
    if not quiet:
        _print(problem, rows, lines, chains, first=len(by_other))
    return chains.converged


def summary_csv(rows: list[Row], process: AbstractProcess, by: other_process.Comparison) -> str:
    """The summary by a process as CSV, with what the other one makes of the pigments."""
    out = text_io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        moved, cells = by.moved.get(row.parameter), [""] * 5
        if moved is not None:
            numbers = (f"{x:.6g}" for x in moved.other)
            cells = [option_of(by.process), *numbers, "yes" if moved.differs else "no"]
        numbers = (f"{x:.6g}" for x in row[2:])
        writer.writerow([row.parameter, row.unit, *numbers, option_of(process), *cells])
    return out.getvalue()


def _figures(problem: Problem, chains: Chains, key, draw) -> tuple[dict[str, Later], Any]:
    """Pictures by file name, to come, and the simulated measurements that they show."""
    later = {}
    shown = [n for n in problem.free if kind(n) not in ("gain", "noise")]
    if len(shown) > 1:
        values = reported(problem, chains.z)
        named = {n: f"{n}\n({unit_of(n)})" if unit_of(n) else n for n in shown}
        later["corner.png"] = draw("corner_figure", {named[n]: values[n].ravel() for n in shown})
    _, simulated, models = predictive(problem, chains, key=jax.random.fold_in(key, 3))
    by = other_process.name_of(problem.process)
    shapes = [
        (
            f"{o.name}, by {by}",
            o.quantity,
            o.is_colour,
            np.asarray(o.wavelengths),
            np.asarray(o.values),
        )
        for o in problem.observations
    ]
    drawn = [[np.asarray(x) for x in arrays] for arrays in (simulated, models)]
    later["fit.png"] = draw("fit_figure", shapes, *drawn)
    return later, simulated


def _write(
    problem: Problem,
    folder: Path,
    chains: Chains,
    table: str,
    lines,
    key,
    simulated,
    pictures: Mapping[str, Later],
) -> np.ndarray:
    """Write all files; returns the log likelihoods that they hold, (walkers, draws, data)."""
    random = np.random.default_rng([*words_of(key), 4])
    prior = random.standard_normal((1, 4000, len(problem.free)))
    seen = problem.observations
    # Every draw has a log likelihood for every value: of many values fewer draws are kept.
    most = _MOST_NUMBERS // (chains.z.shape[1] * sum(o.values.shape[-1] for o in seen))
    thin = -(-len(chains.z) // max(1, most))
    by_chain = np.moveaxis(chains.z[::thin], 0, 1)
    likelihoods = pointwise(problem, by_chain.reshape(-1, by_chain.shape[-1]))
    likelihoods = likelihoods.reshape(*by_chain.shape[:2], -1)
    names = [f"{o.quantity}_{i + 1}" if len(seen) > 1 else o.quantity for i, o in enumerate(seen)]
    groups = {
        "posterior": reported(problem, by_chain),
        "prior": reported(problem, prior),
        "log_likelihood": {"data": likelihoods},
        "posterior_predictive": {
            n: np.asarray(s)[None] for n, s in zip(names, simulated, strict=True)
        },
        "sample_stats": {"lp": chains.log_probability[::thin].T},
    }
    observed = {n: np.asarray(o.values) for n, o in zip(names, seen, strict=True)}
    observed |= {
        f"wavelength_nm{n.removeprefix(o.quantity)}": np.asarray(o.wavelengths)
        for n, o in zip(names, seen, strict=True)
    }
    about = {
        "converged": str(chains.converged),
        "steps": str(chains.steps),
        "every": str(thin * chains.thin),
        "process": str(problem.process),
        "priors": "; ".join(
            f"{n} ~ {p}" for n, p in zip(problem.free, problem.priors, strict=True)
        ),
        "fixed": "; ".join(f"{n} = {float(v):g}" for n, v in problem.fixed.items()),
        "irisjax": ij.__version__,
        "says": " | ".join(lines),
    }
    io.write_posterior(folder / "posterior.nc", groups, about, observed)
    files = {folder / "summary.csv": table.encode()}
    io.write_together(files | {folder / name: picture() for name, picture in pictures.items()})
    return likelihoods


def _cautions(problem: Problem, rows: list[Row], tested: Check, chains: Chains) -> list[str]:
    lines = []
    unmoved = [r.parameter for r in rows if r.parameter in problem.free and r.contraction < 0.3]
    if unmoved:
        lines.append(
            f"the data hardly move {', '.join(unmoved)}: what is shown is mostly the prior"
        )
    if tested.warning:
        lines.append(f"WARNING: {tested.warning}")
    if not chains.converged:
        lines.append(f"NOT CONVERGED: {chains.reason}")
    return lines


def _print(problem: Problem, rows: list[Row], lines: list[str], chains: Chains, first: int) -> None:
    """The table, its `first` lines before it."""
    from rich.console import Console
    from rich.table import Table

    # Where nobody looks at it now, a line is as long as it is.
    console = Console(width=None if sys.stdout.isatty() else 1000, highlight=False)
    seen = problem.observations
    names, by = ", ".join(o.name for o in seen), other_process.name_of(problem.process)
    title = f"{names}: posterior{' of one eye' if len(seen) > 1 else ''} by {by}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    columns = {
        "parameter": [r.parameter for r in rows],
        "unit": [r.unit for r in rows],
        "median": [f"{r.median:.4g}" for r in rows],
        "68 %": [f"{r.q16:.3g} to {r.q84:.3g}" for r in rows],
        "95 %": [f"{r.q2_5:.3g} to {r.q97_5:.3g}" for r in rows],
        "R-hat": [f"{r.rhat:.3f}" for r in rows],
        "ESS": [f"{r.ess_bulk:.0f}" for r in rows],
        "contraction": [f"{r.contraction:.2f}" for r in rows],
    }
    # Numbers cut short would be worse than none.
    widths = {n: 2 + max(map(len, (n, *cells))) for n, cells in columns.items()}
    for name in ("68 %", "contraction", "unit", "ESS", "R-hat"):
        if sum(widths[n] for n in columns) > console.width:
            del columns[name]
    for name in columns:
        table.add_column(
            name, justify="left" if name in ("parameter", "unit") else "right", no_wrap=True
        )
    for cells in zip(*columns.values(), strict=True):
        table.add_row(*cells)
    for line in lines[:first]:
        console.print(line, markup=False, soft_wrap=True)
    console.print(table, crop=False)
    console.print(
        f"{chains.steps} steps, acceptance {chains.acceptance:.2f}, autocorrelation time "
        f"{chains.tau.max():.0f} steps"
    )
    for line in lines[first:]:
        console.print(line, markup=False, soft_wrap=True)


def _say(line: str, quiet: bool) -> None:
    if not quiet:
        print(f"irisjax: {line}", file=sys.stderr)
