"""`irisjax fit --batch`: a table with a row for each eye, which can be resumed."""

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
from irisjax.cli import report
from irisjax.cli.engine import LostPiece, Workers, run_pieces
from irisjax.cli.fit_options import AMORTISED, FitResults, Measurements, Model, Sampler, process_of
from irisjax.cli.flows import flow_for
from irisjax.cli.many import DOUBTFUL, FAILED, OK, EyeRow, EyeTable
from irisjax.cli.sentences import data_warnings, preference
from irisjax.infer.amortised import EFFICIENT, read_flow, weighted_draws
from irisjax.infer.draws import of_draws
from irisjax.infer.fit import OFF_PRIOR, Fit, FitStatus, abl_melanin, fit, words_for
from irisjax.infer.least_squares import levenberg_marquardt
from irisjax.infer.model_comparison import compare_processes, other_of
from irisjax.infer.observation import Observation, with_values
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
from irisjax.io.tables import csv_of, naming, replacing
from irisjax.numerics.chunks import cores
from irisjax.numerics.streams import key_of
from irisjax.transport.process import option_of

_CHUNK = 64  # eyes that a device fits at a time
# Pieces of work for other processes, at least, for a fair share; and chunks of a piece, at most.
_PIECES, _MOST_CHUNKS = 32, 16
_FIRST_COLUMNS = ("eye", "status", "posterior", "warnings")
_DRAWS = 4096  # number of draws of a flow for an eye
_ABL = "abl_melanin", "abl_melanin_sd"
_SUFFIXES = {f".{end}" for end in ("csv", "tsv", "txt", "asc", "dx", "jdx", "jcm", "rxt")} | {
    f".{end}" for end in ("sed", "sig", "trt", "ttt", "xlsx")
}

Eyes = Mapping[str, Measured | ValueError]


def fit_many(
    source: Path,
    measured: Measurements,
    model: Model,
    sampler: Sampler,
    results: FitResults,
    workers: Workers,
) -> int:
    """Fit all eyes of a folder or table, and write `fits.csv` and covariances into the folder for
    results, or print the table; `workers` share the work. Return the exit status, 3 if an eye
    failed.
    """
    eyes = _read_eyes(source, measured.reading_options)
    output = results.output
    if not eyes:
        raise ValueError(f"{source}: no spectra in it")
    if results.posteriors and output is None:
        raise ValueError("--posteriors needs -o FOLDER for what it samples")
    if results.posteriors != AMORTISED and results.flows is not None:
        raise ValueError("--flows means something only with --posteriors amortised")
    target = None if output is None else output / "fits.csv"
    table = EyeTable(tuple(eyes), _FIRST_COLUMNS, "eye", target)
    covariances: dict[str, list[EyeRow]] = {}
    if target is not None and target.exists() and results.resume:
        covariances = read_covariances(covariances_beside(target))

    def is_done(row: EyeRow) -> bool:
        sampled = row["posterior"] == CONVERGED or not results.posteriors
        return sampled and row["eye"] in covariances

    def covariance_files() -> Mapping[Path, bytes]:
        if target is None:
            return {}
        table_rows = [list(r.values()) for name in table.order for r in covariances.get(name, ())]
        return {covariances_beside(target): csv_of([COVARIANCES, *table_rows]).encode()}

    table.begin(results.resume, results.overwrite)
    table.redo(is_done)
    table.beside = covariance_files
    files = [str(p) for p in (measured.bands, measured.covariance) if p is not None]
    # Messages that concern all eyes of a chunk begin with this name.
    arguments = {"name": ", ".join(files) or "batch", **measured.spectrum_arguments}
    names_left = set(table.left())

    def options_of(chunk: Eyes) -> dict[str, Any]:
        headers = [m.header for m in chunk.values() if isinstance(m, Measured)]
        return {"noise": measured.noise, **model.problem_arguments(headers)}

    with table.progress() as bar:
        # A chunk is fitted whole, so that its numbers are those of a run that never stopped.
        chunks = [(chunk, options_of(chunk)) for chunk in _chunks(eyes) if names_left & set(chunk)]
        size = min(_MOST_CHUNKS, -(-len(chunks) // _PIECES)) if workers.in_other_processes else 1
        pieces = [chunks[i : i + size] for i in range(0, len(chunks), size)]
        fits = {i: (piece, arguments, sampler.seed) for i, piece in enumerate(pieces)}
        for i, result in run_pieces(_fit_piece, fits, workers):
            names = [n for chunk, _ in pieces[i] for n in chunk if n in names_left]
            if isinstance(result, LostPiece):
                result = {n: _row(n, FAILED, "", result.reason) for n in names}, {}
            rows, new_covariances = result
            covariances |= {n: new_covariances[n] for n in names if n in new_covariances}
            table.add({n: rows[n] for n in names})
            bar.set_description("eyes", refresh=False)
            bar.update(sum(not results.posteriors or rows[n]["status"] == FAILED for n in names))
        if output is not None and results.posteriors:
            tasks: dict[str, tuple[Any, ...]] = {}
            for n, eye in eyes.items():
                if n in names_left and table.rows[n]["status"] != FAILED:
                    of_eye = n, eye, arguments, options_of({n: eye}), output / n
                    tasks[n] = (_EyeTask(*of_eye, sampler, results.resume),)
            function: Any = _sample_posterior
            if results.posteriors == AMORTISED:
                function, folder = _draw_by_flow, results.flows or output / "flows"
                for chunk, options in chunks:
                    if names := [n for n in chunk if n in tasks]:
                        spectra = [eyes[n] for n in names]
                        path = _find_flow(spectra, arguments, options, folder, sampler.seed)
                        tasks |= {n: (*tasks[n], path) for n in names}
            for n, result in run_pieces(function, tasks, workers):
                lost = isinstance(result, LostPiece)
                changes = {"status": FAILED, "warnings": result.reason} if lost else result
                remarks = table.rows[n]["warnings"], changes.get("warnings")
                table.add(
                    {n: table.rows[n] | changes | {"warnings": "; ".join(filter(None, remarks))}}
                )
                bar.update()
    return table.conclude()


def _read_eyes(source: Path, reading: io.ReadOptions) -> Eyes:
    """Read spectra by name; an error takes the place of one that cannot be read."""
    if not source.is_dir():
        spectra = io.read_eyes(source, **reading)
        faults = {n: e for n, e in spectra.items() if isinstance(e, ValueError)}
        return spectra | {n: ValueError(f"{source}: {e}") for n, e in faults.items()}
    eyes: dict[str, Measured | ValueError] = {}
    for path in sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES):
        if path.stem in eyes:
            raise ValueError(f"{path}: another file names an eye {path.stem!r}; rename one of them")
        try:
            eyes[path.stem] = io.read_measured(path, **reading)
        except ValueError as error:
            eyes[path.stem] = error
    return eyes


def _chunks(eyes: Eyes) -> Iterator[Eyes]:
    """Group eyes with one grid and instrument, which share one compiled program."""
    groups: dict[Any, list[str]] = {}
    for name, m in eyes.items():
        shared = None if isinstance(m, ValueError) else (
            m.wavelengths.tobytes(), m.sd is None, m.correlated, m.bandwidth, m.rows,
            process_of([m.header]),
        )  # fmt: skip
        groups.setdefault(shared, []).append(name)
    size = _CHUNK * jax.device_count()
    for names in groups.values():
        for first in range(0, len(names), size):
            yield {name: eyes[name] for name in names[first : first + size]}


def _spectrum(measured: Measured, arguments: Mapping[str, Any]) -> Observation:
    covariance = arguments["covariance"]
    selected = None if covariance is None else measured.select(covariance)
    return ij.spectrum(measured, **{**arguments, "covariance": selected})


def _row(*cells: str) -> EyeRow:
    return dict(zip(_FIRST_COLUMNS, cells, strict=True))


def _fit_piece(
    chunks: list[tuple[Eyes, dict[str, Any]]], spectrum_arguments: Mapping[str, Any], seed: int
) -> tuple[dict[str, EyeRow], dict[str, list[EyeRow]]]:
    """Fit eyes; return their rows, and rows of the covariances of those that could be fitted."""
    rows, covariances = {}, {}
    for chunk, options in chunks:
        new_rows, new_covariances = _fit_chunk(chunk, spectrum_arguments, options, key_of(seed))
        rows |= new_rows
        covariances |= new_covariances
    return rows, covariances


def _fit_chunk(
    chunk: Eyes, spectrum_arguments: Mapping[str, Any], options: Mapping[str, Any], key: jax.Array
) -> tuple[dict[str, EyeRow], dict[str, list[EyeRow]]]:
    """Fit eyes that share one grid of wavelengths; returns what `_fit_piece` does."""
    spectra = [m for m in chunk.values() if isinstance(m, Measured)]
    if not spectra:
        return {name: _row(name, FAILED, "", str(fault)) for name, fault in chunk.items()}, {}
    first = spectra[0]
    try:
        with naming(spectrum_arguments["name"]):
            spectrum = _spectrum(first, spectrum_arguments)
        problem = ij.problem(spectrum, **options)
    except ValueError as error:
        return {name: _row(name, FAILED, "", str(error)) for name in chunk}, {}
    devices = jax.device_count()
    # A power of two on each device, so that few programs serve all numbers of eyes.
    count = devices * min(_CHUNK, 1 << (-(-len(chunk) // devices) - 1).bit_length())
    padded = spectra + [spectra[-1]] * (count - len(chunk))
    dtype = jnp.result_type(float)
    values, sds = (
        None if getattr(first, n) is None else jnp.asarray([getattr(m, n) for m in padded], dtype)
        for n in ("values", "sd")
    )
    if spectrum_arguments["covariance"] is not None:  # in place of the files' noise
        sds = None
    if devices > 1:
        mesh = jax.make_mesh((devices,), ("eyes",))
        sharding = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("eyes"))
        values, sds = jax.device_put((values, sds), sharding)
    other = problem.by(other_of(problem.process))
    own_fits, other_fits = (
        jax.tree.map(np.asarray, _fit_all(p, values, sds, key)) for p in (problem, other)
    )
    names = problem.fitted
    rows, covariances = {}, {}
    for i, (name, measured) in enumerate(zip(chunk, spectra, strict=True)):
        own, others = (jax.tree.map(lambda x, i=i: x[i], fits) for fits in (own_fits, other_fits))
        status, remarks = _judge(problem, own)
        said = [line.removeprefix("WARNING: ") for line in data_warnings(problem)]
        warnings = [*measured.doubts, *said, *remarks]
        comparison = compare_processes(problem, own, other, others)
        if comparison.preferred:
            warnings.append(preference(comparison))
        if warnings and status == OK:
            status = DOUBTFUL
        numbers = [(c, of[n]) for n in names for c, of in ((n, own.values), (f"{n}_sd", own.sd))]
        covariance = _covariance(problem, own, names)
        priors = dict(zip(problem.free, problem.priors, strict=True))
        covariances[name] = covariance_rows(name, {n: priors[n] for n in names}, covariance)
        of_abl = abl_melanin(names, np.array([own.values[n] for n in names]), covariance)
        abl = [] if of_abl is None else [*zip(_ABL, map(float, of_abl), strict=True)]
        rows[name] = {
            **_row(name, status, "", "; ".join(warnings)),
            **{column: f"{x:.6g}" for column, x in [*numbers, *abl]},
            "chi_square": f"{own.chi_square:.6g}",
            "degrees": str(own.degrees),
            "p_value": f"{own.p_value:.3g}",
            "process": option_of(problem.process),
            "other_process": option_of(comparison.process),
            "log_odds_other": f"{comparison.log_odds:.4g}",
            "differs": " ".join(n for n, m in comparison.moved.items() if m.differs),
            **{f"other_{n}": f"{m.other.value:.6g}" for n, m in comparison.moved.items()},
            "notes": "; ".join(measured.notes),
        }
    return rows, covariances


@eqx.filter_jit
def _fit_all(problem: Problem, values, sds, key):
    observation = problem.observations[0]

    def fit_one(v, sd):
        # Costs agree within 1e-9 with those of tolerances of 1e-8, in half the steps.
        own = problem.with_observations(with_values(observation, v, sd))
        return fit(own, solver=levenberg_marquardt(1e-5, 1e-5), starts=2, key=key)

    return eqx.filter_vmap(fit_one, in_axes=(0, None if sds is None else 0))(values, sds)


def _covariance(problem: Problem, own: Fit, names: list[str]) -> np.ndarray:
    """Compute the covariance of the values of parameters, to first order."""
    indices = [problem.free.index(n) for n in names]
    covariance = own.covariance[np.ix_(indices, indices)]
    # Derivatives of the values by z, which are positive.
    slopes = np.array([own.sd[n] for n in names]) / np.sqrt(np.diag(covariance))
    return slopes[:, None] * covariance * slopes


def _judge(problem: Problem, own: Fit) -> tuple[str, list[str]]:
    """Return the status of a fit, and its warnings."""
    remarks = [words_for(own.status)] if words_for(own.status) else []
    if own.status == FitStatus.not_converged or own.status == FitStatus.solver_failed:
        return FAILED, remarks
    for name, z in zip(problem.free, own.z, strict=True):
        if abs(z) > OFF_PRIOR:
            value = float(own.values[name])
            remarks.append(
                f"{name} = {value:.3g} is {abs(z):.0f} standard deviations off its prior"
            )
    return (DOUBTFUL if remarks else OK), remarks


class _EyeTask(NamedTuple):
    """An eye and how its posterior is sampled, to be sent to any process."""

    name: str
    measured: Any
    spectrum_arguments: Mapping[str, Any]
    options: Mapping[str, Any]
    folder: Path
    sampler: Sampler
    resume: bool

    def problem(self) -> Problem:
        arguments = {**self.spectrum_arguments, "name": self.name}
        return ij.problem(_spectrum(self.measured, arguments), **self.options)


def _find_flow(
    eyes: Sequence[Any],
    spectrum_arguments: Mapping[str, Any],
    options: Mapping[str, Any],
    folder: Path,
    seed: int,
) -> Path:
    """Find or train the flow for the spectra of some eyes on one grid, and return its file."""
    problem = ij.problem(_spectrum(eyes[0], spectrum_arguments), **options)
    if problem.observations[0].sd is not None:
        # A flow for the noise that the files state, by powers of two so that other eyes share it.
        noise = problem.noise
        modelled = [np.hypot(noise.relative * m.values, noise.absolute) for m in eyes]
        given = spectrum_arguments["covariance"] is not None  # in place of the files' noise
        sds = [problem.observations[0].sd if given else m.sd for m in eyes]
        ratios = np.array(sds) / np.array(modelled)
        level = 2.0 ** np.round(np.log2(np.median(ratios)))
        noise = dataclasses.replace(
            noise, relative=noise.relative * level, absolute=noise.absolute * level
        )
        problem = dataclasses.replace(problem, noise=noise)
    with ThreadPoolExecutor(cores()) as pool:
        return flow_for(problem, folder, seed, pool.map)


def _draw_by_flow(eye: _EyeTask, path: Path) -> EyeRow:
    """Draw the posterior of an eye by a flow and return the changed cells of its row, and new
    warnings.
    """
    problem, folder, key = eye.problem(), eye.folder, eye.sampler.key
    (observation,), optimum = problem.observations, fit(problem, key=key)
    values, z, covariance = (
        np.asarray(x)[None] for x in (observation.values, optimum.z, optimum.covariance)
    )
    sd = None if observation.sd is None else np.asarray(observation.sd)[None]
    weighted = weighted_draws(
        read_flow(path, problem), problem, values, z, covariance, sd, draws=_DRAWS, key=key
    )
    unusual, (efficiency,) = bool(weighted.unusual[0]), weighted.efficiency
    changes = {"efficiency": f"{efficiency:.3g}", "out_of_distribution": "yes" if unusual else "no"}
    if unusual:
        remark = "the model's own spectra do not look like this one"
        changes |= {"status": DOUBTFUL, "warnings": remark}
    if efficiency < EFFICIENT:
        sampled = _sample_posterior(eye)
        remarks = "; ".join(r["warnings"] for r in (changes, sampled) if "warnings" in r)
        return changes | sampled | ({"warnings": remarks} if remarks else {})
    folder.mkdir(parents=True, exist_ok=True)
    draws = weighted.equal(0, _DRAWS // 2, key=key)
    note = f"draws of a flow weighted by the likelihood, {100 * efficiency:.0f} in 100 effective"
    report.write_groups(folder, problem, of_draws(problem, draws), [note], key)
    for n, x in reported(problem, draws).items():
        ends = zip(("q2.5", "q50", "q97.5"), np.percentile(x, (2.5, 50, 97.5)), strict=True)
        changes |= {f"{n}_{end}": f"{value:.6g}" for end, value in ends}
    return changes | {"posterior": CONVERGED}


def _sample_posterior(eye: _EyeTask) -> EyeRow:
    """Sample the posterior of an eye and return the changed cells of its row, and new warnings."""
    problem, folder, sampler = eye.problem(), eye.folder, eye.sampler
    folder.mkdir(parents=True, exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not eye.resume:
        chain.unlink()
    try:
        bar = report.progress_bar(True)
        if report.report_eye(problem, folder, sampler, bar, resume=chain.exists(), quiet=True):
            _draw_likelihood(problem, folder, sampler.key)
            return {"posterior": CONVERGED}
        posterior, warning = "not long enough", "the chain is not long enough"
    except ValueError as error:
        posterior, warning = "", str(error)
    return {"status": FAILED, "posterior": posterior, "warnings": f"{folder}: {warning}"}


def _draw_likelihood(problem: Problem, folder: Path, key: jax.Array) -> None:
    """Write draws of an eye's likelihood, which `irisjax compare-groups` uses."""
    names = [n for n in problem.fitted if kind(n) not in ("gain", "noise")]
    starts = tails(problem, np.asarray(fit(problem, key=key).z), names)
    draws = likelihood_draws(problem, starts, names, key=key)
    with replacing(folder / LIKELIHOOD) as path, path.open("wb") as file:
        np.savez(file, **dict(zip(names, draws.T, strict=True)))
