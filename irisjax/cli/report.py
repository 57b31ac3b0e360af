"""Report of `irisjax fit` on one eye: table, summary, posterior and figures."""

import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli import sentences
from irisjax.cli.fit_options import Sampler
from irisjax.cli.options import notice
from irisjax.infer.analysis import Analysis, analyse, predictive
from irisjax.infer.draws import ArvizGroups, arviz_groups
from irisjax.infer.fit import words_for
from irisjax.infer.model_comparison import predictive_score
from irisjax.infer.observation import Observation
from irisjax.infer.parameters import kind, unit_of
from irisjax.infer.posterior import Chains
from irisjax.infer.problem import Problem, reported
from irisjax.io.tables import csv_of
from irisjax.plot.beside import Later, here
from irisjax.transport.process import option_of

COLUMNS = (
    "parameter", "unit", "median", "sd", "q2.5", "q16", "q84", "q97.5", "rhat", "ess_bulk",
    "ess_tail", "contraction", "process", "other_process", "other_value", "other_q2.5",
    "other_q97.5", "differs",
)  # fmt: skip


def progress_bar(quiet: bool = False) -> Any:
    """Make a bar that counts steps on a terminal; before the first it shows that JAX compiles."""
    from tqdm import tqdm

    # Until there are steps the bar is erased at the end, so that wrong input ends in one line.
    bar = tqdm(unit="step", bar_format="{desc}", leave=False, disable=quiet or None)
    bar.set_description_str("compiling (quicker from the second run on) ...")
    return bar


def step_counter(bar: Any, leave: bool) -> Callable[[int, str], None]:
    """Make a function that shows a number of steps and a word on a `progress_bar`, which stays
    after the run if `leave`.
    """

    def progress(steps: int, word: str) -> None:
        first = not bar.disable and bar.bar_format is not None
        if first:
            bar.reset()  # compiling does not count as time for steps
            bar.bar_format, bar.leave = None, leave
        bar.set_description_str(word, refresh=first)
        bar.update(steps - bar.n)

    return progress


def report_eye(
    problem: Problem,
    folder: Path | None,
    sampler: Sampler,
    bar: Any,
    *,
    resume: bool,
    quiet: bool = False,
    draw: Callable[..., Later] = here,
) -> bool:
    """Analyse one eye, print the result (unless `quiet`) and write it into the folder, if there is
    one; `resume` continues the folder's chain. Return whether the chain is long enough.
    """
    store = None if folder is None else folder / "chain.h5"
    options = {"resume": resume, "walkers": sampler.walkers, "max_steps": sampler.max_steps}
    progress = step_counter(bar, leave=True)
    analysis = analyse(problem, store=store, progress=progress, key=sampler.key, **options)
    process_lines = sentences.process_lines(analysis.other)
    lines = sentences.information_lines(analysis.information)
    lines += sentences.result_warnings(analysis)
    if folder is not None:
        bar.set_description_str("files")
        score, error = _write(analysis, folder, [*process_lines, *lines], sampler.key, draw)
        advice = "compare it with that of another --process"
        lines.append(f"predictive score {score:.1f} ± {error:.1f} (PSIS-LOO): {advice}")
    bar.close()
    if not quiet:
        _print(analysis, process_lines, lines)
    return analysis.chains.converged


def _summary(analysis: Analysis) -> str:
    """Return the summary as CSV, with the pigments by the other process."""
    process, other = (option_of(p) for p in (analysis.problem.process, analysis.other.process))
    rows = []
    for row in analysis.rows:
        moved, cells = analysis.other.moved.get(row.parameter), [""] * 5
        if moved is not None:
            cells = [other, *(f"{x:.6g}" for x in moved.other), "yes" if moved.differs else "no"]
        numbers = ["" if np.isnan(x) else f"{x:.6g}" for x in row[2:]]
        rows.append([row.parameter, row.unit, *numbers, process, *cells])
    return csv_of([COLUMNS, *rows])


def figure_data(observation: Observation) -> tuple[str, str, bool, np.ndarray, np.ndarray]:
    """Return a measurement's data for figures: name, quantity, kind, wavelengths and values."""
    grid, values = np.asarray(observation.wavelengths), np.asarray(observation.values)
    return observation.name, observation.quantity, observation.is_colour, grid, values


def label_with_unit(name: str, between: str = " ") -> str:
    """Return a parameter's name with its unit."""
    return f"{name}{between}({unit_of(name)})" if unit_of(name) else name


def print_table(
    before: Iterable[str],
    columns: Mapping[str, list[str]],
    after: Iterable[str],
    *,
    title: str | None = None,
    dispensable: Iterable[str] = (),
) -> None:
    """Print a table of texts between lines. On a terminal that is too narrow, `dispensable` columns
    are left out one by one; in a pipe lines may have any length.
    """
    from rich.console import Console
    from rich.table import Table

    out = Console(width=None if sys.stdout.isatty() else 1000, highlight=False)
    columns, first = dict(columns), next(iter(columns))
    # A number that is cut short would be worse than none.
    widths = {n: 2 + max(map(len, (n, *cells))) for n, cells in columns.items()}
    for name in dispensable:
        if sum(widths[n] for n in columns) > out.width:
            del columns[name]
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in columns:
        justify = "left" if name in (first, "unit") else "right"
        table.add_column(name, justify=justify, no_wrap=True)
    for cells in zip(*columns.values(), strict=True):
        table.add_row(*cells)
    for line in before:
        out.print(line, markup=False, soft_wrap=True)
    out.print(table, crop=False)
    for line in after:
        out.print(line, markup=False, soft_wrap=True)


def _write(
    analysis: Analysis, folder: Path, lines: list[str], key: jax.Array, draw: Callable[..., Later]
) -> tuple[float, float]:
    """Write all files; return the predictive score and its error."""
    problem, chains = analysis.problem, analysis.chains
    observations = problem.observations
    simulated, models, *_ = predictive(problem, chains, key=jax.random.fold_in(key, 3))
    shapes = [
        (f"{name}, by {problem.process.name}", *rest)
        for name, *rest in map(figure_data, observations)
    ]
    # Figures are drawn while the rest is computed.
    pictures = {"fit.png": draw("fit_figure", shapes, list(simulated), list(models))}
    names = [n for n in problem.free if kind(n) not in ("gain", "noise")]
    if len(names) > 1:
        values = reported(problem, chains.flat)
        values = {label_with_unit(n, "\n"): values[n] for n in names}
        pictures["corner.png"] = draw("corner_figure", values)
    groups = write_groups(folder, problem, chains, lines, key)
    files = {folder / "summary.csv": _summary(analysis).encode()}
    io.write_together(files | {folder / name: picture() for name, picture in pictures.items()})
    log_likelihoods = [array for _, array in groups.arrays["log_likelihood"].values()]
    likelihoods = np.concatenate(log_likelihoods, axis=-1)
    return predictive_score(likelihoods, chains.ess_bulk.mean() / chains.z[..., 0].size)


def write_groups(
    folder: Path, problem: Problem, chains: Chains, lines: list[str], key: jax.Array
) -> ArvizGroups:
    """Write draws into the folder in ArviZ's groups, and return these."""
    groups = arviz_groups(problem, chains, key=key)
    priors = zip(problem.free, problem.priors, strict=True)
    attributes = {
        "converged": str(chains.converged),
        "steps": str(chains.steps),
        "every": str(groups.every),
        "process": option_of(problem.process),
        "priors": "; ".join(f"{n} ~ {p}" for n, p in priors),
        "fixed": "; ".join(f"{n} = {float(v):g}" for n, v in problem.fixed.items()),
        "irisjax": ij.__version__,
        "says": " | ".join(lines),
    }
    io.write_posterior(folder / "posterior.nc", groups.arrays, groups.coordinates, attributes)
    return groups


def _print(analysis: Analysis, first: list[str], lines: list[str]) -> None:
    """Print the table between its lines, and warnings on standard error."""
    rows, chains, observations = analysis.rows, analysis.chains, analysis.problem.observations
    for doubt in sentences.data_warnings(analysis.problem):
        notice(doubt)
    if not bool(analysis.fit.converged):
        notice(f"least squares: {words_for(analysis.fit.status)}; the sampler started there")
    names = ", ".join(o.name for o in observations)
    subject = f"{names}: posterior{' of one eye' if len(observations) > 1 else ''}"
    columns = {
        "parameter": [r.parameter for r in rows],
        "unit": [r.unit for r in rows],
        "median": [f"{r.median:.4g}" for r in rows],
        "68 %": [f"{r.q16:.3g} to {r.q84:.3g}" for r in rows],
        "95 %": [f"{r.q2_5:.3g} to {r.q97_5:.3g}" for r in rows],
        # A chain that is too short to be judged has neither.
        "R-hat": ["-" if np.isnan(r.rhat) else f"{r.rhat:.3f}" for r in rows],
        "ESS": ["-" if np.isnan(r.ess_bulk) else f"{r.ess_bulk:.0f}" for r in rows],
        "contraction": [f"{r.contraction:.2f}" for r in rows],
    }
    time = chains.tau.max()
    chain_line = (
        f"{chains.steps} steps, acceptance {chains.acceptance:.2f}, autocorrelation time "
        f"{'unknown' if np.isnan(time) else f'{time:.0f} steps'}"
    )
    title = f"{subject} by {analysis.problem.process.name}"
    dispensable = ("68 %", "contraction", "unit", "ESS", "R-hat")
    print_table(first, columns, [chain_line, *lines], title=title, dispensable=dispensable)
