"""`irisjax render`: a scene file or a preset in, a picture out."""

import dataclasses
import itertools
import math
import sys
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import numpy as np
import typer
from tqdm import tqdm

from irisjax import io
from irisjax.cli.animate import CHANGES, sheet
from irisjax.cli.animate import frames as _frames
from irisjax.cli.cache import kept_tables
from irisjax.cli.options import grid, number
from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import SceneFile, parse_scene, read_scene
from irisjax.measure.colour import srgb_encode
from irisjax.render import scene as staging
from irisjax.render.lights import Lights
from irisjax.render.separable import Separable
from irisjax.render.single_scattering import SingleScattering
from irisjax.render.tiles import bands

_INTEGRATORS: dict[str, type[Separable] | type[SingleScattering]] = {
    "separable": Separable,
    "single-scattering": SingleScattering,
}
_WHAT, _HOW, _FILES = "What", "Picture", "Files"


def render(
    scene: Annotated[
        Path | None,
        typer.Argument(
            help="scene file (TOML); data/scenes/everything.toml explains it", show_default=False
        ),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help=", ".join(PRESETS) + ", in a studio", rich_help_panel=_WHAT)
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="of a preset's maps", rich_help_panel=_WHAT)
    ] = 0,
    light: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POLAR,AZIMUTH[,IRRADIANCE]",
            help="degrees from the eye's axis (0 to 180) and from the picture's right "
            "to its top; irradiance on what "
            "faces it, 3.14 lights a white sheet to white; repeatable; in place of the scene's "
            "lamps and environment",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="POLAR,AZIMUTH[,WIDTH]",
            help="degrees as those of --light; width of the field at the pupil, mm",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    pupil: Annotated[
        str | None, typer.Option(metavar="MM", help="diameter, 0.5 to 9.5", rich_help_panel=_WHAT)
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WIDTHxHEIGHT", rich_help_panel=_HOW)] = None,
    exposure: Annotated[
        float | None,
        typer.Option(
            help="factor on all radiances; 1 shows a white sheet white", rich_help_panel=_HOW
        ),
    ] = None,
    samples: Annotated[
        int, typer.Option(min=1, max=8, help="along each side of a pixel", rich_help_panel=_HOW)
    ] = 1,
    integrator: Annotated[
        str,
        typer.Option(
            help="separable (ILIT, all orders of scattering) or single-scattering "
            "(marched as in F09)",
            rich_help_panel=_HOW,
        ),
    ] = "separable",
    bits: Annotated[int, typer.Option(help="8 or 16, of a PNG", rich_help_panel=_HOW)] = 8,
    spectral: Annotated[
        str | None,
        typer.Option(
            metavar="START:STOP:STEP",
            help="nm: a layer each in place of RGB, .exr",
            rich_help_panel=_HOW,
        ),
    ] = None,
    animate: Annotated[
        str | None,
        typer.Option(
            help=f"{', '.join(CHANGES)}: .gif, .mp4, numbered frames (frame_%03d.png), "
            f"or one .png of all",
            rich_help_panel=_HOW,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=1000,
            help="of --animate; default 24",
            show_default=False,
            rich_help_panel=_HOW,
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help=".png, .exr (linear); see --animate", rich_help_panel=_FILES
        ),
    ] = Path("eye.png"),
) -> None:
    """A picture of an eye from its pigments: refraction, caustics, scattering in the iris.

    Simulated. PNG is sRGB without any tone adjustment; what is out of its range is clipped, and
    counted on standard error. EXR is linear and unbounded.
    """
    moving = (".gif", ".mp4", ".png")
    allowed = (
        moving if animate is not None else (".exr",) if spectral is not None else (".png", ".exr")
    )
    if output.suffix not in allowed:
        raise ValueError(f"{output}: must end in {' or '.join(allowed)}")
    if animate is not None and (spectral is not None or animate not in CHANGES):
        known = (
            f"unknown {animate!r}; known: {', '.join(CHANGES)}"
            if animate not in CHANGES
            else "not with --spectral"
        )
        raise ValueError(f"--animate: {known}")
    if frames is not None and animate is None:
        raise ValueError(f"--frames {frames} is for --animate")
    if bits not in (8, 16):
        raise ValueError(f"--bits {bits} must be 8 or 16")
    if integrator not in _INTEGRATORS:
        raise ValueError(f"--integrator: unknown {integrator!r}; known: {', '.join(_INTEGRATORS)}")
    if animate is not None and not _is_sheet(output):
        io.check_movie(output)
    io.check_writable(output)
    file = scene_file(scene, preset, seed)
    wavelengths = None if spectral is None else grid(spectral).values
    if wavelengths is not None and not light and "environment" in file:
        raise ValueError(
            "--spectral needs lamps: an environment has colours, not spectra; give --light"
        )
    found = changed(file.scene(), light, pupil, size, camera).replace(
        integrator=_INTEGRATORS[integrator]()
    )
    if wavelengths is not None and found.lights is not None and found.lights.tint is not None:
        raise ValueError(
            "--spectral needs plain lamps: a light's colour has no spectrum; give --light"
        )
    factor = file.exposure if exposure is None else exposure
    if not (math.isfinite(factor) and factor > 0):
        raise ValueError(f"--exposure {factor:g} must be above 0")
    if animate is not None:
        _animated(found, animate, frames or 24, factor, output)
        return
    width, height = found.camera.size
    remark = f"simulated by irisjax; integrator {integrator}"
    names = ("R", "G", "B") if wavelengths is None else io.spectral_channels(wavelengths)
    with tqdm(
        desc="preparing", total=height, unit="row", disable=not sys.stderr.isatty()
    ) as progress:
        parts = bands(found, kept_tables(found), samples=samples, wavelengths=wavelengths)
        first = next(parts)
        if first.error is not None:
            remark += f", response within {100 * first.error:.2g} %"
        progress.set_description("rendering")

        def lit():
            for band in itertools.chain([first], parts):
                yield factor * band.pixels
                progress.update(len(band.pixels))

        if output.suffix == ".exr":
            io.write_exr(output, lit(), names, {"comments": remark}, rows=height)
            clipped = 0
        else:
            clipped = io.write_png(
                output, map(_encoded, lit()), bits=bits, remark=remark, rows=height
            )
    _tell(output, clipped, width * height)


def _encoded(picture: np.ndarray) -> np.ndarray:
    return np.asarray(srgb_encode(jnp.asarray(picture)))


def _tell(output: Path, clipped: int, count: int) -> None:
    if clipped:
        share = 100 * clipped / count
        print(
            f"irisjax: {output}: {clipped} pixels ({share:.2g} %) out of sRGB's range are clipped",
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
    pictures = (exposure * picture for picture in found)
    remark = f"simulated by irisjax; {change}, {count} frames"
    if _is_sheet(output):
        clipped = io.write_png(
            output, sheet(list(map(_encoded, pictures))), remark=f"{remark} row by row"
        )
    else:
        clipped = io.write_movie(output, map(_encoded, pictures), remark=remark)
    _tell(output, clipped, count * scene.camera.size[0] * scene.camera.size[1])


def scene_file(path: Path | None, name: str | None, seed: int) -> SceneFile:
    """The scene of a file, or of the preset `name` in a studio."""
    if path is not None:
        if name is not None:
            raise ValueError("give a SCENE file or --preset, not both")
        return read_scene(path)
    if name is None:
        raise ValueError("give a SCENE file or --preset")
    if name not in PRESETS:
        raise ValueError(f"--preset: unknown {name!r}; known: {', '.join(PRESETS)}")
    return parse_scene(
        f"""
        [iris]
        preset = "{name}"
        [maps]
        seed = {seed}
        [environment]
        kind = "studio"
        """,
        f"preset {name}",
    )


def changed(scene: staging.Scene, light=None, pupil=None, size=None, camera=None) -> staging.Scene:
    """A scene with lamps, pupil (mm), picture size or camera as the options write them."""
    if light:
        lamps = [_lamp(text, scene.illuminant) for text in light]
        joined = lamps[0]
        for lamp in lamps[1:]:
            joined = joined + lamp
        scene = scene.replace(lights=joined, environment=None)
    if pupil is not None:
        try:
            diameter = number(0.5, 9.5)(pupil)
        except ValueError as error:
            raise ValueError(f"--pupil: {error}; it is a diameter from 0.5 to 9.5 mm") from None
        scene = scene.replace(eye=scene.eye.replace(pupil_radius=diameter / 2))
    if size is not None:
        width, cross, height = size.partition("x")
        if not (cross and width.isdigit() and height.isdigit()):
            raise ValueError(f"--size {size!r}: write WIDTHxHEIGHT, such as 800x600")
        if max(int(width), int(height)) > 16384:
            raise ValueError(f"--size {size}: at most 16384 along a side")
        scene = scene.replace(
            camera=dataclasses.replace(scene.camera, size=(int(width), int(height)))
        )
    if camera is not None:
        polar, azimuth, field = _angles("--camera", camera, "WIDTH", float(scene.camera.width))
        try:
            scene = scene.replace(
                camera=dataclasses.replace(scene.camera, polar=polar, azimuth=azimuth, width=field)
            )
        except ValueError as error:
            raise ValueError(f"--camera {camera!r}: {error}") from None
    return scene


def _lamp(text: str, illuminant: str) -> Lights:
    polar, azimuth, irradiance = _angles("--light", text, "IRRADIANCE", math.pi)
    return Lights.distant(polar, azimuth, irradiance, illuminant=illuminant)


def _angles(option: str, text: str, third: str, default: float) -> tuple[float, float, float]:
    """Polar angle and azimuth, radians, and the third number of an option,
    which may be left out.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{option} {text!r}: write POLAR,AZIMUTH or POLAR,AZIMUTH,{third}")
    if not 0 <= numbers[0] <= 180:
        raise ValueError(f"{option} {text!r}: the polar angle must be from 0 to 180 degrees")
    return math.radians(numbers[0]), math.radians(numbers[1]), (*numbers, default)[2]
