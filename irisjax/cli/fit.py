"""`irisjax fit`: a measured spectrum in, a posterior with its diagnostics out."""

import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

import irisjax as ij
from irisjax import io
from irisjax.cli.options import number, one_of
from irisjax.infer.parameters import DEFAULT_FREE, PARAMETERS
from irisjax.transport.process import PROCESSES

_NOT_CONVERGED = 3
_WHAT, _MODEL, _SAMPLER, _FILES = "Measurement", "Model", "Sampler", "Files"

EPILOG = "\n".join(
    [
        "Parameters and their priors (* free by default; ABL: anterior border layer).",
        "What is neither free nor fixed stands as in LB06's moderate iris.",
        *(
            f"{'*' if name in DEFAULT_FREE else '·'} {name}{f' ({p.unit})' if p.unit else ''}: "
            f"{p.meaning}; {p.prior!r}"
            for name, p in PARAMETERS.items()
        ),
        "Kinds of priors: normal(mean, sd), lognormal(median, sd of ln), logitnormal(median, sd of "
        "logit), uniform(low, high), loguniform(low, high).",
    ]
)
"""What follows the options in the help."""


def fit(
    spectra: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SPECTRUM",
            help="file of wavelengths and reflectances (CSV, TSV, JCAMP-DX); several "
            "are of one eye, fitted together",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FOLDER",
            rich_help_panel=_FILES,
            help="for summary.csv, fit.png, corner.png, posterior.nc (arviz), chain.h5; "
            "else the table is printed only",
        ),
    ] = None,
    batch: Annotated[
        Path | None,
        typer.Option(
            metavar="SOURCE",
            help="many eyes: a folder of spectra, or a CSV with a column an eye",
            rich_help_panel=_FILES,
        ),
    ] = None,
    posteriors: Annotated[
        bool,
        typer.Option(
            "--posteriors",
            help="with --batch: sample every eye, not only fit it",
            rich_help_panel=_FILES,
        ),
    ] = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="go on where a run into the same FOLDER stopped",
            rich_help_panel=_FILES,
        ),
    ] = False,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="begin anew in a FOLDER that has results", rich_help_panel=_FILES
        ),
    ] = False,
    free: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="parameters to find, by commas; default those marked * below",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="a parameter that is known; repeatable",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PRIOR",
            help="such as 'hemoglobin=lognormal(0.1, 0.3)'; repeatable; kinds below",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    separate: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="parameters that each of several spectra has for itself, by commas: "
            "NAME@1, NAME@2, ...",
            rich_help_panel=_MODEL,
        ),
    ] = None,
    process: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"rules of light transport: {', '.join(PROCESSES)}",
            rich_help_panel=_MODEL,
        ),
    ] = "ilit-2006",
    relative_noise: Annotated[
        str,
        typer.Option(
            metavar="SHARE",
            help="noise, a share of the reflectance, of files with neither sd nor repeated scans",
            rich_help_panel=_WHAT,
        ),
    ] = "0.02",
    absolute_noise: Annotated[
        str,
        typer.Option(
            metavar="REFLECTANCE",
            help="noise beside it that does not depend on the reflectance",
            rich_help_panel=_WHAT,
        ),
    ] = "2e-4",
    outliers: Annotated[
        bool,
        typer.Option(
            "--outliers",
            help="heavy-tailed noise: single wild values do no harm",
            rich_help_panel=_WHAT,
        ),
    ] = False,
    discrepancy: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE:NM",
            help="allow the model a smooth error: size and correlation length, such as 0.02:80",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    quantity: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="reflectance, or radiance (the illuminant is 1 at 560 nm)",
            rich_help_panel=_WHAT,
        ),
    ] = "reflectance",
    illuminant: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="of a radiance, by its name in colour-science",
            rich_help_panel=_WHAT,
        ),
    ] = "D65",
    cos_incidence: Annotated[
        str,
        typer.Option(
            metavar="COSINE",
            help="of the light's angle from the normal, 0 to 1; or diffuse",
            rich_help_panel=_WHAT,
        ),
    ] = "1.0",
    first_surface: Annotated[
        bool,
        typer.Option(help="the iris's own mirror reflection is in the data", rich_help_panel=_WHAT),
    ] = True,
    walkers: Annotated[
        int, typer.Option(min=4, max=4096, help="chains side by side", rich_help_panel=_SAMPLER)
    ] = 64,
    max_steps: Annotated[
        int,
        typer.Option(
            min=1,
            max=10_000_000,
            help="stop there if not long enough before",
            rich_help_panel=_SAMPLER,
        ),
    ] = 20_000,
    seed: Annotated[
        int,
        typer.Option(
            min=0, max=2**32 - 1, help="equal seeds give equal results", rich_help_panel=_SAMPLER
        ),
    ] = 0,
) -> None:
    """Find the pigments of an iris from its measured spectrum: medians and intervals, and what the
    data cannot tell.

    For example: irisjax fit eye.csv -o fit_eye

    Columns of the file: wavelength (nm or µm), reflectance (fraction or %), and
    its standard deviation (named sd) or further scans.

    Exit status: 0; 3 where the chain is not long enough (raise --max-steps and
    --resume); 2 for wrong input.
    """
    from irisjax.cli import report
    from irisjax.cli.batch import many
    from irisjax.infer.noise import Noise
    from irisjax.infer.priors import prior_of

    if bool(spectra) == (batch is not None):
        raise ValueError(
            "give the SPECTRUM of an eye, or --batch with a folder or a CSV of many eyes"
        )
    if separate is not None and len(spectra or ()) < 2:
        raise ValueError("--separate needs two or more spectra of one eye")
    rough, length = _discrepancy(discrepancy)
    stated: dict[str, Any] = {
        "relative": _value("--relative-noise", relative_noise, 0, 10),
        "absolute": _value("--absolute-noise", absolute_noise, 1e-12, 1e3),
        "discrepancy": rough,
        "length": length,
        "degrees_of_freedom": 4.0 if outliers else None,
    }
    noise = Noise(**stated)
    named: dict[str, Any] = {"priors": {}, "fixed": {}}
    for text in fix or ():
        name, value = _pair("--fix", text)
        named["fixed"][name] = _value(
            f"--fix {name}", value, PARAMETERS[name].low, PARAMETERS[name].high
        )
    for text in prior or ():
        name, value = _pair("--prior", text)
        named["priors"][name] = prior_of(value, PARAMETERS[name].low, PARAMETERS[name].high)
    options = {
        "free": None if free is None else _names(free),
        "separate": _names(separate or ""),
        "noise": noise,
        "process": PROCESSES[_one("--process", process, PROCESSES)],
        **named,
    }
    seen = {
        "quantity": _one("--quantity", quantity, ("reflectance", "radiance")),
        "illuminant": illuminant,
        "cos_incidence": cos_incidence
        if cos_incidence == ij.DIFFUSE
        else _value("--cos-incidence", cos_incidence, 0, 1),
        "first_surface": first_surface,
    }
    sampler = {"walkers": walkers, "seed": seed, "max_steps": max_steps}
    if batch is not None:
        raise typer.Exit(many(batch, output, seen, options, sampler, posteriors, resume, overwrite))
    observations = []
    for path in spectra or ():
        measured = io.read_measured(path)
        for note in measured.notes:
            print(f"irisjax: {path}: {note}", file=sys.stderr)
        observations.append(ij.spectrum(measured, name=path.name, **seen))
    with tempfile.TemporaryDirectory() as scratch, report.progress_bar() as bar:
        problem = ij.problem(observations, **options)
        folder = _folder(output, resume, overwrite) if output is not None else Path(scratch)
        converged = report.one(
            problem, folder, sampler, bar, resume=resume, files=output is not None
        )
    raise typer.Exit(0 if converged else _NOT_CONVERGED)


def _folder(folder: Path, resume: bool, overwrite: bool) -> Path:
    """The folder for results, emptied of what would be overwritten."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file, not a folder")
    folder.mkdir(parents=True, exist_ok=True)
    chain = folder / "chain.h5"
    if chain.exists() and not resume:
        if not overwrite:
            raise ValueError(
                f"{folder}: has results; --resume goes on with them, --overwrite begins anew"
            )
        chain.unlink()
        (folder / "chain.h5.bak").unlink(missing_ok=True)
    return folder


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _pair(option: str, text: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise ValueError(f"{option} {text!r}: write NAME=VALUE")
    return _one(option, name, PARAMETERS), value


def _one(option: str, text: str, names) -> str:
    try:
        return one_of(*names)(text)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


def _value(option: str, text: str, low: float, high: float) -> float:
    try:
        return number(low, high)(text)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


def _discrepancy(text: str | None) -> tuple[float | None, float | None]:
    if text is None:
        return None, None
    size, colon, length = text.partition(":")
    if not colon:
        raise ValueError(
            f"--discrepancy {text!r}: write its size and its length in nm, such as 0.02:80"
        )
    return _value("--discrepancy size", size, 1e-6, 10), _value(
        "--discrepancy length", length, 1e-3, 1e4
    )
