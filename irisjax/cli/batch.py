"""`irisjax fit --batch`: a row for each eye, failures listed, resumed where it stopped."""

import csv
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli import report
from irisjax.cli.sentences import preference
from irisjax.infer.fit import Fit, FitStatus, fit, words_for
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import COMPARED, compare_processes, other_of
from irisjax.infer.problem import Problem
from irisjax.transport.process import option_of

_CHUNK = 64  # eyes a device at a time
OK, DOUBTFUL, FAILED = "ok", "doubtful", "failed"
"""An eye is doubtful where the model does not produce its data, searches disagree, or a value lies
far outside its prior; it failed where there is no valid result."""
_FIRST = ("eye", "status", "posterior")
_CONVERGED, _SHORT = "converged", "not long enough"
_SUFFIXES = (".csv", ".tsv", ".txt", ".dx", ".jdx")
_FAR = 4.0  # standard deviations of a prior


class _Eye(NamedTuple):
    """A spectrum of a batch.

    Attributes:
        name: Its name.
        measured: The spectrum, or `None` where it cannot be read.
        fault: Why it cannot be read, or an empty string.
    """

    name: str
    measured: io.Measured | None
    fault: str


def many(
    source: Path,
    output: Path | None,
    reading: io.ReadOptions,
    seen: Mapping[str, Any],
    options: Mapping[str, Any],
    sampler: Mapping[str, Any],
    posteriors: bool,
    resume: bool,
    overwrite: bool,
) -> int:
    """Fit all eyes of a folder or table into `output`/fits.csv, or print the table.

    Args:
        source: A folder of spectra, or a CSV with a column for each eye.
        output: The folder for results, if any.
        reading: How the files are read.
        seen: Options of `irisjax.spectrum`.
        options: Options of `irisjax.problem`.
        sampler: Walkers, max_steps and seed.
        posteriors: Whether every eye is sampled and not only fitted.
        resume: Whether to continue a table.
        overwrite: Whether to replace a table.

    Returns:
        The exit status: 3 where an eye failed.
    """
    from tqdm import tqdm

    eyes = list(_eyes(source, reading))
    if not eyes:
        raise ValueError(f"{source}: no spectra in it")
    if posteriors and output is None:
        raise ValueError("--posteriors needs -o FOLDER for what it samples")
    target = None if output is None else output / "fits.csv"
    done: dict[str, list[str]] = {}
    if target is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not (resume or overwrite):
            raise ValueError(f"{target}: exists; --resume continues it, --overwrite starts again")
        if target.exists() and resume:
            done = _rows(target, posteriors)
    columns: list[str] = []
    rows: dict[str, list[str]] = dict(done)
    quiet = not sys.stderr.isatty()
    with tqdm(
        desc="compiling", total=len(eyes), initial=len(done), unit="eye", disable=quiet
    ) as bar:
        for chunk in _chunks([e for e in eyes if e.name not in done]):
            named, found = _fitted(chunk, seen, options, sampler["seed"])
            columns = named or columns
            for eye, row in zip(chunk, found, strict=True):
                if posteriors and row[1] != FAILED:
                    row[1:] = _sampled(row[1:], eye, output, seen, options, sampler, resume)
                rows[eye.name] = row
            if target is not None:  # each chunk whole: a killed run loses the one it was in
                io.write_atomically(target, _table(columns, rows, eyes).encode())
            bar.set_description("eyes", refresh=False)
            bar.update(len(chunk))
    if target is None:
        sys.stdout.write(_table(columns, rows, eyes))
    elif not columns:
        columns = next(csv.reader(target.read_text(encoding="utf-8").splitlines()))[len(_FIRST) :]
    for status, verb in ((FAILED, "failed"), (DOUBTFUL, "are doubtful")):
        names = [e.name for e in eyes if rows[e.name][1] == status]
        if names:
            some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            print(
                f"irisjax: {len(names)} of {len(eyes)} eyes {verb}: {some}; the column warnings "
                f"says why",
                file=sys.stderr,
            )
    return 3 if any(rows[e.name][1] == FAILED for e in eyes) else 0


def _eyes(source: Path, reading: io.ReadOptions) -> Iterator[_Eye]:
    if source.is_dir():
        for path in sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES):
            try:
                yield _Eye(path.stem, io.read_measured(path, **reading._asdict()), "")
            except ValueError as error:
                yield _Eye(path.stem, None, str(error))
        return
    for name, found in io.read_eyes(source, reading).items():
        if isinstance(found, ValueError):
            yield _Eye(name, None, f"{source}: {found}")
        else:
            yield _Eye(name, found, "")


def _chunks(eyes: list[_Eye]) -> Iterator[list[_Eye]]:
    """Eyes on one grid together, so that they share one program."""
    groups: dict[Any, list[_Eye]] = {}
    for eye in eyes:
        m = eye.measured
        groups.setdefault(
            None if m is None else (m.wavelengths.tobytes(), m.sd is None), []
        ).append(eye)
    size = _CHUNK * jax.device_count()
    for group in groups.values():
        for first in range(0, len(group), size):
            yield group[first : first + size]


def _fitted(
    chunk: list[_Eye], seen: Mapping[str, Any], options: Mapping[str, Any], seed: int
) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of a chunk."""
    if chunk[0].measured is None:
        return [], [_failed(e, e.fault) for e in chunk]
    first = chunk[0].measured
    try:
        problem = ij.problem(ij.spectrum(first, name="batch", **seen), **options)
    except ValueError as error:
        return [], [_failed(e, str(error)) for e in chunk]
    devices = jax.device_count()
    full = _CHUNK * devices
    count = full if len(chunk) >= full else -(-len(chunk) // devices) * devices
    measured = [e.measured for e in (*chunk, *[chunk[-1]] * (count - len(chunk))) if e.measured]
    dtype = jnp.result_type(float)
    values = jnp.asarray(np.stack([np.asarray(m.values) for m in measured]), dtype)
    sds = None
    if first.sd is not None:
        sds = jnp.asarray(np.stack([np.asarray(m.sd) for m in measured]), dtype)
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("eyes",))
        place = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("eyes"))
        values, sds = jax.device_put((values, sds), place)
    key = jax.random.key(seed, impl="threefry2x32")
    other = problem.by(other_of(problem.process))
    found, beside = (_fit_all(p, values, sds, key) for p in (problem, other))
    names = [n for n in problem.free if not n.startswith("noise")]
    columns = ["warnings", *(c for n in names for c in (n, f"{n}_sd"))]
    columns += ["chi_square", "degrees", "p_value", "process"]
    columns += ["other_process", "log_odds_other", "differs"]
    columns += [*(f"other_{n}" for n in names if n in COMPARED), "notes"]
    rows = []
    for i, eye in enumerate(chunk):
        assert eye.measured is not None
        status, said = _judged(problem, found, i)
        warnings = [*eye.measured.doubts, *said]
        compared = compare_processes(problem, _of(found, i), other, _of(beside, i))
        if compared.preferred:
            warnings.append(preference(compared))
        if warnings and status == OK:
            status = DOUBTFUL
        numbers = [float(np.asarray(x)[i]) for n in names for x in (found.values[n], found.sd[n])]
        last = f"{float(found.chi_square[i]):.6g}", str(found.degrees)
        rows.append(
            [
                *(eye.name, status, "", "; ".join(warnings), *(f"{x:.6g}" for x in numbers)),
                *(*last, f"{float(found.p_value[i]):.3g}", option_of(problem.process)),
                *(option_of(compared.process), f"{compared.log_odds:.4g}"),
                " ".join(n for n, m in compared.moved.items() if m.differs),
                *(f"{m.other.value:.6g}" for m in compared.moved.values()),
                "; ".join(eye.measured.notes),
            ]
        )
    return columns, rows


def _failed(eye: _Eye, fault: str) -> list[str]:
    return [eye.name, FAILED, "", fault]


@eqx.filter_jit
def _fit_all(problem: Problem, values, sds, key):
    o = problem.observations[0]

    def one(v, sd):
        # Costs agree within 1e-9 with those of a search to 1e-8, in half the steps.
        mine = problem.with_observations(with_values(o, v, sd))
        return fit(mine, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, key=key)

    return eqx.filter_vmap(one, in_axes=(0, None if sds is None else 0))(values, sds)


def _of(found: Fit, i: int) -> Fit:
    """Fit i of many."""
    return jax.tree.map(lambda x: np.asarray(x)[i], found)


def _judged(problem: Problem, found, i: int) -> tuple[str, list[str]]:
    """Status of fit i, and its warnings."""
    status = jax.tree.map(lambda codes: np.asarray(codes)[i], found.status)
    said = [words_for(status)] if words_for(status) else []
    if status == FitStatus.not_converged or status == FitStatus.solver_failed:
        return FAILED, said
    for name, z in zip(problem.free, np.asarray(found.z)[i], strict=True):
        if abs(z) > _FAR:
            value = float(np.asarray(found.values[name])[i])
            said.append(f"{name} = {value:.3g} is {abs(z):.0f} standard deviations off its prior")
    return (DOUBTFUL if said else OK), said


def _sampled(
    row: list[str],
    eye: _Eye,
    output: Path | None,
    seen: Mapping[str, Any],
    options: Mapping[str, Any],
    sampler: Mapping[str, Any],
    resume: bool,
) -> list[str]:
    """Sample the posterior of an eye; its row from the status on."""
    assert output is not None
    assert eye.measured is not None
    status, _, warnings, *numbers = row
    folder = output / eye.name
    folder.mkdir(exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not resume:
        chain.unlink()
    problem = ij.problem(ij.spectrum(eye.measured, name=eye.name, **seen), **options)
    try:
        bar = report.progress_bar(True)
        good = report.one(problem, folder, sampler, bar, resume=chain.exists(), quiet=True)
    except ValueError as error:
        return [FAILED, "", f"{folder}: {error}", *numbers]
    if good:
        return [status, _CONVERGED, warnings, *numbers]
    return [FAILED, _SHORT, f"{folder}: the chain is not long enough", *numbers]


def _rows(path: Path, posteriors: bool) -> dict[str, list[str]]:
    """Rows of eyes that are done; those that failed are tried again."""
    lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    if tuple(lines[0][: len(_FIRST)]) != _FIRST:
        raise ValueError(f"{path}: is no table of --batch; --overwrite starts again")
    return {
        row[0]: row
        for row in lines[1:]
        if row[1] != FAILED and (row[2] == _CONVERGED or not posteriors)
    }


def _table(columns: list[str], rows: Mapping[str, list[str]], eyes: list[_Eye]) -> str:
    return report.csv_of([[*_FIRST, *columns], *(rows[e.name] for e in eyes if e.name in rows)])
