"""Groups of options of the light and of the instrument."""

import dataclasses
import math
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.anatomy import media
from irisjax.cli import options as opt
from irisjax.measure.colour import OBSERVER
from irisjax.measure.instrument import GAIN, NUMERICAL_APERTURE, AbstractInstrument, Crossing
from irisjax.measure.passbands import BANDWIDTH, Passbands
from irisjax.numerics.checks import Range
from irisjax.tissue.pigments import check_covered, common_range

PHOTOMETERS = ("reflectance", "radiance", "transmittance")
"""Instruments that measure intensity."""

POLARIMETERS = ("cross-polarised", "co-polarised", "degree-of-polarisation")
"""Instruments that measure polarisation."""


def _index_option(default: float, of: str) -> Any:
    return opt.number(f"refractive index of the {of}, {{}}", media.INDEX, default)


def cornea_option() -> Any:
    """Make the option of whether light crosses the cornea."""
    words = "whether light crosses tear film and cornea; auto is inward for radiance, else none"
    return opt.choice(words, ("auto", *get_args(Crossing)), "auto")


class BandOptions(opt.Group, panel="Measurement"):
    """Slit, filters or a camera's channels, and the aperture that collects the light."""

    bandwidth: float | None = opt.number(
        "full width at half maximum of the instrument's slit, a Gaussian; {}",
        BANDWIDTH,
        metavar="NM",
        overrules=("bands",),
    )
    bands: Path | None = opt.option(
        "table of the bands of a camera or of filters: columns centre and fwhm (nm), or each "
        "band's sensitivity beside the wavelengths",
        metavar="FILE",
        overrules=("bandwidth",),
    )
    aperture: float | None = opt.number(
        "numerical aperture, in air, of the fibre or lens along the normal that collects the "
        "light, {}; 0 for 45/0; default: all light sent back, as in a sphere",
        NUMERICAL_APERTURE,
        metavar="NA",
    )

    def read_bands(self, illuminant: str | None = None) -> Passbands | float | None:
        """Return the argument `bands` of an instrument."""
        if self.bandwidth is not None and self.bands is not None:
            raise ValueError("give --bandwidth or --bands, not both")
        return self.bandwidth if self.bands is None else io.read_passbands(self.bands, illuminant)


def _wavelengths_option(default: str, names: str = "") -> Any:
    low, high = common_range()
    words = f"start:stop:step or a list like 450,550; within {low:g} to {high:g}"
    return opt.option(words, opt.Grid(default), names=names, parse=_covered_grid, metavar="nm")


def _covered_grid(text: str) -> opt.Grid:
    grid = opt.Grid(text)
    check_covered(grid.values)
    return grid


class LightOptions(opt.Group, panel="Measurement"):
    wavelengths: opt.Grid = _wavelengths_option("400:700:10")
    cos_incidence: float | str = opt.option(
        "cosine of incidence, 0 to 1, or diffuse",
        1.0,
        parse=opt.cosine,
        metavar="number",
        overrules=("incidence_deg",),
    )
    incidence_deg: float | None = opt.number(
        "the same as an angle, {}", Range(0, 90, "degrees"), overrules=("cos_incidence",)
    )
    aqueous_index: float = _index_option(media.AQUEOUS, "aqueous humour")

    def __post_init__(self) -> None:
        super().__post_init__()
        if {"cos_incidence", "incidence_deg"} <= self.typed:
            raise ValueError("give --cos-incidence or --incidence-deg, not both")

    @property
    def cosine(self) -> float | str:
        """Cosine of incidence, or the word for diffuse light."""
        degrees = self.incidence_deg
        return self.cos_incidence if degrees is None else math.cos(math.radians(degrees))

    def instrument_arguments(self) -> dict[str, Any]:
        """Return the arguments that every instrument takes: light and media."""
        names = (name for name in ("aqueous", "cornea", "tear") if hasattr(self, f"{name}_index"))
        indices = {name: getattr(self, f"{name}_index") for name in names}
        return {"cos_incidence": self.cosine, "media": media.Media(**indices)}

    def instrument_at(self, grid: np.ndarray) -> AbstractInstrument:
        """Return the instrument that measures at these wavelengths (nm)."""
        raise NotImplementedError

    def settings(self) -> dict[str, Any]:
        """Return the options to write, with the angle as its cosine."""
        options = {**super().settings(), "cos_incidence": self.cosine}
        return {n: v for n, v in options.items() if n != "incidence_deg"}


class EyeLight(LightOptions):
    cornea: str = cornea_option()
    cornea_index: float = _index_option(media.CORNEA, "cornea")
    tear_index: float = _index_option(media.TEAR, "tear film")
    first_surface: bool = opt.flag("include light reflected by the iris's own surface", True)

    def instrument_arguments(self) -> dict[str, Any]:
        """Return the arguments that every instrument takes; `auto` leaves the cornea out."""
        cornea = {} if self.cornea == "auto" else {"cornea": self.cornea}
        return {**super().instrument_arguments(), "first_surface": self.first_surface, **cornea}


class BandedLight(BandOptions, EyeLight):
    """Light that is read through a slit, filters or a camera's channels."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.bands is not None and "wavelengths" in self.typed:
            raise ValueError("--bands has its own wavelengths: give it without --wavelengths")

    def instrument_arguments(self) -> dict[str, Any]:
        """Return the arguments that every instrument takes; some take no aperture or bands."""
        given = {"aperture": self.aperture, "bands": self.read_bands()}
        return super().instrument_arguments() | {n: v for n, v in given.items() if v is not None}

    def settings(self) -> dict[str, Any]:
        """Return the options to write, without wavelengths if bands are given."""
        omitted = () if self.bands is None else ("wavelengths",)
        return {n: v for n, v in super().settings().items() if v is not None and n not in omitted}


def with_band_centres(light: Any) -> Any:
    """Return a group of options with the wavelengths of its bands, if it has any."""
    if light.bands is None:
        return light
    centres = np.asarray(io.read_passbands(light.bands).centres)
    grid = opt.Grid(",".join(f"{x:.6g}" for x in centres))
    return dataclasses.replace(light, wavelengths=grid)


class SpectrumLight(BandedLight):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {
        "illuminant": ("instrument", ("radiance",)),
        "bandwidth": ("instrument", PHOTOMETERS),
        "bands": ("instrument", PHOTOMETERS),
        "aperture": ("instrument", ("reflectance",)),
        "first_surface": ("instrument", ("reflectance", "radiance", *POLARIMETERS)),
        "polariser_deg": ("instrument", POLARIMETERS),
        "exit_deg": ("instrument", POLARIMETERS),
        "exit_azimuth_deg": ("instrument", POLARIMETERS),
    }

    instrument: str = opt.choice(
        "share of the light sent back; radiance under an illuminant; share that leaves behind, "
        "which takes --ipe-melanin; share sent back through an analyser, of polarised light; "
        "degree of linear polarisation",
        (*PHOTOMETERS, *POLARIMETERS),
        "reflectance",
    )
    quantity: str | None = opt.option("the same as --instrument", parse=str, metavar="name")
    illuminant: str = opt.option(
        "light source by its name in colour-science", "D65", metavar="name"
    )
    polariser_deg: float | None = opt.number(
        "polarisation of the light, from the plane of incidence; default 0, unpolarised for "
        "degree-of-polarisation",
        Range(-180, 180, "degrees"),
    )
    exit_deg: float | str | None = opt.option(
        "viewing angle from the normal, 0 to 90, or hemisphere; default 0, 45 for "
        "degree-of-polarisation",
        parse=opt.number_or(ij.HEMISPHERE, Range(0, 90)),
        metavar="degrees",
    )
    exit_azimuth_deg: float = opt.number(
        "azimuth of the viewing direction, 0 where a mirror would send the light",
        Range(-360, 360, "degrees"),
        0.0,
    )

    def __post_init__(self) -> None:
        if self.quantity is not None:  # by the name that it has in `irisjax fit`
            instrument = opt.one_of(*PHOTOMETERS, *POLARIMETERS)(self.quantity)
            if "instrument" in self.typed and self.instrument != instrument:
                names = f"--instrument {self.instrument} and --quantity {instrument}"
                raise ValueError(f"{names} are one option by two names: give one of them")
            object.__setattr__(self, "instrument", instrument)
            object.__setattr__(self, "quantity", None)
        super().__post_init__()

    def instrument_at(self, grid: np.ndarray) -> AbstractInstrument:
        arguments = self.instrument_arguments()
        if self.instrument == "radiance":
            return ij.Radiometer(grid, illuminant=self.illuminant, **arguments)
        if self.instrument == "reflectance":
            return ij.Spectrophotometer(grid, **arguments)
        if self.instrument == "transmittance":
            return ij.Transmissometer(grid, **arguments)
        degrees, angle = self._exit_and_polariser()
        arguments |= {
            "cos_exit": degrees if isinstance(degrees, str) else math.cos(math.radians(degrees)),
            "azimuth": math.radians(self.exit_azimuth_deg),
            "polariser": None if angle is None else math.radians(angle),
        }
        if self.instrument == "degree-of-polarisation":
            return ij.Polarimeter(grid, **arguments)
        crossed = self.instrument == "cross-polarised"
        return ij.Analyser(grid, "crossed" if crossed else "parallel", **arguments)

    def settings(self) -> dict[str, Any]:
        """Return the options to write, with a polarimeter's defaults."""
        options = super().settings()
        if self.instrument in POLARIMETERS:
            options["exit_deg"], angle = self._exit_and_polariser()
            options |= {} if angle is None else {"polariser_deg": angle}
        return options

    def _exit_and_polariser(self) -> tuple[float | str, float | None]:
        degrees, angle = self.exit_deg, self.polariser_deg
        if self.instrument == "degree-of-polarisation":
            return 45.0 if degrees is None else degrees, angle
        return 0.0 if degrees is None else degrees, 0.0 if angle is None else angle


class BrdfLight(LightOptions):
    wavelengths: opt.Grid = _wavelengths_option("550", "--wavelength --wavelengths")
    plane: str = opt.choice("exit directions", ("principal", "hemisphere"), "principal")
    angles: int = opt.whole("exit directions over 180 degrees, {}", Range(2, 3600), 90)

    def exits(self) -> tuple[np.ndarray, np.ndarray]:
        """Exit angles from the normal and azimuths, radians, grazing left out."""
        n = self.angles
        if self.plane == "principal":
            signed, _, azimuth = (np.asarray(a) for a in ij.principal_plane(n))
            return np.abs(signed), azimuth
        polar = (np.arange(n // 2) + 0.5) / (n // 2) * np.pi / 2
        polar, azimuth = np.meshgrid(polar, np.arange(n) / n * 2 * np.pi, indexing="ij")
        return polar.ravel(), azimuth.ravel()

    def instrument_at(self, grid: np.ndarray) -> AbstractInstrument:
        angle, azimuth = self.exits()
        arguments = self.instrument_arguments()
        return ij.Goniophotometer(grid, cos_exit=np.cos(angle), azimuth=azimuth, **arguments)


class ColourLight(EyeLight):
    wavelengths: opt.Grid = _wavelengths_option("380:780:5")
    illuminant: str = opt.option(
        "light source by its name in colour-science", "D65", metavar="name"
    )
    observer: str = opt.option(
        "standard observer by its name in colour-science", OBSERVER, metavar="name"
    )

    def instrument_at(self, grid: np.ndarray) -> AbstractInstrument:
        arguments = self.instrument_arguments()
        return ij.Colorimeter(grid, illuminant=self.illuminant, observer=self.observer, **arguments)


class NoisyLight(BandedLight):
    gain: float = opt.number(GAIN.meaning, GAIN, 1.0)
    relative_noise: float = opt.number(
        "standard deviation as a share of the value", Range(0, 10), 0.02, metavar="share"
    )
    absolute_noise: float = opt.number(
        "a constant standard deviation beside it", Range(0, 10), 2e-4, metavar="reflectance"
    )
    scans: int = opt.whole("repeated scans, a column each", Range(1, 1000), 1)
    seed: int = opt.seeded("bytes")
