"""Groups of options of `irisjax fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

import irisjax as ij
from irisjax.cli.options import (
    SEED_HELP,
    Group,
    cosine,
    name_parser,
    named_option,
    number_parser,
    option,
    range_parser,
    read_seed,
    whole_parser,
)
from irisjax.infer.observation import RADIANCE, REFLECTANCE
from irisjax.infer.parameters import PARAMETERS
from irisjax.io.columns import QUANTITIES
from irisjax.io.measured import REFLECTANCE_UNITS, WAVELENGTH_UNITS, ReadOptions
from irisjax.numerics.checks import Range
from irisjax.transport.process import PROCESSES


def _span(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    found = number_parser(1, 1e5)(low), number_parser(1, 1e5)(high) if colon else 0.0
    if not found[0] < found[1]:
        raise ValueError(f"{text!r}: write two wavelengths in nm, such as 400:700")
    return found


@dataclass(frozen=True, kw_only=True)
class Measurements(Group):
    """What was measured, of which eye, and how well."""

    PANEL = "Measurement"

    spectra: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SPECTRUM",
            help="file of wavelengths and reflectances (CSV, an instrument's text, JCAMP-DX); "
            "several are of one eye, fitted together",
            show_default=False,
        ),
    ] = None
    relative_noise: Annotated[
        float,
        option(
            parse=number_parser(0, 10),
            metavar="SHARE",
            help="noise, a share of the reflectance, of files with neither sd nor repeated scans",
        ),
    ] = 0.02
    absolute_noise: Annotated[
        float,
        option(
            parse=number_parser(1e-12, 1e3),
            metavar="REFLECTANCE",
            help="noise beside it that does not depend on the reflectance",
        ),
    ] = 2e-4
    outliers: Annotated[
        bool,
        option("--outliers", metavar="", help="heavy-tailed noise: single wild values do no harm"),
    ] = False
    discrepancy: Annotated[
        str | None,
        option(
            metavar="SHARE:NM",
            help="allow the model a smooth error: size and correlation length, such as 0.02:80",
        ),
    ] = None
    quantity: Annotated[
        str | None,
        named_option(
            "what the file holds; default what it says, or a reflectance. Of a radiance the "
            "illuminant is 1 at 560 nm",
            *QUANTITIES,
        ),
    ] = None
    unit: Annotated[
        str | None, named_option("of reflectances, where the file does not say", *REFLECTANCE_UNITS)
    ] = None
    wavelength_unit: Annotated[
        str | None, named_option("where the file does not say", *WAVELENGTH_UNITS)
    ] = None
    wavelengths: Annotated[
        Any,  # typer takes a pair for two words
        option(
            parse=_span, metavar="LOW:HIGH", help="leave out wavelengths outside this range, nm"
        ),
    ] = None
    illuminant: Annotated[
        str, option(metavar="NAME", help="of a radiance, by its name in colour-science")
    ] = "D65"
    cos_incidence: Annotated[
        Any,  # a number or the word
        option(
            parse=cosine,
            metavar="COSINE",
            help="of the light's angle from the normal, 0 to 1; or diffuse",
        ),
    ] = 1.0
    first_surface: Annotated[
        bool,
        option(
            "--first-surface/--no-first-surface",
            metavar="",
            help="the iris's own mirror reflection is in the data",
        ),
    ] = True

    @property
    def noise(self) -> ij.Noise:
        """How far values may lie from the model's."""
        rough, length = _discrepancy(self.discrepancy)
        stated: dict[str, Any] = {
            "relative": self.relative_noise,
            "absolute": self.absolute_noise,
            "discrepancy": rough,
            "length": length,
            "degrees_of_freedom": 4.0 if self.outliers else None,
        }
        return ij.Noise(**stated)

    @property
    def seen(self) -> dict[str, Any]:
        """What `irisjax.spectrum` is told beside the numbers."""
        names = ("illuminant", "cos_incidence", "first_surface")
        quantity = RADIANCE if self.quantity == RADIANCE else REFLECTANCE
        return {"quantity": quantity, **{name: getattr(self, name) for name in names}}

    @property
    def reading(self) -> ReadOptions:
        """What `irisjax.io.read_measured` is told."""
        return ReadOptions(self.quantity, self.unit, self.wavelength_unit, self.wavelengths)


@dataclass(frozen=True, kw_only=True)
class Model(Group):
    """What is known, what is to be found, and by which rules of light transport."""

    PANEL = "Model"

    free: Annotated[
        str | None,
        option(
            metavar="NAMES",
            help="parameters to infer, separated by commas; default: those marked * below",
        ),
    ] = None
    fix: Annotated[
        list[str] | None,
        option(metavar="NAME=VALUE", help="a parameter that is known; repeatable"),
    ] = None
    prior: Annotated[
        list[str] | None,
        option(
            metavar="NAME=PRIOR",
            help="such as 'hemoglobin=lognormal(0.1, 0.3)'; repeatable; kinds below",
        ),
    ] = None
    separate: Annotated[
        str | None,
        option(
            metavar="NAMES",
            help="parameters that each of several spectra has for itself, by commas: NAME@1, "
            "NAME@2, ...",
        ),
    ] = None
    process: Annotated[
        str,
        option(
            parse=name_parser(*PROCESSES),
            metavar="NAME",
            help=f"rules of light transport: {', '.join(PROCESSES)}",
        ),
    ] = "ilit-2006"

    @property
    def stated(self) -> dict[str, Any]:
        """What `irisjax.problem` is told of the parameters."""
        from irisjax.infer.priors import prior_of

        fixed, priors = {}, {}
        for name, value in (_pair("--fix", text) for text in self.fix or ()):
            fixed[name] = _value(f"--fix {name}", value, PARAMETERS[name].allowed)
        for name, value in (_pair("--prior", text) for text in self.prior or ()):
            priors[name] = prior_of(value, *PARAMETERS[name].support)
        return {
            "free": None if self.free is None else _names(self.free),
            "separate": _names(self.separate or ""),
            "fixed": fixed,
            "priors": priors,
            "process": PROCESSES[self.process],
        }


@dataclass(frozen=True, kw_only=True)
class Sampler(Group):
    """How the posterior is sampled."""

    PANEL = "Sampler"

    walkers: Annotated[
        int,
        option(parse=whole_parser(4, 4096), metavar="count", help="number of chains, 4 to 4096"),
    ] = 64
    max_steps: Annotated[
        int,
        option(
            parse=whole_parser(1, 10_000_000),
            metavar="count",
            help="largest number of steps, 1 to 10000000",
        ),
    ] = 20_000
    seed: Annotated[int, option(parse=read_seed, metavar="number", help=f"{SEED_HELP}results")] = 0


@dataclass(frozen=True, kw_only=True)
class FitResults(Group):
    """Where what is found goes; many eyes at once."""

    PANEL = "Files"

    output: Annotated[
        Path | None,
        option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="for summary.csv, fit.png, corner.png, posterior.nc (arviz), chain.h5; else the "
            "table is printed only",
        ),
    ] = None
    batch: Annotated[
        Path | None,
        option(
            metavar="SOURCE",
            help="many eyes: a folder of spectra, or a CSV with a column an eye",
        ),
    ] = None
    compare: Annotated[
        bool,
        option("--compare", metavar="", help="compare models of light by their evidences"),
    ] = False
    posteriors: Annotated[
        bool,
        option(
            "--posteriors", metavar="", help="with --batch: sample the posterior of every eye too"
        ),
    ] = False
    resume: Annotated[
        bool,
        option("--resume", metavar="", help="continue a stopped run into the same FOLDER"),
    ] = False
    overwrite: Annotated[
        bool,
        option("--overwrite", metavar="", help="replace the results in FOLDER"),
    ] = False


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _pair(option: str, text: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise ValueError(f"{option} {text!r}: write NAME=VALUE")
    return _one(option, name, PARAMETERS), value


def _one(option: str, text: str, names) -> str:
    try:
        return name_parser(*names)(text)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


def _value(option: str, text: str, allowed: Range) -> float:
    try:
        return range_parser(allowed)(text)
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
    return _value("--discrepancy size", size, Range(1e-6, 10)), _value(
        "--discrepancy length", length, Range(1e-3, 1e4)
    )
