"""`irisjax fit --batch`: a row for each eye, failures listed, resumed where it stopped."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli import options as opt
from irisjax.cli import report
from irisjax.cli.engine import Lost, Workers, each
from irisjax.cli.fit_options import AMORTISED, FitResults, Measurements, Model, Sampler, process_of
from irisjax.cli.flows import flow_for
from irisjax.cli.many import DOUBTFUL, FAILED, OK, EyeRow, EyeTable, csv_of
from irisjax.cli.sentences import of_the_data, preference
from irisjax.infer.amortised import EFFICIENT, read_flow, weighted_draws
from irisjax.infer.draws import of_draws
from irisjax.infer.fit import OFF_PRIOR, Fit, FitStatus, abl_melanin, fit, words_for
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.model_comparison import compare_processes, other_of
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import kind
from irisjax.infer.populations import likelihood_draws, tails
from irisjax.infer.problem import Problem, reported
from irisjax.io.fits import (
    CONVERGED,
    COVARIANCES,
    LIKELIHOOD,
    covariance_rows,
    covariances_beside,
    read_covariances,
)
from irisjax.io.measured import Measured
from irisjax.io.tables import naming, replacing
from irisjax.numerics.chunks import cores
from irisjax.transport.process import option_of

_CHUNK = 64  # eyes a device at a time
_PIECES, _MOST_CHUNKS = 32, 16  # of work for others: many for a fair share, each of a second or so
_FIRST = ("eye", "status", "posterior", "warnings")
_DRAWS = 4096  # of a flow for an eye
_ABL = "abl_melanin", "abl_melanin_sd"
_SUFFIXES = {f".{end}" for end in ("csv", "tsv", "txt", "asc", "dx", "jdx", "jcm", "rxt")} | {
    f".{end}" for end in ("sed", "sig", "trt", "ttt", "xlsx")
}

Eyes = Mapping[str, Measured | ValueError]


def many(
    source: Path,
    measured: Measurements,
    model: Model,
    sampler: Sampler,
    results: FitResults,
    workers: Workers,
) -> int:
    """Fit all eyes of a folder or table, by these options of `irisjax.problem`, into `fits.csv` of
    the folder for results, beside covariances, or print the table; `workers` share the work. The
    exit status: 3 where an eye failed.
    """
    eyes, output, resume = _eyes(source, measured.reading), results.output, results.resume
    if not eyes:
        raise ValueError(f"{source}: no spectra in it")
    if results.posteriors and output is None:
        raise ValueError("--posteriors needs -o FOLDER for what it samples")
    if results.posteriors != AMORTISED and results.flows is not None:
        raise ValueError("--flows means something only with --posteriors amortised")
    target = None if output is None else output / "fits.csv"
    table = EyeTable(tuple(eyes), _FIRST, "eye", target)
    covariances: dict[str, list[EyeRow]] = {}
    if target is not None and target.exists() and results.resume:
        covariances = read_covariances(covariances_beside(target))

    def done(row: EyeRow) -> bool:
        sampled = row["posterior"] == CONVERGED or not results.posteriors
        return sampled and row["eye"] in covariances

    def beside() -> Mapping[Path, bytes]:
        if target is None:
            return {}
        long = [list(r.values()) for n in eyes for r in covariances.get(n, ())]
        return {covariances_beside(target): csv_of([COVARIANCES, *long]).encode()}

    table.begin(results.resume, results.overwrite, done)
    table.beside = beside
    files = [str(p) for p in (measured.bands, measured.covariance) if p is not None]
    # The name begins what is said of all eyes of a chunk.
    left, seen = set(table.left()), {"name": ", ".join(files) or "batch", **measured.seen}

    def options_of(chunk: Eyes) -> dict[str, Any]:
        headers = [m.header for m in chunk.values() if isinstance(m, Measured)]
        return {"noise": measured.noise, **model.stated(headers)}

    with table.progress() as bar:
        # A chunk is fitted whole, so that its numbers are those of a run that never stopped.
        chunks = [(chunk, options_of(chunk)) for chunk in _chunks(eyes) if left & set(chunk)]
        some = min(_MOST_CHUNKS, -(-len(chunks) // _PIECES)) if workers.elsewhere else 1
        pieces = [chunks[i : i + some] for i in range(0, len(chunks), some)]
        fits = {i: (piece, seen, sampler.seed) for i, piece in enumerate(pieces)}
        for i, found in each(_fitted, fits, workers):
            names = [n for chunk, _ in pieces[i] for n in chunk if n in left]
            lost = isinstance(found, Lost)
            rows, more = ({n: _row(n, FAILED, "", found.why) for n in names}, {}) if lost else found
            covariances |= {n: more[n] for n in names if n in more}
            table.add({n: rows[n] for n in names})
            bar.set_description("eyes", refresh=False)
            bar.update(sum(not results.posteriors or rows[n]["status"] == FAILED for n in names))
        if output is not None and results.posteriors:
            fitted = [n for n in eyes if n in left and table.rows[n]["status"] != FAILED]
            sampled = {
                n: (_Eye(n, eyes[n], seen, options_of({n: eyes[n]}), output / n, sampler, resume),)
                for n in fitted
            }
            by: Any = _sampled
            if results.posteriors == AMORTISED:
                by, folder = _weighted, results.flows or output / "flows"
                flows = {
                    n: p for c, o in chunks for n, p in _flows(c, seen, o, folder, sampler, fitted)
                }
                sampled = {n: (*eye, flows[n], table.rows[n]) for n, eye in sampled.items()}
            for n, found in each(by, sampled, workers):
                lost = isinstance(found, Lost)
                changed = {"status": FAILED, "warnings": found.why} if lost else found
                table.add({n: table.rows[n] | changed})
                bar.update()
    return table.conclude()


def _eyes(source: Path, reading: io.ReadOptions) -> Eyes:
    """Spectra by name, or why one cannot be read."""
    if not source.is_dir():
        found = io.read_eyes(source, **reading)
        faults = {n: e for n, e in found.items() if isinstance(e, ValueError)}
        return found | {n: ValueError(f"{source}: {e}") for n, e in faults.items()}
    eyes: dict[str, Measured | ValueError] = {}
    for path in sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES):
        try:
            eyes[path.stem] = io.read_measured(path, **reading)
        except ValueError as error:
            eyes[path.stem] = error
    return eyes


def _chunks(eyes: Eyes) -> Iterator[Eyes]:
    """Eyes on one grid together, so that they share one program."""
    groups: dict[Any, list[str]] = {}
    for name, m in eyes.items():
        of = None if isinstance(m, ValueError) else (
            m.wavelengths.tobytes(), m.sd is None, m.correlated, m.bandwidth,
            process_of([m.header]),
        )  # fmt: skip
        groups.setdefault(of, []).append(name)
    size = _CHUNK * jax.device_count()
    for names in groups.values():
        for first in range(0, len(names), size):
            yield {name: eyes[name] for name in names[first : first + size]}


def _row(*cells: str) -> EyeRow:
    return dict(zip(_FIRST, cells, strict=True))


def _fitted(
    chunks: list[tuple[Eyes, dict[str, Any]]], seen: Mapping[str, Any], seed: int
) -> tuple[dict[str, EyeRow], dict[str, list[EyeRow]]]:
    """Fit eyes; return their rows, and rows of the covariances of those that could be fitted."""
    rows, covariances = {}, {}
    for chunk, options in chunks:
        found, more = _fitted_chunk(chunk, seen, options, opt.key_of(seed))
        rows |= found
        covariances |= more
    return rows, covariances


def _fitted_chunk(
    chunk: Eyes, seen: Mapping[str, Any], options: Mapping[str, Any], key: jax.Array
) -> tuple[dict[str, EyeRow], dict[str, list[EyeRow]]]:
    """Fit eyes that share one grid of wavelengths; returns as `_fitted`."""
    spectra = [m for m in chunk.values() if isinstance(m, Measured)]
    if not spectra:
        return {name: _row(name, FAILED, "", str(fault)) for name, fault in chunk.items()}, {}
    first = spectra[0]
    try:
        with naming(seen["name"]):
            spectrum = ij.spectrum(first, **seen)
        problem = ij.problem(spectrum, **options)
    except ValueError as error:
        return {name: _row(name, FAILED, "", str(error)) for name in chunk}, {}
    devices = jax.device_count()
    full = _CHUNK * devices
    count = full if len(chunk) >= full else -(-len(chunk) // devices) * devices
    padded = spectra + [spectra[-1]] * (count - len(chunk))
    dtype = jnp.result_type(float)
    values, sds = (
        None if getattr(first, n) is None else jnp.asarray([getattr(m, n) for m in padded], dtype)
        for n in ("values", "sd")
    )
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("eyes",))
        place = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("eyes"))
        values, sds = jax.device_put((values, sds), place)
    other = problem.by(other_of(problem.process))
    found, beside = (
        jax.tree.map(np.asarray, _fit_all(p, values, sds, key)) for p in (problem, other)
    )
    names = problem.fitted
    rows, covariances = {}, {}
    for i, (name, measured) in enumerate(zip(chunk, spectra, strict=True)):
        mine, its = (jax.tree.map(lambda x, i=i: x[i], fits) for fits in (found, beside))
        status, said = _judged(problem, mine)
        warnings = [*measured.doubts, *of_the_data(problem), *said]
        compared = compare_processes(problem, mine, other, its)
        if compared.preferred:
            warnings.append(preference(compared))
        if warnings and status == OK:
            status = DOUBTFUL
        numbers = [(c, of[n]) for n in names for c, of in ((n, mine.values), (f"{n}_sd", mine.sd))]
        covariance = _covariance(problem, mine, names)
        priors = dict(zip(problem.free, problem.priors, strict=True))
        covariances[name] = covariance_rows(name, {n: priors[n] for n in names}, covariance)
        both = abl_melanin(names, np.array([mine.values[n] for n in names]), covariance)
        abl = [] if both is None else [*zip(_ABL, map(float, both), strict=True)]
        rows[name] = {
            **_row(name, status, "", "; ".join(warnings)),
            **{column: f"{x:.6g}" for column, x in [*numbers, *abl]},
            "chi_square": f"{mine.chi_square:.6g}",
            "degrees": str(mine.degrees),
            "p_value": f"{mine.p_value:.3g}",
            "process": option_of(problem.process),
            "other_process": option_of(compared.process),
            "log_odds_other": f"{compared.log_odds:.4g}",
            "differs": " ".join(n for n, m in compared.moved.items() if m.differs),
            **{f"other_{n}": f"{m.other.value:.6g}" for n, m in compared.moved.items()},
            "notes": "; ".join(measured.notes),
        }
    return rows, covariances


@eqx.filter_jit
def _fit_all(problem: Problem, values, sds, key):
    o = problem.observations[0]

    def one(v, sd):
        # Costs agree within 1e-9 with those of a search to 1e-8, in half the steps.
        mine = problem.with_observations(with_values(o, v, sd))
        return fit(mine, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, key=key)

    return eqx.filter_vmap(one, in_axes=(0, None if sds is None else 0))(values, sds)


def _covariance(problem: Problem, found: Fit, names: list[str]) -> np.ndarray:
    """Covariance of the values of parameters, to first order."""
    places = [problem.free.index(n) for n in names]
    covariance = found.covariance[np.ix_(places, places)]
    # Derivatives by z: a value rises with its own coordinate.
    slopes = np.array([found.sd[n] for n in names]) / np.sqrt(np.diag(covariance))
    return slopes[:, None] * covariance * slopes


def _judged(problem: Problem, found: Fit) -> tuple[str, list[str]]:
    """Status of a fit, and its warnings."""
    said = [words_for(found.status)] if words_for(found.status) else []
    if found.status == FitStatus.not_converged or found.status == FitStatus.solver_failed:
        return FAILED, said
    for name, z in zip(problem.free, found.z, strict=True):
        if abs(z) > OFF_PRIOR:
            value = float(found.values[name])
            said.append(f"{name} = {value:.3g} is {abs(z):.0f} standard deviations off its prior")
    return (DOUBTFUL if said else OK), said


class _Eye(NamedTuple):
    """An eye and how its posterior is sampled, in any process."""

    name: str
    measured: Any
    seen: Mapping[str, Any]
    options: Mapping[str, Any]
    folder: Path
    sampler: Sampler
    resume: bool

    def problem(self) -> Problem:
        spectrum = ij.spectrum(self.measured, **{**self.seen, "name": self.name})
        return ij.problem(spectrum, **self.options)


def _flows(
    chunk: Eyes,
    seen: Mapping[str, Any],
    options: Mapping[str, Any],
    folder: Path,
    sampler: Sampler,
    fitted: Sequence[str],
) -> Iterator[tuple[str, Path]]:
    """Find or train the file of the flow for each of some eyes on one grid."""
    eyes = {n: m for n, m in chunk.items() if n in fitted and isinstance(m, Measured)}
    if not eyes:
        return
    first = next(iter(eyes.values()))
    problem = ij.problem(ij.spectrum(first, **seen), **options)
    if problem.observations[0].sd is not None:
        # A flow for the noise that the files state, in steps of two so that others may use it.
        noise = problem.noise
        stated = [np.hypot(noise.relative * m.values, noise.absolute) for m in eyes.values()]
        times = np.array([m.sd for m in eyes.values()]) / np.array(stated)
        level = 2.0 ** np.round(np.log2(np.median(times)))
        noise = dataclasses.replace(
            noise, relative=noise.relative * level, absolute=noise.absolute * level
        )
        problem = dataclasses.replace(problem, noise=noise)
    with ThreadPoolExecutor(cores()) as pool:
        path = flow_for(problem, folder, sampler.seed, pool.map)
    for name in eyes:
        yield name, path


def _weighted(eye: _Eye, path: Path, row: EyeRow) -> EyeRow:
    """Draw the posterior of an eye by a flow and return the changed cells of its row."""
    problem, folder, key = eye.problem(), eye.folder, eye.sampler.key
    (o,), found = problem.observations, fit(problem, key=key)
    values, z, covariance = (np.asarray(x)[None] for x in (o.values, found.z, found.covariance))
    sd = None if o.sd is None else np.asarray(o.sd)[None]
    weighted = weighted_draws(
        read_flow(path, problem), problem, values, z, covariance, sd, draws=_DRAWS, key=key
    )
    unusual, (share,) = bool(weighted.unusual[0]), weighted.efficiency
    changed = {"efficiency": f"{share:.3g}", "out_of_distribution": "yes" if unusual else "no"}
    if unusual:
        said = "the model's own spectra do not look like this one"
        changed |= {
            "status": DOUBTFUL,
            "warnings": "; ".join(filter(None, (row["warnings"], said))),
        }
    if share < EFFICIENT:
        return changed | _sampled(eye)
    folder.mkdir(parents=True, exist_ok=True)
    draws = weighted.equal(0, _DRAWS // 2, key=key)
    says = f"draws of a flow weighted by the likelihood, {100 * share:.0f} in 100 effective"
    report.write_groups(folder, problem, of_draws(problem, draws), [says], key)
    for n, x in reported(problem, draws).items():
        ends = zip(("q2.5", "q50", "q97.5"), np.percentile(x, (2.5, 50, 97.5)), strict=True)
        changed |= {f"{n}_{end}": f"{value:.6g}" for end, value in ends}
    return changed | {"posterior": CONVERGED}


def _sampled(eye: _Eye) -> EyeRow:
    """Sample the posterior of an eye and return the changed cells of its row."""
    problem, folder, sampler = eye.problem(), eye.folder, eye.sampler
    folder.mkdir(parents=True, exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not eye.resume:
        chain.unlink()
    try:
        bar = report.progress_bar(True)
        if report.one(problem, folder, sampler, bar, resume=chain.exists(), quiet=True):
            _draw_likelihood(problem, folder, sampler.key)
            return {"posterior": CONVERGED}
        posterior, warning = "not long enough", "the chain is not long enough"
    except ValueError as error:
        posterior, warning = "", str(error)
    return {"status": FAILED, "posterior": posterior, "warnings": f"{folder}: {warning}"}


def _draw_likelihood(problem: Problem, folder: Path, key: jax.Array) -> None:
    """Write what `irisjax compare-groups` needs of an eye."""
    names = [n for n in problem.fitted if kind(n) not in ("gain", "noise")]
    starts = tails(problem, np.asarray(fit(problem, key=key).z), names)
    draws = likelihood_draws(problem, starts, names, key=key)
    with replacing(folder / LIKELIHOOD) as path, path.open("wb") as file:
        np.savez(file, **dict(zip(names, draws.T, strict=True)))
