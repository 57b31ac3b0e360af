"""`irisjax fit --batch`: a row for each eye, failures listed, resumed where it stopped."""

import csv
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli import report
from irisjax.cli.fit_options import FitResults, Measurements, Sampler
from irisjax.cli.options import tell
from irisjax.cli.sentences import preference
from irisjax.infer.fit import Fit, FitStatus, fit, words_for
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.model_comparison import COMPARED, compare_processes, other_of
from irisjax.infer.observation import with_values
from irisjax.infer.problem import Problem
from irisjax.io.measured import Measured
from irisjax.transport.process import option_of

_CHUNK = 64  # eyes a device at a time
OK, DOUBTFUL, FAILED = "ok", "doubtful", "failed"
"""An eye is doubtful where the model does not produce its data, searches disagree, or a value lies
far outside its prior; it failed where there is no valid result."""
_FIRST = ("eye", "status", "posterior", "warnings")
_CONVERGED, _SHORT = "converged", "not long enough"
_SUFFIXES = (".csv", ".tsv", ".txt", ".dx", ".jdx")
_FAR = 4.0  # standard deviations of a prior

Eyes = Mapping[str, Measured | ValueError]
Rows = dict[str, list[str]]


def many(
    source: Path,
    measured: Measurements,
    options: Mapping[str, Any],
    sampler: Sampler,
    results: FitResults,
) -> int:
    """Fit all eyes of a folder or table, by these options of `irisjax.problem`, into `fits.csv` of
    the folder for results, or print the table. The exit status: 3 where an eye failed.
    """
    from tqdm import tqdm

    eyes, output = _eyes(source, measured.reading), results.output
    if not eyes:
        raise ValueError(f"{source}: no spectra in it")
    if results.posteriors and output is None:
        raise ValueError("--posteriors needs -o FOLDER for what it samples")
    target = None if output is None else output / "fits.csv"
    columns: list[str] = []
    rows: Rows = {}
    if target is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not (results.resume or results.overwrite):
            raise ValueError(f"{target}: exists; --resume continues it, --overwrite starts again")
        if target.exists() and results.resume:
            columns, rows = _read(target, results.posteriors)
    left = {name: eye for name, eye in eyes.items() if name not in rows}
    how: dict[str, Any] = {"total": len(eyes), "initial": len(rows), "unit": "eye"}
    with tqdm(desc="compiling", disable=not sys.stderr.isatty(), **how) as bar:
        for chunk in _chunks(left):
            named, found = _fitted(chunk, measured.seen, options, sampler.key)
            columns = named or columns
            for name, row in found.items():
                if output is not None and results.posteriors and row[1] != FAILED:
                    seen = ij.spectrum(chunk[name], name=name, **measured.seen)
                    problem = ij.problem(seen, **options)
                    row[1:4] = _sampled(row, problem, output / name, sampler, results.resume)
            rows |= found
            if target is not None:  # each chunk whole: a killed run loses the one it was in
                io.write_atomically(target, _table(columns, rows, eyes).encode())
            bar.set_description("eyes", refresh=False)
            bar.update(len(chunk))
    if target is None:
        sys.stdout.write(_table(columns, rows, eyes))
    for status, verb in ((FAILED, "failed"), (DOUBTFUL, "are doubtful")):
        names = [name for name in eyes if rows[name][1] == status]
        if names:
            some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            tell(f"{len(names)} of {len(eyes)} eyes {verb}: {some}; the column warnings says why")
    return 3 if any(rows[name][1] == FAILED for name in eyes) else 0


def _eyes(source: Path, reading: io.ReadOptions) -> Eyes:
    """Spectra by name, or why one cannot be read."""
    if not source.is_dir():
        found = io.read_eyes(source, reading)
        faults = {n: e for n, e in found.items() if isinstance(e, ValueError)}
        return found | {n: ValueError(f"{source}: {e}") for n, e in faults.items()}
    eyes: dict[str, Measured | ValueError] = {}
    for path in sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES):
        try:
            eyes[path.stem] = io.read_measured(path, **reading._asdict())
        except ValueError as error:
            eyes[path.stem] = error
    return eyes


def _chunks(eyes: Eyes) -> Iterator[Eyes]:
    """Eyes on one grid together, so that they share one program."""
    groups: dict[Any, list[str]] = {}
    for name, m in eyes.items():
        of = None if isinstance(m, ValueError) else (m.wavelengths.tobytes(), m.sd is None)
        groups.setdefault(of, []).append(name)
    size = _CHUNK * jax.device_count()
    for names in groups.values():
        for first in range(0, len(names), size):
            yield {name: eyes[name] for name in names[first : first + size]}


def _fitted(
    chunk: Eyes, seen: Mapping[str, Any], options: Mapping[str, Any], key: jax.Array
) -> tuple[list[str], Rows]:
    """Columns and rows of a chunk."""
    spectra = [m for m in chunk.values() if isinstance(m, Measured)]
    if not spectra:
        return [], {name: [name, FAILED, "", str(fault)] for name, fault in chunk.items()}
    first = spectra[0]
    try:
        problem = ij.problem(ij.spectrum(first, name="batch", **seen), **options)
    except ValueError as error:
        return [], {name: [name, FAILED, "", str(error)] for name in chunk}
    devices = jax.device_count()
    full = _CHUNK * devices
    count = full if len(chunk) >= full else -(-len(chunk) // devices) * devices
    padded = spectra + [spectra[-1]] * (count - len(chunk))
    dtype = jnp.result_type(float)
    values = jnp.asarray(np.stack([m.values for m in padded]), dtype)
    sds = (
        None
        if first.sd is None
        else jnp.asarray(np.stack([np.asarray(m.sd) for m in padded]), dtype)
    )
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("eyes",))
        place = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("eyes"))
        values, sds = jax.device_put((values, sds), place)
    other = problem.by(other_of(problem.process))
    found, beside = (
        jax.tree.map(np.asarray, _fit_all(p, values, sds, key)) for p in (problem, other)
    )
    names = [n for n in problem.free if not n.startswith("noise")]
    columns = [c for n in names for c in (n, f"{n}_sd")]
    columns += ["chi_square", "degrees", "p_value", "process"]
    columns += ["other_process", "log_odds_other", "differs"]
    columns += [*(f"other_{n}" for n in names if n in COMPARED), "notes"]
    rows = {}
    for i, (name, measured) in enumerate(zip(chunk, spectra, strict=True)):
        mine, its = (jax.tree.map(lambda x, i=i: x[i], fits) for fits in (found, beside))
        status, said = _judged(problem, mine)
        warnings = [*measured.doubts, *said]
        compared = compare_processes(problem, mine, other, its)
        if compared.preferred:
            warnings.append(preference(compared))
        if warnings and status == OK:
            status = DOUBTFUL
        numbers = [float(x) for n in names for x in (mine.values[n], mine.sd[n])]
        rows[name] = [
            *(name, status, "", "; ".join(warnings), *(f"{x:.6g}" for x in numbers)),
            *(f"{mine.chi_square:.6g}", str(mine.degrees), f"{mine.p_value:.3g}"),
            *(option_of(p) for p in (problem.process, compared.process)),
            f"{compared.log_odds:.4g}",
            " ".join(n for n, m in compared.moved.items() if m.differs),
            *(f"{m.other.value:.6g}" for m in compared.moved.values()),
            "; ".join(measured.notes),
        ]
    return columns, rows


@eqx.filter_jit
def _fit_all(problem: Problem, values, sds, key):
    o = problem.observations[0]

    def one(v, sd):
        # Costs agree within 1e-9 with those of a search to 1e-8, in half the steps.
        mine = problem.with_observations(with_values(o, v, sd))
        return fit(mine, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, key=key)

    return eqx.filter_vmap(one, in_axes=(0, None if sds is None else 0))(values, sds)


def _judged(problem: Problem, found: Fit) -> tuple[str, list[str]]:
    """Status of a fit, and its warnings."""
    said = [words_for(found.status)] if words_for(found.status) else []
    if found.status == FitStatus.not_converged or found.status == FitStatus.solver_failed:
        return FAILED, said
    for name, z in zip(problem.free, found.z, strict=True):
        if abs(z) > _FAR:
            value = float(found.values[name])
            said.append(f"{name} = {value:.3g} is {abs(z):.0f} standard deviations off its prior")
    return (DOUBTFUL if said else OK), said


def _sampled(
    row: list[str], problem: Problem, folder: Path, sampler: Sampler, resume: bool
) -> list[str]:
    """Sample the posterior of an eye; its row from the status to the warnings."""
    folder.mkdir(exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not resume:
        chain.unlink()
    try:
        bar = report.progress_bar(True)
        good = report.one(problem, folder, sampler, bar, resume=chain.exists(), quiet=True)
    except ValueError as error:
        return [FAILED, "", f"{folder}: {error}"]
    if good:
        return [row[1], _CONVERGED, row[3]]
    return [FAILED, _SHORT, f"{folder}: the chain is not long enough"]


def _read(path: Path, posteriors: bool) -> tuple[list[str], Rows]:
    """Columns of a table, and rows of eyes that are done; those that failed are tried again."""
    first, *lines = csv.reader(path.read_text(encoding="utf-8").splitlines())
    if tuple(first[: len(_FIRST)]) != _FIRST:
        raise ValueError(f"{path}: is no table of --batch; --overwrite starts again")
    done = (r for r in lines if r[1] != FAILED and (r[2] == _CONVERGED or not posteriors))
    return first[len(_FIRST) :], {row[0]: row for row in done}


def _table(columns: list[str], rows: Rows, eyes: Iterable[str]) -> str:
    return report.csv_of([[*_FIRST, *columns], *(rows[name] for name in eyes if name in rows)])
