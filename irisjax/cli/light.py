"""Groups of options that say how the iris is lit and what looks at it."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, get_args

import jax.numpy as jnp

from irisjax.anatomy import media
from irisjax.cli.options import (
    SEED_HELP,
    Group,
    WavelengthGrid,
    cosine,
    exit_angle,
    grid_parser,
    named_option,
    number_parser,
    option,
    overrules,
    range_parser,
    read_seed,
    whole_parser,
)
from irisjax.measure.colour import OBSERVER
from irisjax.measure.instrument import GAIN, Crossing
from irisjax.tissue.pigments import check_covered, common_range

POLARIMETERS = ("cross-polarised", "co-polarised", "degree-of-polarisation")
"""Instruments that see polarisation."""

_VISIBLE, _GREEN, _WHOLE = (
    WavelengthGrid("400:700:10"),
    WavelengthGrid("550"),
    WavelengthGrid("380:780:5"),
)
_ILLUMINANT = option(metavar="name", help="light source by its name in colour-science")


def _index(of: str) -> Any:
    low, high = media.INDEX.low, media.INDEX.high
    return option(
        parse=number_parser(low, high),
        metavar="number",
        help=f"refractive index of the {of}, {low:g} to {high:g}",
    )


def _wavelengths(*names: str) -> Any:
    low, high = common_range()
    return option(
        *names,
        parse=grid_parser(check_covered),
        metavar="nm",
        help=f"start:stop:step or a list like 450,550; within {low:g} to {high:g}",
    )


@dataclass(frozen=True, kw_only=True)
class Light(Group):
    """Where the light comes from, and its wavelengths."""

    PANEL = "Measurement"

    wavelengths: Annotated[WavelengthGrid, _wavelengths()] = _VISIBLE
    cos_incidence: Annotated[
        Any,  # a number or the word
        option(
            parse=cosine,
            metavar="number",
            help="cosine of incidence, 0 to 1, or diffuse",
            callback=overrules("incidence_deg"),
        ),
    ] = 1.0
    incidence_deg: Annotated[
        float | None,
        option(
            parse=number_parser(0, 90),
            metavar="degrees",
            help="the same as an angle, 0 to 90",
            callback=overrules("cos_incidence"),
        ),
    ] = None

    aqueous_index: Annotated[float, _index("aqueous humour")] = media.AQUEOUS

    def __post_init__(self):
        super().__post_init__()
        if {"cos_incidence", "incidence_deg"} <= self.typed:
            raise ValueError("give --cos-incidence or --incidence-deg, not both")

    @property
    def cosine(self) -> float | str:
        """Cosine of incidence, or the word for light from everywhere."""
        degrees = self.incidence_deg
        return self.cos_incidence if degrees is None else math.cos(math.radians(degrees))

    def before_the_iris(self) -> dict[str, Any]:
        """What every instrument is told of light and media."""
        return {
            "cos_incidence": self.cosine,
            "media": media.Media(aqueous=jnp.asarray(self.aqueous_index, float)),
        }

    def settings(self) -> dict[str, Any]:
        """The angle is written as its cosine."""
        found = {**super().settings(), "cos_incidence": self.cosine}
        return {n: v for n, v in found.items() if n != "incidence_deg"}


@dataclass(frozen=True, kw_only=True)
class EyeLight(Light):
    """Light on an eye with a cornea and a surface that mirrors."""

    cornea: Annotated[
        str,
        named_option(
            "whether light crosses tear film and cornea; auto is inward for radiance, else none",
            "auto",
            *get_args(Crossing),
        ),
    ] = "auto"
    cornea_index: Annotated[float, _index("cornea")] = media.CORNEA
    tear_index: Annotated[float, _index("tear film")] = media.TEAR
    first_surface: Annotated[
        bool,
        option(
            "--first-surface/--no-first-surface",
            metavar="",
            help="include light reflected by the iris's own surface",
        ),
    ] = True

    def before_the_iris(self) -> dict[str, Any]:
        """What every instrument before an eye is told; `auto` leaves the cornea to it."""
        indices = (self.aqueous_index, self.cornea_index, self.tear_index)
        return {
            "cos_incidence": self.cosine,
            "media": media.Media(*(jnp.asarray(n, float) for n in indices)),
            "first_surface": self.first_surface,
            **({} if self.cornea == "auto" else {"cornea": self.cornea}),
        }


@dataclass(frozen=True, kw_only=True)
class SpectrumLight(EyeLight):
    """What a spectrophotometer or a radiometer measures."""

    ONLY_WITH: ClassVar = {
        "illuminant": ("instrument", ("radiance",)),
        "polariser_deg": ("instrument", POLARIMETERS),
        "exit_deg": ("instrument", POLARIMETERS),
        "exit_azimuth_deg": ("instrument", POLARIMETERS),
    }

    instrument: Annotated[
        str,
        named_option(
            "share of the light sent back; radiance under an illuminant; share sent back through "
            "an analyser, of polarised light; degree of linear polarisation",
            "reflectance",
            "radiance",
            *POLARIMETERS,
        ),
    ] = "reflectance"
    illuminant: Annotated[str, _ILLUMINANT] = "D65"
    polariser_deg: Annotated[
        float | None,
        option(
            parse=number_parser(-180, 180),
            metavar="degrees",
            help="polarisation of the light, from the plane of incidence; default 0, "
            "unpolarised for degree-of-polarisation",
        ),
    ] = None
    exit_deg: Annotated[
        Any,  # a number or the word
        option(
            parse=exit_angle,
            metavar="degrees",
            help="viewing angle from the normal, 0 to 90, or hemisphere; default 0, "
            "45 for degree-of-polarisation",
        ),
    ] = None
    exit_azimuth_deg: Annotated[
        float,
        option(
            parse=number_parser(-360, 360),
            metavar="degrees",
            help="azimuth of the viewing direction, 0 where a mirror would send the light",
        ),
    ] = 0.0

    def exit(self) -> dict[str, Any]:
        """Where a polarimeter looks from, and the light's polarisation."""
        degrees, angle = self._polarimetry()
        return {
            "cos_exit": degrees if isinstance(degrees, str) else math.cos(math.radians(degrees)),
            "azimuth": math.radians(self.exit_azimuth_deg),
            "polariser": None if angle is None else math.radians(angle),
        }

    def settings(self) -> dict[str, Any]:
        """A polarimeter's defaults are written too."""
        found = super().settings()
        if self.instrument in POLARIMETERS:
            degrees, angle = self._polarimetry()
            found |= {"exit_deg": degrees} | ({} if angle is None else {"polariser_deg": angle})
        return found

    def _polarimetry(self) -> tuple[float | str, float | None]:
        degrees, angle = self.exit_deg, self.polariser_deg
        if self.instrument == "degree-of-polarisation":
            return 45.0 if degrees is None else degrees, angle
        return 0.0 if degrees is None else degrees, 0.0 if angle is None else angle


@dataclass(frozen=True, kw_only=True)
class BrdfLight(Light):
    """What a goniophotometer measures."""

    wavelengths: Annotated[WavelengthGrid, _wavelengths("--wavelength", "--wavelengths")] = _GREEN
    plane: Annotated[str, named_option("exit directions", "principal", "hemisphere")] = "principal"
    angles: Annotated[
        int,
        option(
            parse=whole_parser(2, 3600),
            metavar="count",
            help="exit directions over 180 degrees, 2 to 3600",
        ),
    ] = 90


@dataclass(frozen=True, kw_only=True)
class ColourLight(EyeLight):
    """What a colorimeter measures."""

    wavelengths: Annotated[WavelengthGrid, _wavelengths()] = _WHOLE
    illuminant: Annotated[str, _ILLUMINANT] = "D65"
    observer: Annotated[
        str, option(metavar="name", help="standard observer by its name in colour-science")
    ] = OBSERVER


@dataclass(frozen=True, kw_only=True)
class NoisyLight(EyeLight):
    """A reflectance measured with errors."""

    gain: Annotated[
        float,
        option(parse=range_parser(GAIN), metavar="number", help=GAIN.meaning),
    ] = 1.0
    relative_noise: Annotated[
        float,
        option(
            parse=number_parser(0, 10),
            metavar="share",
            help="standard deviation as a share of the value",
        ),
    ] = 0.02
    absolute_noise: Annotated[
        float,
        option(
            parse=number_parser(0, 10),
            metavar="reflectance",
            help="a constant standard deviation beside it",
        ),
    ] = 2e-4
    scans: Annotated[
        int,
        option(parse=whole_parser(1, 1000), metavar="count", help="repeated scans, a column each"),
    ] = 1
    seed: Annotated[int, option(parse=read_seed, metavar="number", help=SEED_HELP + "bytes")] = 0
