"""The scene that a command takes: a file or a preset, and what the options change of it."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from irisjax.anatomy import eye
from irisjax.cli.options import SEED_HELP, Group, option, range_parser, read_seed
from irisjax.grow.presets import PRESETS
from irisjax.io.images import read_environment
from irisjax.io.scenes import SceneFile, parse_scene, read_scene
from irisjax.render import scene as staging
from irisjax.render.environment import ENVIRONMENTS, Environment
from irisjax.render.lights import Lights

_PUPIL = eye.EYE_LIMITS["pupil_radius"]


@dataclass(frozen=True, kw_only=True)
class Subject(Group):
    """Which eye."""

    PANEL = "What"

    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE",
            help="scene file (TOML); data/scenes/everything.toml explains it",
            show_default=False,
        ),
    ] = None
    preset: Annotated[
        str | None, option(metavar="name", help=f"{', '.join(PRESETS)}: an eye in a studio")
    ] = None
    seed: Annotated[
        int,
        option(parse=read_seed, metavar="number", help=f"{SEED_HELP}maps of a preset"),
    ] = 0

    def __post_init__(self):
        super().__post_init__()
        if "seed" in self.typed and self.scene is not None:
            raise ValueError("--seed is for what has no file: a scene file says its own")

    def read(self) -> SceneFile:
        """The scene of the file, or of the preset in a studio."""
        return scene_file(self.scene, self.preset, self.seed)


@dataclass(frozen=True, kw_only=True)
class EyeWithPupil(Subject):
    """Which eye, its pupil how wide."""

    pupil_radius: Annotated[
        float | None,
        option(parse=range_parser(_PUPIL), metavar="MM", help=f"{_PUPIL.low:g} to {_PUPIL.high:g}"),
    ] = None


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


def changed(
    scene: staging.Scene,
    light: list[str] | None = None,
    pupil_radius: float | None = None,
    size: str | None = None,
    camera: str | None = None,
) -> staging.Scene:
    """A scene with lamps, pupil (mm), picture size or camera as the options write them."""
    if light:
        scene = scene.replace(lights=lamps(light, scene.illuminant), environment=None)
    if pupil_radius is not None:
        scene = scene.replace(eye=scene.eye.replace(pupil_radius=pupil_radius))
    if size is not None:
        width, cross, height = size.partition("x")
        if not (cross and width.isdecimal() and height.isdecimal()):
            raise ValueError(f"--size {size!r}: write WIDTHxHEIGHT, such as 800x600")
        if not all(1 <= int(side) <= 16384 for side in (width, height)):
            raise ValueError(f"--size {size}: must be from 1 to 16384 along a side")
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


def environment_of(text: str) -> Environment:
    """An environment by its name in `ENVIRONMENTS`, else from a panorama's file."""
    if text in ENVIRONMENTS:
        return ENVIRONMENTS[text](rows=512)
    if not Path(text).suffix:
        known = ", ".join(ENVIRONMENTS)
        raise ValueError(f"unknown environment {text!r}; known: {known}, and panoramas' files")
    return read_environment(text)


def lamps(texts: list[str], illuminant: str = "D65") -> Lights:
    """Lamps as `--light` writes them."""
    joined, *others = (_lamp(text, illuminant) for text in texts)
    for lamp in others:
        joined = joined + lamp
    return joined


def _lamp(text: str, illuminant: str) -> Lights:
    polar, azimuth, irradiance = _angles("--light", text, "IRRADIANCE", math.pi)
    try:
        return Lights.distant(polar, azimuth, irradiance, illuminant=illuminant)
    except ValueError as error:
        raise ValueError(f"--light {text!r}: {error}") from None


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
