"""`irisjax fit`: a measured spectrum in, a posterior with its diagnostics out."""

import sys
from contextlib import nullcontext
from pathlib import Path

import typer

import irisjax as ij
from irisjax import io
from irisjax.cli.files import check_is_folder
from irisjax.cli.fit_options import FitResults, Measurements, Model, Sampler
from irisjax.cli.options import dashed, grouped
from irisjax.infer.parameters import DEFAULT_FREE, PARAMETERS
from irisjax.plot.beside import beside, here

_NOT_CONVERGED = 3


def _described(name: str) -> str:
    """A parameter's line of the help."""
    known, mark = PARAMETERS[name], "*" if name in DEFAULT_FREE else "·"
    unit = f" ({known.allowed.unit})" if known.allowed.unit else ""
    return f"{mark} {name}{unit}: {known.allowed.meaning}; {known.prior!r}"


EPILOG = "\n".join(
    [
        "Parameters and their priors (* free by default; ABL: anterior border layer).",
        "What is neither free nor fixed is as in LB06's moderate iris. To name reduced_scattering, "
        "rayleigh_share, scattering_power or anisotropy puts a power law of scattering in the "
        "place of LB06's formula; it takes --process depth-resolved.",
        *map(_described, PARAMETERS),
        "Kinds of priors: normal(mean, sd), lognormal(median, sd of ln), logitnormal(median, sd of "
        "logit), uniform(low, high), loguniform(low, high).",
    ]
)
"""What follows the options in the help."""


@grouped
def fit_command(
    measured: Measurements, model: Model, sampler: Sampler, results: FitResults
) -> None:
    """Infer the pigments of an iris from its measured spectrum, with credible intervals.

    For example: irisjax fit eye.csv -o fit_eye

    Columns of the file: wavelength (nm or µm), reflectance (fraction or %), and
    its standard deviation (named sd) or further scans. Assumptions are printed.

    Exit status: 0; 3 where the chain is not long enough (raise --max-steps and
    --resume), or an eye of a --batch failed (doubtful ones are counted, and
    marked in the file); 2 for wrong input.
    """
    from irisjax.cli import compare, report
    from irisjax.cli.batch import many
    from irisjax.infer.posterior import check_run

    spectra = measured.spectra or []
    if bool(spectra) == (results.batch is not None):
        raise ValueError(
            "give the SPECTRUM of an eye, or --batch with a folder or a CSV of many eyes"
        )
    if results.compare:
        _check_comparison(sampler, results)
    if model.separate is not None and len(spectra) < 2:
        raise ValueError("--separate needs two or more spectra of one eye")
    options = {"noise": measured.noise, **model.stated}
    sampling = {"walkers": sampler.walkers, "seed": sampler.seed, "max_steps": sampler.max_steps}
    if results.batch is not None:
        status = many(
            results.batch,
            results.output,
            measured.reading,
            measured.seen,
            options,
            sampling,
            results.posteriors,
            results.resume,
            results.overwrite,
        )
        raise typer.Exit(status)
    observations = []
    for path in spectra:
        table = io.read_measured(path, **measured.reading._asdict())
        for note in table.notes:
            print(f"irisjax: {path}: {note}", file=sys.stderr)
        for doubt in table.doubts:
            print(f"irisjax: {path}: WARNING: {doubt}", file=sys.stderr)
        observations.append(ij.spectrum(table, name=path.name, **measured.seen))
    folder, resume = results.output, results.resume
    with report.progress_bar() as bar, nullcontext(here) if folder is None else beside() as draw:
        problem = ij.problem(observations, **options)
        if results.compare:
            compare.models(problem, folder, sampling, bar, draw)
            raise typer.Exit(0)
        if folder is not None:
            # Before an old chain is removed.
            _check_folder(folder, resume, results.overwrite)
            check_run(problem, None, walkers=sampler.walkers, key=report.sampler_key(sampling))
            _prepare(folder, resume)
        converged = report.one(problem, folder, sampling, bar, resume=resume, draw=draw)
    raise typer.Exit(0 if converged else _NOT_CONVERGED)


def _check_comparison(sampler: Sampler, results: FitResults) -> None:
    """Refuse options without meaning beside `--compare`, and results that would be lost."""
    from irisjax.cli.compare import FILES

    typed = [n for n in ("walkers", "max_steps") if n in sampler.typed]
    typed += [n for n in ("batch", "posteriors", "resume") if n in results.typed]
    if typed:
        raise ValueError(f"--compare does not go with {', '.join(map(dashed, typed))}")
    folder = results.output
    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file, not a folder")
    if not results.overwrite and any((folder / name).exists() for name in FILES):
        raise ValueError(f"{folder}: has a comparison; --overwrite starts again")


def _check_folder(folder: Path, resume: bool, overwrite: bool) -> None:
    check_is_folder(folder)
    if (folder / "chain.h5").exists() and not (resume or overwrite):
        raise ValueError(
            f"{folder}: has results; --resume continues them, --overwrite starts again"
        )


def _prepare(folder: Path, resume: bool) -> None:
    """Make the folder for results, without a chain that is not to be continued."""
    folder.mkdir(parents=True, exist_ok=True)
    if not resume:
        for name in ("chain.h5", "chain.h5.bak"):
            (folder / name).unlink(missing_ok=True)
