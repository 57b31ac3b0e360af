"""`irisjax fit`: a measured spectrum in, a posterior with its diagnostics out."""

from contextlib import nullcontext

import typer

import irisjax as ij
from irisjax import io
from irisjax.cli.engine import Workers
from irisjax.cli.files import check_folder
from irisjax.cli.fit_options import EPILOG as EPILOG
from irisjax.cli.fit_options import FitResults, Measurements, Model, Sampler
from irisjax.cli.options import dashed, grouped, notice
from irisjax.io.tables import naming
from irisjax.plot.beside import beside, here

_NOT_CONVERGED = 3


@grouped
def fit_command(
    measured: Measurements,
    model: Model,
    sampler: Sampler,
    results: FitResults,
    workers: Workers,
) -> None:
    """Infer the pigments of an iris from its measured spectrum, with credible intervals.

    For example: irisjax fit eye.csv -o fit_eye

    Columns of the file: wavelength (nm or µm), reflectance (fraction or %), and
    its standard deviation (named sd) or further scans. Assumptions are printed.

    Exit status: 0; 3 where the chain is not long enough (raise --max-steps and
    --resume), or an eye of a --batch failed (doubtful ones are counted, and
    marked in the file); 2 for wrong input.
    """
    from irisjax.cli import batch, compare, report
    from irisjax.infer.posterior import check_run

    spectra, folder = measured.spectra or [], results.output
    workers.check(results.batch)
    if bool(spectra) == (results.batch is not None):
        raise ValueError(
            "give the SPECTRUM of an eye, or --batch with a folder or a CSV of many eyes"
        )
    if results.compare:
        typed = [n for n in ("walkers", "max_steps") if n in sampler.typed]
        typed += [n for n in ("batch", "posteriors", "resume") if n in results.typed]
        if typed:
            raise ValueError(f"--compare does not go with {', '.join(map(dashed, typed))}")
        if folder is not None:
            check_folder(folder, compare.FILES[0], "a comparison", results.overwrite)
    if model.separate is not None and len(spectra) < 2:
        raise ValueError("--separate needs two or more spectra of one eye")
    if results.batch is not None:
        raise typer.Exit(batch.fit_many(results.batch, measured, model, sampler, results, workers))
    alone = [n for n in ("posteriors", "flows") if n in results.typed]
    alone += [n for n in ("resume", "overwrite") if n in results.typed and folder is None]
    if alone:
        need = "--batch" if alone[0] in ("posteriors", "flows") else "-o FOLDER"
        raise ValueError(f"{dashed(alone[0])} means something only with {need}")
    spectrum_arguments = measured.spectrum_arguments
    observations, headers, covariance = [], [], spectrum_arguments["covariance"]
    for path in spectra:
        if path.is_dir():
            raise ValueError(f"{path}: is a folder; --batch fits all spectra in it")
        table = io.read_measured(path, **measured.reading_options)
        for remark in (*table.notes, *(f"WARNING: {doubt}" for doubt in table.doubts)):
            notice(f"{path}: {remark}")
        if measured.bands is not None:
            with naming(f"{measured.bands}, bands for {path}"):
                spectrum_arguments["bands"].matched(table.wavelengths)
        typed = [dashed(n) for n in ("relative_noise", "absolute_noise") if n in measured.typed]
        if typed and (table.sd is not None or covariance is not None):
            notice(f"{path}: has noise of its own; {' and '.join(typed)} not used")
        if covariance is not None:
            with naming(path):
                spectrum_arguments["covariance"] = table.select(covariance)
        observations.append(ij.spectrum(table, name=path.name, **spectrum_arguments))
        headers.append(table.header)
    options = {"noise": measured.noise, **model.problem_arguments(headers)}
    with report.progress_bar() as bar, nullcontext(here) if folder is None else beside() as draw:
        problem = ij.problem(observations, **options)
        for path in {p for p in spectra if spectra.count(p) > 1}:
            raise ValueError(f"{path}: given twice; it would count as two measurements")
        if results.compare:
            compare.report_comparison(problem, folder, sampler, bar, draw)
            raise typer.Exit(0)
        if folder is not None:
            advice = "--resume continues them, --overwrite starts again"
            check_folder(folder, "chain.h5", "results", results.resume or results.overwrite, advice)
            check_run(problem, None, walkers=sampler.walkers, key=sampler.key)
            folder.mkdir(parents=True, exist_ok=True)
            if not results.resume:
                (folder / "chain.h5").unlink(missing_ok=True)
        model.notice_process(problem)
        resume = results.resume
        converged = report.report_eye(problem, folder, sampler, bar, resume=resume, draw=draw)
    raise typer.Exit(0 if converged else _NOT_CONVERGED)
