"""`irisjax fit --batch`: a row an eye, failures listed, resumed at the eye where it stopped."""

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
from irisjax.infer.fit import fit
from irisjax.infer.observation import with_values
from irisjax.infer.problem import Problem
from irisjax.infer.search import levenberg_marquardt
from irisjax.infer.status import FitStatus, says

_CHUNK = 64  # eyes a device at a time


class Eye(NamedTuple):
    """A spectrum of a batch by name, or why it cannot be read."""

    name: str
    measured: io.Measured | None
    fault: str


def many(
    source: Path,
    output: Path | None,
    seen,
    options,
    sampler,
    posteriors: bool,
    resume: bool,
    overwrite: bool,
) -> int:
    """Fit all eyes of a folder or table into `output`/fits.csv; returns the exit status."""
    from tqdm import tqdm

    eyes = list(_eyes(source))
    if not eyes:
        raise ValueError(f"{source}: no spectra in it")
    if posteriors and output is None:
        raise ValueError("--posteriors needs -o FOLDER for what it samples")
    target = None if output is None else output / "fits.csv"
    done: dict[str, list[str]] = {}
    if target is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not (resume or overwrite):
            raise ValueError(f"{target}: exists; --resume goes on with it, --overwrite begins anew")
        if target.exists() and resume:
            done = _rows(target, "converged" if posteriors else "ok")
    columns: list[str] = []
    rows: dict[str, list[str]] = dict(done)
    with tqdm(
        desc="compiling",
        total=len(eyes),
        initial=len(done),
        unit="eye",
        disable=not sys.stderr.isatty(),
    ) as bar:
        for chunk in _chunks([e for e in eyes if e.name not in done]):
            named, found = _fitted(chunk, seen, options, sampler["seed"])
            columns = named or columns
            for eye, row in zip(chunk, found, strict=True):
                if posteriors and eye.measured is not None:
                    row[1] = (
                        _sampled(eye, output, seen, options, sampler, resume)
                        if row[1] in ("ok", "misfit")
                        else row[1]
                    )
                rows[eye.name] = row
            if target is not None:  # each chunk whole: a killed run loses the one it was in
                io.write_atomically(target, _table(columns, rows, eyes).encode())
            bar.set_description("eyes", refresh=False)
            bar.update(len(chunk))
    if target is None:
        sys.stdout.write(_table(columns, rows, eyes))
    elif not columns:
        columns = next(csv.reader(target.read_text(encoding="utf-8").splitlines()))[2:]
    failed = [e.name for e in eyes if rows[e.name][1] not in ("ok", "misfit", "converged")]
    if failed:
        print(
            f"irisjax: {len(failed)} of {len(eyes)} eyes failed: {', '.join(failed[:8])}",
            file=sys.stderr,
        )
    return 3 if failed else 0


def _eyes(source: Path) -> Iterator[Eye]:
    if source.is_dir():
        for path in sorted(
            p
            for p in source.iterdir()
            if p.suffix.lower() in (".csv", ".tsv", ".txt", ".dx", ".jdx")
        ):
            try:
                yield Eye(path.stem, io.read_measured(path), "")
            except ValueError as error:
                yield Eye(path.stem, None, str(error))
        return
    table = io.read_table(source)
    names = list(table.columns)
    for name in names[1:]:
        values, grid = table.columns[name], table.columns[names[0]]
        if np.isfinite(values).all():
            yield Eye(name, io.Measured(grid, values, None, (), {}), "")
        else:
            yield Eye(
                name,
                None,
                f"the value at {grid[~np.isfinite(values)][0]:g} nm is not a finite number",
            )


def _chunks(eyes: list[Eye]) -> Iterator[list[Eye]]:
    """Eyes on one grid together, so that one program serves them."""
    groups: dict[Any, list[Eye]] = {}
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
    chunk: list[Eye], seen: Mapping[str, Any], options, seed: int
) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of a chunk."""
    if chunk[0].measured is None:
        return [], [[e.name, f"failed: {e.fault}"] for e in chunk]
    first = chunk[0].measured
    try:
        problem = ij.problem(ij.spectrum(first, name="batch", **seen), **options)
    except ValueError as error:
        return [], [[e.name, f"failed: {error}"] for e in chunk]
    devices = jax.device_count()
    count = (
        -(-len(chunk) // devices) * devices if len(chunk) < _CHUNK * devices else _CHUNK * devices
    )
    padded = [*chunk, *[chunk[-1]] * (count - len(chunk))]
    dtype = jnp.result_type(float)
    values = jnp.asarray(
        np.stack([np.asarray(e.measured.values) for e in padded if e.measured is not None]), dtype
    )
    sds = None
    if first.sd is not None:
        sds = jnp.asarray(
            np.stack([np.asarray(e.measured.sd) for e in padded if e.measured is not None]), dtype
        )
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("eyes",))
        place = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("eyes"))
        values = jax.device_put(values, place)
        sds = None if sds is None else jax.device_put(sds, place)
    found = _fit_all(problem, values, sds, jax.random.key(seed, impl="threefry2x32"))
    names = [n for n in problem.free if not n.startswith("noise")]
    columns = [c for n in names for c in (n, f"{n}_sd")] + ["chi_square", "degrees"]
    rows = []
    for i, eye in enumerate(chunk):
        numbers = [float(np.asarray(x)[i]) for n in names for x in (found.values[n], found.sd[n])]
        row = [eye.name, _word(found.status, i)]
        rows.append(
            [
                *row,
                *(f"{x:.6g}" for x in (*numbers, float(found.chi_square[i]))),
                str(found.degrees),
            ]
        )
    return columns, rows


@eqx.filter_jit
def _fit_all(problem: Problem, values, sds, key):
    o = problem.observations[0]

    def one(v, sd):
        # Costs agree with those of a search to 1e-8 within 1e-9; it takes half the steps.
        mine = problem.with_observations(with_values(o, v, sd))
        return fit(mine, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, key=key)

    return eqx.filter_vmap(one, in_axes=(0, None if sds is None else 0))(values, sds)


def _word(statuses: FitStatus, i: int) -> str:
    """What row i says: that data and model do not fit is no failure of the search."""
    status = jax.tree.map(lambda codes: np.asarray(codes)[i], statuses)
    if status == FitStatus.misfit:
        return "misfit"
    return f"failed: {says(status)}" if says(status) else "ok"


def _sampled(eye: Eye, output: Path | None, seen, options, sampler, resume: bool) -> str:
    assert output is not None
    assert eye.measured is not None
    folder = output / eye.name
    folder.mkdir(exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not resume:
        chain.unlink()
    problem = ij.problem(ij.spectrum(eye.measured, name=eye.name, **seen), **options)
    try:
        good = report.one(
            problem,
            folder,
            sampler,
            report.progress_bar(True),
            resume=chain.exists(),
            files=True,
            quiet=True,
        )
    except ValueError as error:
        return f"failed: {error}"
    return "converged" if good else "failed: the chain is not long enough"


def _rows(path: Path, good: str) -> dict[str, list[str]]:
    lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    # Failures are tried again.
    kept = ("ok", "misfit", "converged") if good == "ok" else ("converged",)
    return {row[0]: row for row in lines[1:] if row[1] in kept}


def _table(columns: list[str], rows: Mapping[str, list[str]], eyes: list[Eye]) -> str:
    import io as text_io

    out = text_io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["eye", "status", *columns])
    writer.writerows(rows[e.name] for e in eyes if e.name in rows)
    return out.getvalue()
