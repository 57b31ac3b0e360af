"""Groups of options of `irisjax fit`."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax

import irisjax as ij
from irisjax import io
from irisjax.cli import options as opt
from irisjax.cli.light import BandOptions, cornea_option
from irisjax.infer.observation import RADIANCE, REFLECTANCE
from irisjax.infer.parameters import DEFAULT_FREE, PARAMETERS
from irisjax.infer.priors import AbstractPrior, prior_of
from irisjax.io.measured import QUANTITIES, REFLECTANCE_UNITS, WAVELENGTH_UNITS, ReadOptions
from irisjax.measure.passbands import BANDWIDTH
from irisjax.numerics.checks import Range, check_known
from irisjax.numerics.streams import key_of
from irisjax.transport.process import DEPTH_RESOLVED, PROCESSES, option_of

Span = tuple[float, float]
AMORTISED = "amortised"
"""Value of `--posteriors` for flows."""


def _describe_parameter(name: str) -> str:
    known, mark = PARAMETERS[name], "*" if name in DEFAULT_FREE else "·"
    unit = f" ({known.allowed.unit})" if known.allowed.unit else ""
    return f"{mark} {name}{unit}: {known.allowed.meaning}; {known.prior!r}"


EPILOG = "\n".join(
    [
        "Parameters and their priors (* free by default; ABL: anterior border layer).",
        "What is neither free nor fixed is as in LB06's moderate iris. To name reduced_scattering, "
        "rayleigh_share, scattering_power or anisotropy puts a power law of scattering in the "
        "place of LB06's formula; it takes --process depth-resolved.",
        *map(_describe_parameter, PARAMETERS),
        "Kinds of priors: normal(mean, sd), lognormal(median, sd of ln), logitnormal(median, sd of "
        "logit), uniform(low, high), loguniform(low, high).",
    ]
)
"""The text below the options in the help."""


def _parse_span(text: str) -> Span:
    low, *high = map(opt.number_in(Range(1, 1e5)), text.split(":", 1))
    if not high or low >= high[0]:
        raise ValueError(f"{text!r}: write two wavelengths in nm, such as 400:700")
    return low, high[0]


def _parse_discrepancy(text: str) -> Span:
    size, colon, length = text.partition(":")
    if not colon:
        raise ValueError(f"{text!r}: write its size and its length in nm, such as 0.02:80")
    return opt.number_in(Range(1e-6, 10))(size), opt.number_in(Range(1e-3, 1e4, "nm"))(length)


def _parse_names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for i, name in enumerate(names):
        check_known("parameter", name, PARAMETERS)
        if name in names[:i]:
            raise ValueError(f"{name} is there twice")
    return names


def _parse_assignment(text: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise ValueError(f"{text!r}: write NAME=VALUE")
    return opt.one_of(*PARAMETERS)(name), value


def _parse_fixed(text: str) -> tuple[str, float]:
    name, value = _parse_assignment(text)
    return name, opt.number_in()(value)  # `irisjax.problem` knows its range


def _parse_prior(text: str) -> tuple[str, AbstractPrior]:
    name, value = _parse_assignment(text)
    return name, prior_of(value, *PARAMETERS[name].support)


def _by_name(option: str, pairs: list[tuple[str, Any]] | None) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in pairs or ():
        if name in values:
            raise ValueError(f"{option}: {name} is there twice")
        values[name] = value
    return values


class SpectralMeasurement(BandOptions):
    """Options that describe a measured spectrum, or a cube of them."""

    relative_noise: float = opt.number(
        "noise, a share of the reflectance, of files with neither sd nor repeated scans",
        Range(0, 10),
        0.02,
        metavar="SHARE",
    )
    absolute_noise: float = opt.number(
        "noise beside it that does not depend on the reflectance",
        Range(1e-12, 1e3),
        2e-4,
        metavar="REFLECTANCE",
    )
    unit: str | None = opt.choice("of reflectances, where the file does not say", REFLECTANCE_UNITS)
    wavelength_unit: str | None = opt.choice("where the file does not say", WAVELENGTH_UNITS)
    wavelengths: Span | None = opt.option(
        "leave out wavelengths outside this range, nm", parse=_parse_span, metavar="LOW:HIGH"
    )
    cos_incidence: float | str = opt.option(
        "of the light's angle from the normal, 0 to 1; or diffuse",
        1.0,
        parse=opt.cosine,
        metavar="COSINE",
    )
    cornea: str = cornea_option()
    first_surface: bool = opt.flag("the iris's own mirror reflection is in the data", True)

    @property
    def spectrum_arguments(self) -> dict[str, Any]:
        """Geometry and bands of the instrument, as arguments of `irisjax.spectrum`."""
        return {
            **{n: getattr(self, n) for n in ("cos_incidence", "first_surface", "aperture")},
            "bands": self.read_bands(),
            "cornea": None if self.cornea == "auto" else self.cornea,
        }


class Measurements(SpectralMeasurement):
    spectra: list[Path] | None = opt.argument(
        "file of wavelengths and reflectances (CSV, an instrument's text, JCAMP-DX); several are "
        "of one eye, fitted together",
        "SPECTRUM",
    )
    outliers: bool = opt.flag("heavy-tailed noise: single wild values do no harm")
    discrepancy: Span | None = opt.option(
        "allow the model a smooth error: size and correlation length, such as 0.02:80",
        parse=_parse_discrepancy,
        metavar="SHARE:NM",
    )
    quantity: str | None = opt.choice(
        "what the file holds; default what it says, or a reflectance. Of a radiance the illuminant "
        "is 1 at 560 nm",
        QUANTITIES,
    )
    column: str | None = opt.option(
        "the column or block that holds the spectrum, where there are several", metavar="NAME"
    )
    sd: str | None = opt.option("the column of its standard deviation", metavar="NAME")
    boxcar: float | None = opt.number(
        "width of a moving average (boxcar) that made the values; {}", BANDWIDTH, metavar="NM"
    )
    correlated_noise: float | None = opt.number(
        "the same of the noise alone, where the spectrum itself is not smoothed; {}",
        BANDWIDTH,
        metavar="NM",
    )
    covariance: Path | None = opt.option(
        "of the reflectances' errors, as fractions: a square table (.csv) or array (.npy), in the "
        "file's order",
        parse=Path,
        metavar="FILE",
    )
    illuminant: str = opt.option(
        "of a radiance, by its name in colour-science", "D65", metavar="NAME"
    )

    @property
    def noise(self) -> ij.Noise:
        smooth, degrees = self.discrepancy or (None, None), 4.0 if self.outliers else None
        stated: Any = (self.relative_noise, self.absolute_noise, *smooth, degrees)
        return ij.Noise(*stated)

    @property
    def spectrum_arguments(self) -> dict[str, Any]:
        """All arguments of `irisjax.spectrum` but the wavelengths and the values."""
        lamp = self.illuminant if "illuminant" in self.typed else None
        if lamp is not None and self.quantity != RADIANCE and self.bands is None:
            raise ValueError(
                "--illuminant means something only with --quantity radiance or --bands"
            )
        return {
            **super().spectrum_arguments,
            "quantity": RADIANCE if self.quantity == RADIANCE else REFLECTANCE,
            "illuminant": self.illuminant,
            "bands": self.read_bands(lamp),
            "boxcar": self.boxcar,
            "correlated": self.correlated_noise,
            "covariance": None if self.covariance is None else io.read_square(self.covariance),
        }

    @property
    def reading_options(self) -> ReadOptions:
        names: Any = ReadOptions.__annotations__
        return ReadOptions(**{name: getattr(self, name) for name in names})


class PixelModel(opt.Group, panel="Model"):
    free: tuple[str, ...] | None = opt.option(
        "parameters to infer, separated by commas; default: those marked * below",
        parse=_parse_names,
        metavar="NAMES",
    )
    fix: list[tuple[str, float]] | None = opt.option(
        "a parameter that is known; repeatable", parse=_parse_fixed, metavar="NAME=VALUE"
    )
    prior: list[tuple[str, AbstractPrior]] | None = opt.option(
        "such as 'hemoglobin=lognormal(0.1, 0.3)'; repeatable; kinds below",
        parse=_parse_prior,
        metavar="NAME=PRIOR",
    )
    process: str | None = opt.option(
        f"rules of light transport: {', '.join(PROCESSES)}; default depth-resolved (radiative "
        "transfer), or those by which irisjax simulated the file",
        parse=opt.one_of(*PROCESSES),
        metavar="NAME",
    )

    def problem_arguments(self, headers: Iterable[Mapping[str, str]]) -> dict[str, Any]:
        """Return arguments of `irisjax.problem` on parameters, for files with these headers."""
        return {
            "free": self.free,
            "fixed": _by_name("--fix", self.fix),
            "priors": _by_name("--prior", self.prior),
            "process": PROCESSES[self.process or process_of(headers)],
        }

    def notice_process(self, problem: ij.Problem) -> None:
        """Print the process that a file, and not an option, has chosen."""
        if self.process is None and problem.process != DEPTH_RESOLVED:
            opt.notice(f"read by {option_of(problem.process)}, by which irisjax simulated the file")


class Model(PixelModel):
    separate: tuple[str, ...] | None = opt.option(
        "parameters that each of several spectra has for itself, by commas: NAME@1, NAME@2, ...",
        parse=_parse_names,
        metavar="NAMES",
    )

    def problem_arguments(self, headers: Iterable[Mapping[str, str]]) -> dict[str, Any]:
        """Return these arguments and the parameters that differ between spectra of one eye."""
        return {**super().problem_arguments(headers), "separate": self.separate or ()}


def flows_folder() -> Any:
    """Return the option for the folder of trained flows."""
    return opt.option(
        "folder in which trained flows are found and kept, one for each instrument, model and "
        "noise; default: flows in the folder for results",
        parse=Path,
        metavar="FOLDER",
    )


def process_of(headers: Iterable[Mapping[str, str]]) -> str:
    """Return the process by which irisjax simulated all of some files, or else radiative transfer,
    which measured irides follow.
    """
    named = {h.get("process", "") if "simulated" in h else "" for h in headers}
    (name,) = named if len(named) == 1 else ("",)
    return name if name in PROCESSES else option_of(DEPTH_RESOLVED)


class Sampler(opt.Group, panel="Sampler"):
    walkers: int = opt.whole("number of chains, {}", Range(4, 4096), 64)
    max_steps: int = opt.whole("largest number of steps, {}", Range(1, 10_000_000), 20_000)
    seed: int = opt.seeded("results")

    @property
    def key(self) -> jax.Array:
        return key_of(self.seed)


class FitResults(opt.Group, panel="Files"):
    output: Path | None = opt.output(
        "for summary.csv, fit.png, corner.png, posterior.nc (arviz), chain.h5; else the table is "
        "printed only",
        "FOLDER",
    )
    batch: Path | None = opt.option(
        "many eyes: a folder of spectra, or a CSV with a column an eye", metavar="SOURCE"
    )
    compare: bool = opt.flag("compare models of light by their evidences")
    posteriors: str | None = opt.choice(
        "with --batch: the posterior of every eye too, by a chain, or by a flow (extra posteriors) "
        "that is trained once and weighted by the exact likelihood, and by a chain where few of "
        "its draws are effective",
        ("emcee", AMORTISED),
    )
    flows: Path | None = flows_folder()
    resume: bool = opt.flag("continue a stopped run into the same FOLDER")
    overwrite: bool = opt.flag("replace the results in FOLDER")
