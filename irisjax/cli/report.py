"""What `irisjax fit` prints and writes: table, summary, posterior, figures; one eye or many."""

import csv
import io as text_io
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import irisjax as ij
from irisjax import io, plot
from irisjax.infer.fit import fit
from irisjax.infer.identifiability import in_words, information
from irisjax.infer.posterior import Chains, sample
from irisjax.infer.problem import Problem, kind
from irisjax.infer.summary import Check, Row, check, predictive, reported, summarise

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
)


def one(
    problem: Problem, folder: Path, sampler: Mapping[str, Any], *, resume: bool, files: bool, quiet: bool = False
) -> bool:
    """Fit, sample, print and write; returns whether the chain is long enough."""
    from tqdm import tqdm

    key = jax.random.key(sampler["seed"], impl="threefry2x32")
    best = fit(problem, key=jax.random.fold_in(key, 1))
    if not bool(best.ok):
        _say("the least-squares search did not converge; its end starts the sampler", quiet)
    with tqdm(unit="step", delay=1, disable=quiet or not sys.stderr.isatty()) as bar:

        def progress(n: int, word: str):
            bar.set_description(word, refresh=False)
            bar.update(n - bar.n)

        chains = sample(problem, folder / "chain.h5", start=best, resume=resume, progress=progress, **sampler)
    rows = summarise(problem, chains)
    tested = check(problem, chains, jax.random.fold_in(key, 2))
    lines = [*in_words(information(problem, best)), *_cautions(problem, rows, tested, chains)]
    if files:
        _write(problem, folder, chains, rows, lines, key)
        score, error = io.predictive_score(folder / "posterior.nc")
        lines.append(
            f"predictive score {score:.1f} ± {error:.1f} (PSIS-LOO): compare it with that of another --process"
        )
    if not quiet:
        _print(problem, rows, lines, chains)
    return chains.converged


def summary_csv(rows: list[Row]) -> str:
    """The summary as CSV."""
    out = text_io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([row.parameter, row.unit, *(f"{x:.6g}" for x in row[2:])] for row in rows)
    return out.getvalue()


def _write(problem: Problem, folder: Path, chains: Chains, rows, lines, key) -> None:
    count = 500
    _, simulated, models = predictive(problem, chains, jax.random.fold_in(key, 3), count)
    prior = np.asarray(jax.random.normal(jax.random.fold_in(key, 4), (1, 4000, len(problem.free))))
    by_chain = np.moveaxis(chains.z, 0, 1)
    pointwise = np.asarray(jax.jit(jax.vmap(lambda x: problem.pointwise(x)))(by_chain.reshape(-1, by_chain.shape[-1])))
    seen = problem.observations
    names = [f"{o.quantity}_{i + 1}" if len(seen) > 1 else o.quantity for i, o in enumerate(seen)]
    groups = {
        "posterior": reported(problem, by_chain),
        "prior": reported(problem, prior),
        "log_likelihood": {"data": pointwise.reshape(*by_chain.shape[:2], -1)},
        "posterior_predictive": {n: np.asarray(s)[None] for n, s in zip(names, simulated, strict=True)},
        "sample_stats": {"lp": chains.log_probability.T},
    }
    observed = {n: np.asarray(o.values) for n, o in zip(names, problem.observations, strict=True)}
    observed["wavelength_nm"] = np.asarray(problem.observations[0].wavelengths)
    about = {
        "converged": str(chains.converged), "steps": str(chains.steps), "process": str(problem.process),
        "priors": "; ".join(f"{n} ~ {p}" for n, p in zip(problem.free, problem.priors, strict=True)),
        "fixed": "; ".join(f"{n} = {float(v):g}" for n, v in problem.fixed.items()),
        "irisjax": ij.__version__, "says": " | ".join(lines),
    }  # fmt: skip
    io.write_posterior(folder / "posterior.nc", groups, about, observed)
    shown = [n for n in problem.free if kind(n) not in ("gain", "noise")]
    values = reported(problem, chains.z)
    files = {folder / "summary.csv": summary_csv(rows).encode()}
    if len(shown) > 1:
        units = [next(r.unit for r in rows if r.parameter == n) for n in shown]
        figure = plot.corner_figure(
            {f"{n}\n({u})" if u else n: values[n].ravel() for n, u in zip(shown, units, strict=True)}
        )
        files[folder / "corner.png"] = plot.picture(figure, ".png")
    shapes = [(o.name, o.quantity, o.is_colour, np.asarray(o.wavelengths), np.asarray(o.values)) for o in seen]
    fitted = plot.fit_figure(shapes, [np.asarray(s) for s in simulated], [np.asarray(m) for m in models])
    files[folder / "fit.png"] = plot.picture(fitted, ".png")
    io.write_together(files)


def _cautions(problem: Problem, rows: list[Row], tested: Check, chains: Chains) -> list[str]:
    lines = []
    unmoved = [r.parameter for r in rows if r.parameter in problem.free and r.contraction < 0.3]
    if unmoved:
        lines.append(f"the data hardly move {', '.join(unmoved)}: what is shown is mostly the prior")
    if tested.warning:
        lines.append(f"WARNING: {tested.warning}")
    if not chains.converged:
        lines.append(f"NOT CONVERGED: {chains.reason}")
    return lines


def _print(problem: Problem, rows: list[Row], lines: list[str], chains: Chains) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{', '.join(o.name for o in problem.observations)}: posterior", title_justify="left", box=None)
    for name in ("parameter", "unit", "median", "68 %", "95 %", "R-hat", "ESS", "contraction"):
        table.add_column(name, justify="left" if name in ("parameter", "unit") else "right", no_wrap=True)
    for r in rows:
        table.add_row(
            r.parameter, r.unit, f"{r.median:.4g}", f"{r.q16:.3g} to {r.q84:.3g}", f"{r.q2_5:.3g} to {r.q97_5:.3g}",
            f"{r.rhat:.3f}", f"{r.ess_bulk:.0f}", f"{r.contraction:.2f}",
        )  # fmt: skip
    console = Console(width=max(100, Console().width) if not sys.stdout.isatty() else None, highlight=False)
    console.print(table)
    console.print(
        f"{chains.steps} steps, acceptance {chains.acceptance:.2f}, autocorrelation time {chains.tau.max():.0f} steps"
    )
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def _say(line: str, quiet: bool) -> None:
    if not quiet:
        print(f"irisjax: {line}", file=sys.stderr)
