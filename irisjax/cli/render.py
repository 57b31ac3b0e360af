"""`irisjax render`: a scene file or a preset in, a picture out."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from tqdm import tqdm

from irisjax import io
from irisjax.anatomy.lids import SEEN_FROM
from irisjax.cli import options as opt
from irisjax.cli.compiled import cached_tables
from irisjax.cli.scenes import EyeWithPupil, change_scene
from irisjax.measure.colour import agx_encode, srgb_encode
from irisjax.numerics.checks import Range
from irisjax.render.illumination import Illumination, reflects_inside
from irisjax.render.integrators import INTEGRATORS, integrator_name
from irisjax.render.lights import Lights
from irisjax.render.picture import (
    draw_bands,
    exposure_of_white,
    illuminate,
    prepare_scene,
    respond,
    shade,
    texture,
)
from irisjax.render.project import project_visible
from irisjax.render.scene import Scene

_CHANGES = ("pupil", "light", "pigment", "camera")
_NARROW, _WIDE = 1.0, 3.5  # radii of the pupil at the turning points of `pupil`, mm
_TURN = math.radians(75.0)  # largest angle of the lamp off the axis in `light`
_SWING = math.radians(50.0)  # of the camera to either side in `camera`
# `pigment` divides both melanins by the first number and multiplies them by it, or by more until
# they reach the second (mg/ml), with which a pale iris is dark too.
_FACTOR, _DARK = 8.0, 6.0


class ViewOptions(EyeWithPupil):
    light: list[str] | None = opt.option(
        "degrees from the eye's axis (0 to 180) and from the picture's right to its top; "
        "irradiance on what faces it, 3.14 lights a white sheet to white; repeatable; in place "
        "of the scene's lamps and environment",
        metavar="POLAR,AZIMUTH[,IRRADIANCE]",
    )
    camera: str | None = opt.option(
        "degrees as those of --light; width of the field at the pupil, mm",
        metavar="POLAR,AZIMUTH[,WIDTH]",
    )


class PictureOptions(opt.Group, panel="Picture"):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {"frames": ("animate", ())}

    size: str | None = opt.option("pixels, at most 16384 along a side", metavar="WIDTHxHEIGHT")
    exposure: float | str | None = opt.option(
        "factor on all radiances, 1 shows a white sheet white; or white, which exposes for the "
        "white of the eye",
        parse=opt.number_or("white", Range(0, math.inf, above=True)),
        metavar="number",
    )
    tone: str = opt.choice(
        "tone curve of a PNG or a movie: none is sRGB, agx keeps highlights from being clipped",
        ("none", "agx"),
        "none",
    )
    samples: int = opt.whole("along each side of a pixel, {}", Range(1, 8), 1)
    integrator: str | None = opt.option(
        "separable (ILIT, all orders of scattering), radiative-transfer (all orders, each light's "
        "direction; presets have pigments of their own) or single-scattering (marched as in F09); "
        "default: the scene's, separable",
        parse=opt.one_of(*INTEGRATORS),
        metavar="name",
    )
    bits: int = opt.option("8 or 16, of a PNG", 8, metavar="count")
    spectral: opt.Grid | None = opt.option(
        "nm: a layer each in place of RGB, .exr", parse=opt.Grid, metavar="START:STOP:STEP"
    )
    animate: str | None = opt.choice(
        ".gif, .mp4, numbered frames (frame_%03d.png), or one .png of all", _CHANGES
    )
    frames: int | None = opt.whole("of --animate, {}; default 24", Range(2, 1000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.animate is not None and self.spectral is not None:
            raise ValueError("--animate: not with --spectral")
        if self.spectral is not None and self.exposure == "white":
            raise ValueError("--exposure white: not with --spectral")
        if self.bits not in (8, 16):
            raise ValueError(f"--bits {self.bits} must be 8 or 16")

    @property
    def suffixes(self) -> tuple[str, ...]:
        if self.animate is not None:
            return ".gif", ".mp4", ".png"
        return (".png", ".exr") if self.spectral is None else (".exr",)


class PictureFile(opt.Group, panel="Files"):
    output: Path = opt.output(".png, .exr (linear); see --animate", "FILE.png", Path("eye.png"))
    overwrite: bool = opt.flag("replace a picture of that name")


@opt.grouped
def render_command(view: ViewOptions, picture: PictureOptions, files: PictureFile) -> None:
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
    if picture.tone != "none" and output.suffix == ".exr":
        raise ValueError("--tone is for PNG and movies; an EXR is linear")
    io.check_writable(output)
    first = io.first_file(output)
    if first.exists() and not files.overwrite and not io.is_device(first):
        raise ValueError(f"{first}: exists; --overwrite replaces it")
    file = view.read()
    if picture.spectral is not None and not view.light and "environment" in file.sections:
        raise ValueError(
            "--spectral needs lamps: an environment has colours, not spectra; give --light"
        )
    scene = view.scene_of(file, picture.integrator)
    scene = change_scene(scene, view.light, picture.size, view.camera)
    tinted = scene.lights is not None and scene.lights.tint is not None
    if picture.spectral is not None and tinted:
        raise ValueError(
            "--spectral needs plain lamps: a light's colour has no spectrum; give --light"
        )
    exposure = file.exposure if picture.exposure is None else picture.exposure
    if isinstance(exposure, str):
        exposure = exposure_of_white(scene)
    if picture.animate is not None:
        _render_movie(scene, file, picture, exposure, output)
    else:
        _render_still(scene, picture, exposure, output)


def missing_light_warning(scene: Scene) -> str | None:
    """Return a warning about light of a scene that its picture leaves out; `None` without any."""
    if not (scene.grazing() and reflects_inside(scene.eye)):
        return None
    return (
        "light that this cornea reflects on its inside is left out: 11 to 16 % of what reaches the "
        "iris from 120 degrees aside"
    )


def _render_still(scene: Scene, picture: PictureOptions, exposure: float, output: Path) -> None:
    if (warning := missing_light_warning(scene)) is not None:
        opt.notice(f"WARNING: {output}: {warning}")
    wavelengths = None if picture.spectral is None else tuple(map(float, picture.spectral.values))
    scene = scene.replace(wavelengths=wavelengths)
    height = scene.camera.size[1]
    remark = f"simulated by irisjax; integrator {integrator_name(scene.integrator)}"
    names = ("R", "G", "B") if wavelengths is None else io.spectral_channels(wavelengths)
    with tqdm(desc="preparing", total=height, unit="row", disable=None) as progress:
        bands_left = draw_bands(scene, cached_tables(scene), samples=picture.samples)
        first = next(bands_left)
        if first.error is not None:
            remark += f", response within {100 * first.error:.2g} %"
        progress.set_description("rendering")

        def bands():
            for band in itertools.chain([first], bands_left):
                yield band.pixels
                progress.update(len(band.pixels))

        pixels = _expose(bands(), exposure, output)
        if output.suffix == ".exr":
            io.write_exr(output, pixels, names, {"comments": remark}, rows=height)
        else:
            encoded = map(_TONE_CURVES[picture.tone], pixels)
            clipped = io.write_png(output, encoded, bits=picture.bits, remark=remark, rows=height)
            _warn_clipped(output, clipped, math.prod(scene.camera.size))


def _render_movie(
    scene: Scene, file: io.SceneFile, options: PictureOptions, exposure: float, output: Path
) -> None:
    change, count = options.animate or "", options.frames or 24
    remark = f"simulated by irisjax; {change}, {count} frames"
    pictures = animation_frames(scene, change, count, cached_tables, file.with_pupil)
    counted = tqdm(pictures, total=count, unit="frame", disable=None)
    encoded = map(_TONE_CURVES[options.tone], _expose(counted, exposure, output))
    if _is_sheet(output):
        clipped = io.write_png(output, contact_sheet(list(encoded)), remark=f"{remark} row by row")
    else:
        clipped = io.write_movie(output, encoded, remark=remark)
    _warn_clipped(output, clipped, count * math.prod(scene.camera.size))


def animation_frames(
    scene: Scene,
    change: str,
    count: int,
    tables_of: Callable[[Scene], Illumination | None] = Scene.tables,
    with_pupil: Callable[[Scene, float], Scene] = Scene.with_pupil,
) -> Iterator[np.ndarray]:
    """Draw the linear sRGB pictures of a loop, in which a part of the scene changes and returns."""

    def direction(s: float, largest: float) -> tuple[float, float]:
        return largest * abs(s), 0.0 if s >= 0 else math.pi

    def lamp(s: float) -> Lights:
        return Lights.distant(*direction(s, _TURN), illuminant=scene.illuminant)

    swing = np.cos(2 * np.pi * np.arange(count) / count)  # 1 to −1 and back
    if change == "light":
        scene = scene.replace(lights=lamp(1.0), environment=None)
    # The tables serve all frames: the lamp stays below grazing.
    scene, tables = prepare_scene(scene), tables_of(scene)
    view = project_visible(scene.eye, scene.camera, once=True)
    texels = texture(view, scene)
    light = illuminate(view, texels, scene, tables)
    response = respond(scene)
    melanin = float(scene.tissue.eumelanin + scene.tissue.pheomelanin)
    darkest = max(_FACTOR, _DARK / melanin) if melanin > 0 else _FACTOR
    for s in swing:
        if change == "pigment":
            iris, factor = scene.tissue, (darkest * _FACTOR) ** ((1 - s) / 2) / _FACTOR
            melanins = {n: factor * getattr(iris, n) for n in ("eumelanin", "pheomelanin")}
            response = respond(scene.replace(iris=iris.replace(**melanins)))
        elif change == "light":
            light = illuminate(view, texels, scene.replace(lights=lamp(s)), tables)
        elif change == "camera":
            polar, azimuth = direction(s, _SWING if scene.eye.lids is None else SEEN_FROM)
            camera = dataclasses.replace(scene.camera, polar=polar, azimuth=azimuth)
            view = project_visible(scene.eye, camera, once=True)
            texels = texture(view, scene)
            light = illuminate(view, texels, scene, tables)
        else:
            radius = (_NARROW + _WIDE) / 2 - (_WIDE - _NARROW) / 2 * s
            wider = prepare_scene(with_pupil(scene, radius))
            texels, response = texture(view, wider), respond(wider)
            light = illuminate(view, texels, wider, tables)
        yield np.asarray(shade(view, texels, light, response))


def contact_sheet(pictures: list[np.ndarray]) -> np.ndarray:
    """Arrange pictures row by row in a nearly square sheet."""
    columns = math.ceil(math.sqrt(len(pictures)))
    cells = [*pictures, *[np.zeros_like(pictures[0])] * (-len(pictures) % columns)]
    rows = (cells[i : i + columns] for i in range(0, len(cells), columns))
    return np.concatenate([np.concatenate(row, 1) for row in rows])


def _expose(pictures: Any, exposure: float, output: Path) -> Iterator[np.ndarray]:
    """Multiply pictures by an exposure, and warn in the end if all are black."""
    lightest = 0.0
    for pixels in pictures:
        lightest = max(lightest, exposure * float(np.max(pixels)))
        yield exposure * pixels
    if lightest <= 0:
        opt.notice(f"{output}: the picture is black: no light falls on what the camera sees")


def _warn_clipped(output: Path, clipped: int, count: int) -> None:
    if clipped:
        share = f"{100 * clipped / count:.2g} %"
        opt.notice(f"{output}: {clipped} pixels ({share}) out of sRGB's range are clipped")


_TONE_CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda picture: np.asarray(srgb_encode(picture)),
    "agx": lambda picture: np.asarray(agx_encode(picture)),
}


def _is_sheet(output: Path) -> bool:
    return output.suffix == ".png" and "%" not in output.name
