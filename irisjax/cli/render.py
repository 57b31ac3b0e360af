"""`irisjax render`: a scene file or a preset in, a picture out."""

import itertools
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tqdm import tqdm

from irisjax import io
from irisjax.cli.animate import CHANGES, sheet
from irisjax.cli.animate import frames as _frames
from irisjax.cli.compiled import kept_tables
from irisjax.cli.options import Group, WavelengthGrid, grid_parser, grouped, option, whole_parser
from irisjax.cli.scenes import EyeWithPupil, changed
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range, check_range
from irisjax.render import scene as staging
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.picture import draw_bands


@dataclass(frozen=True, kw_only=True)
class View(EyeWithPupil):
    """Which eye, in which light, seen from where."""

    light: Annotated[
        list[str] | None,
        option(
            metavar="POLAR,AZIMUTH[,IRRADIANCE]",
            help="degrees from the eye's axis (0 to 180) and from the picture's right to its top; "
            "irradiance on what faces it, 3.14 lights a white sheet to white; repeatable; in place "
            "of the scene's lamps and environment",
        ),
    ] = None
    camera: Annotated[
        str | None,
        option(
            metavar="POLAR,AZIMUTH[,WIDTH]",
            help="degrees as those of --light; width of the field at the pupil, mm",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Picture(Group):
    """How it is drawn."""

    PANEL = "Picture"

    size: Annotated[
        str | None, option(metavar="WIDTHxHEIGHT", help="pixels, at most 16384 along a side")
    ] = None
    exposure: Annotated[
        float | None,
        option(metavar="number", help="factor on all radiances; 1 shows a white sheet white"),
    ] = None
    samples: Annotated[
        int,
        option(
            parse=whole_parser(1, 8), metavar="count", help="along each side of a pixel, 1 to 8"
        ),
    ] = 1
    integrator: Annotated[
        str | None,
        option(
            metavar="name",
            help="separable (ILIT, all orders of scattering), radiative-transfer (all orders, each "
            "light's direction; presets have pigments of their own) or single-scattering (marched "
            "as in F09); default: the scene's, separable",
        ),
    ] = None
    bits: Annotated[int, option(metavar="count", help="8 or 16, of a PNG")] = 8
    spectral: Annotated[
        WavelengthGrid | None,
        option(
            parse=grid_parser(),
            metavar="START:STOP:STEP",
            help="nm: a layer each in place of RGB, .exr",
        ),
    ] = None
    animate: Annotated[
        str | None,
        option(
            metavar="name",
            help=f"{', '.join(CHANGES)}: .gif, .mp4, numbered frames (frame_%03d.png), or one .png "
            "of all",
        ),
    ] = None
    frames: Annotated[
        int | None,
        option(
            parse=whole_parser(2, 1000), metavar="count", help="of --animate, 2 to 1000; default 24"
        ),
    ] = None

    def __post_init__(self):
        super().__post_init__()
        if self.animate is not None and self.animate not in CHANGES:
            raise ValueError(f"--animate: unknown {self.animate!r}; known: {', '.join(CHANGES)}")
        if self.animate is not None and self.spectral is not None:
            raise ValueError("--animate: not with --spectral")
        if self.frames is not None and self.animate is None:
            raise ValueError(f"--frames {self.frames} is for --animate")
        if self.bits not in (8, 16):
            raise ValueError(f"--bits {self.bits} must be 8 or 16")
        if self.integrator is not None and self.integrator not in INTEGRATORS:
            raise ValueError(
                f"--integrator: unknown {self.integrator!r}; known: {', '.join(INTEGRATORS)}"
            )
        check_range("--exposure", self.exposure, Range(0, math.inf, above=True))

    @property
    def suffixes(self) -> tuple[str, ...]:
        """How the name of the picture's file may end."""
        if self.animate is not None:
            return ".gif", ".mp4", ".png"
        return (".png", ".exr") if self.spectral is None else (".exr",)


@dataclass(frozen=True, kw_only=True)
class PictureFile(Group):
    """Where it goes."""

    PANEL = "Files"

    output: Annotated[
        Path,
        option("-o", "--output", metavar="FILE.png", help=".png, .exr (linear); see --animate"),
    ] = Path("eye.png")
    overwrite: Annotated[
        bool, option("--overwrite", metavar="", help="replace a picture of that name")
    ] = False


@grouped
def render_command(view: View, picture: Picture, files: PictureFile) -> None:
    """Draw an eye from its pigments: refraction, caustics, scattering in the iris.

    Simulated. PNG is sRGB without any tone adjustment; what is out of its
    range is clipped, and counted on standard error. EXR is linear and unbounded.
    """
    output = files.output
    if output.suffix not in picture.suffixes:
        raise ValueError(f"{output}: must end in {' or '.join(picture.suffixes)}")
    if picture.animate is not None and not _is_sheet(output):
        io.check_movie(output)
    if "bits" in picture.typed and output.suffix == ".exr":
        raise ValueError("--bits is for PNG; an EXR holds floating-point numbers")
    io.check_writable(output)
    first = io.first_file(output)
    if first.exists() and not files.overwrite and not io.is_device(first):
        raise ValueError(f"{first}: exists; --overwrite replaces it")
    file = view.read()
    if picture.spectral is not None and not view.light and "environment" in file.sections:
        raise ValueError(
            "--spectral needs lamps: an environment has colours, not spectra; give --light"
        )
    scene = file.scene(picture.integrator)
    scene = changed(scene, view.light, view.pupil_radius, picture.size, view.camera)
    tinted = scene.lights is not None and scene.lights.tint is not None
    if picture.spectral is not None and tinted:
        raise ValueError(
            "--spectral needs plain lamps: a light's colour has no spectrum; give --light"
        )
    exposure = file.exposure if picture.exposure is None else picture.exposure
    if picture.animate is not None:
        _animated(scene, picture.animate, picture.frames or 24, exposure, output)
    else:
        _still(scene, picture, exposure, output)


def _still(scene: staging.Scene, picture: Picture, exposure: float, output: Path) -> None:
    wavelengths = None if picture.spectral is None else tuple(map(float, picture.spectral.values))
    scene = scene.replace(wavelengths=wavelengths)
    width, height = scene.camera.size
    remark = f"simulated by irisjax; integrator {integrator_name(scene.integrator)}"
    names = ("R", "G", "B") if wavelengths is None else io.spectral_channels(wavelengths)
    with tqdm(
        desc="preparing", total=height, unit="row", disable=not sys.stderr.isatty()
    ) as progress:
        parts = draw_bands(scene, kept_tables(scene), samples=picture.samples)
        first = next(parts)
        if first.error is not None:
            remark += f", response within {100 * first.error:.2g} %"
        progress.set_description("rendering")

        lightest = 0.0

        def lit():
            nonlocal lightest
            for band in itertools.chain([first], parts):
                pixels = exposure * band.pixels
                lightest = max(lightest, float(np.max(pixels)))
                yield pixels
                progress.update(len(band.pixels))

        if output.suffix == ".exr":
            io.write_exr(output, lit(), names, {"comments": remark}, rows=height)
            clipped = 0
        else:
            clipped = io.write_png(
                output, map(_encoded, lit()), bits=picture.bits, remark=remark, rows=height
            )
    _tell(output, clipped, width * height, lightest)


def _encoded(picture: np.ndarray) -> np.ndarray:
    return np.asarray(srgb_encode(picture))


def _tell(output: Path, clipped: int, count: int, lightest: float) -> None:
    if clipped:
        share = 100 * clipped / count
        print(
            f"irisjax: {output}: {clipped} pixels ({share:.2g} %) out of sRGB's range are clipped",
            file=sys.stderr,
        )
    if lightest <= 0:
        print(
            f"irisjax: {output}: the picture is black: no light falls on what the camera sees",
            file=sys.stderr,
        )


def _is_sheet(output: Path) -> bool:
    return output.suffix == ".png" and "%" not in output.name


def _animated(scene: staging.Scene, change: str, count: int, exposure: float, output: Path) -> None:
    found = tqdm(
        _frames(scene, change, count, kept_tables),
        total=count,
        unit="frame",
        disable=not sys.stderr.isatty(),
    )
    lightest = 0.0

    def lit():
        nonlocal lightest
        for picture in found:
            lightest = max(lightest, float(np.max(picture)))
            yield exposure * picture

    pictures = lit()
    remark = f"simulated by irisjax; {change}, {count} frames"
    if _is_sheet(output):
        clipped = io.write_png(
            output, sheet(list(map(_encoded, pictures))), remark=f"{remark} row by row"
        )
    else:
        clipped = io.write_movie(output, map(_encoded, pictures), remark=remark)
    _tell(output, clipped, count * scene.camera.size[0] * scene.camera.size[1], lightest)
