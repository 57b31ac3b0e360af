"""The scene of a command: a file or a preset, with changes by options."""

import dataclasses
import functools
import math
import operator
from pathlib import Path
from typing import Any

from irisjax.anatomy import eye
from irisjax.cli import options as opt
from irisjax.grow.presets import PRESETS
from irisjax.grow.vessels import VEINS
from irisjax.io.images import read_environment
from irisjax.io.scenes import SceneFile, parse_scene, read_scene
from irisjax.photo.photograph import Ellipse
from irisjax.render import scene as staging
from irisjax.render.environment import ENVIRONMENTS, Environment
from irisjax.render.lights import Lights

_STUDIO = '[iris]\npreset = "{}"\n[maps]\nseed = {}\n[environment]\nkind = "studio"'


class Subject(opt.Group, panel="What"):
    scene: Path | None = opt.argument(
        "scene file (TOML); data/scenes/everything.toml explains it", "SCENE"
    )
    preset: str | None = opt.choice("an eye in a studio", PRESETS)
    seed: int = opt.seeded("maps of a preset")
    veins: str | None = opt.choice("vessels of the white", VEINS)
    limbal_ring: float | None = opt.number(
        "{}: share of the light that the dark ring at the limbus takes", eye.EYE_LIMITS["darkening"]
    )
    lids: bool = opt.flag("lids, lashes and skin round the eye")
    no_residual: bool = opt.flag("a clone as its pigments alone make it, without the map residual")

    def __post_init__(self) -> None:
        super().__post_init__()
        if "seed" in self.typed and self.scene is not None:
            raise ValueError("--seed is for what has no file: a scene file says its own")
        if self.no_residual and self.scene is None:
            raise ValueError("--no-residual is for a SCENE file, of a clone: give one")

    def read(self) -> SceneFile:
        """Read the scene of the file, or make that of the preset in a studio."""
        if self.scene is not None:
            if self.preset is not None:
                raise ValueError("give a SCENE file or --preset, not both")
            return self.changing(read_scene(self.scene))
        if self.preset is None:
            raise ValueError("give a SCENE file or --preset")
        studio = _STUDIO.format(self.preset, self.seed)
        return self.changing(parse_scene(studio, f"preset {self.preset}"))

    def changing(self, file: SceneFile) -> SceneFile:
        entries = {"veins": self.veins, "limbal_ring": self.limbal_ring}
        file = file.with_entries("eye", **{k: v for k, v in entries.items() if v is not None})
        file = file.with_entries("lids") if self.lids else file
        return file.with_entries("maps", residual=False) if self.no_residual else file


class EyeWithPupil(Subject):
    pupil_radius: float | None = opt.number("{}", eye.EYE_LIMITS["pupil_radius"])

    def scene_of(self, file: SceneFile, integrator: str | None) -> staging.Scene:
        """Return the scene of a file, with the option's pupil."""
        scene = file.scene(integrator)
        return scene if self.pupil_radius is None else file.with_pupil(scene, self.pupil_radius)


def change_scene(
    scene: staging.Scene,
    light: list[str] | None = None,
    size: str | None = None,
    camera: str | None = None,
) -> staging.Scene:
    """Replace lamps, picture size or camera of a scene by those of the options."""
    if light:
        scene = scene.replace(lights=parse_lamps(light, scene.illuminant), environment=None)
    changes: dict[str, Any] = {} if size is None else {"size": _parse_size(size)}
    if camera is not None:
        angles = _parse_angles("--camera", camera, "WIDTH", float(scene.camera.width))
        changes |= dict(zip(("polar", "azimuth", "width"), angles, strict=True))
    try:
        return scene.replace(camera=dataclasses.replace(scene.camera, **changes))
    except ValueError as error:
        raise ValueError(f"--camera {camera!r}: {error}") from None


def find_environment(text: str) -> Environment:
    """Return an environment by its name in `ENVIRONMENTS`, else from a panorama's file."""
    if text in ENVIRONMENTS:
        return ENVIRONMENTS[text](rows=512)
    if not Path(text).suffix:
        known = ", ".join(ENVIRONMENTS)
        raise ValueError(f"unknown environment {text!r}; known: {known}, and panoramas' files")
    return read_environment(text)


def parse_lamps(texts: list[str], illuminant: str = "D65") -> Lights:
    """Parse the lamps of `--light`."""
    lights = []
    for text in texts:
        angles = _parse_angles("--light", text, "IRRADIANCE", math.pi)
        try:
            lights.append(Lights.distant(*angles, illuminant=illuminant))
        except ValueError as error:
            raise ValueError(f"--light {text!r}: {error}") from None
    return functools.reduce(operator.add, lights)


def parse_outline(name: str, text: str | None) -> Ellipse | None:
    """Parse the outline of `--limbus` or `--pupil`."""
    if text is None:
        return None
    if len(numbers := opt.numbers(text)) != 5:
        raise ValueError(f"{name} {text!r}: write X,Y,A,B,DEG, five numbers")
    x, y, a, b, degrees = numbers
    if not (a >= b > 0 and all(map(math.isfinite, numbers))):
        raise ValueError(f"{name} {text!r}: the semi-axes must be A >= B > 0")
    return Ellipse((x, y), (a, b), math.radians(degrees))


def _parse_size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size {text!r}: write WIDTHxHEIGHT, such as 800x600")
    if not all(1 <= int(side) <= 16384 for side in (width, height)):
        raise ValueError(f"--size {text}: must be from 1 to 16384 along a side")
    return int(width), int(height)


def _parse_angles(option: str, text: str, third: str, default: float) -> tuple[float, float, float]:
    """Parse polar angle and azimuth, radians, and a third number, which may be left out."""
    numbers = opt.numbers(text)
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{option} {text!r}: write POLAR,AZIMUTH or POLAR,AZIMUTH,{third}")
    if not 0 <= numbers[0] <= 180:
        raise ValueError(f"{option} {text!r}: the polar angle must be from 0 to 180 degrees")
    return math.radians(numbers[0]), math.radians(numbers[1]), (*numbers, default)[2]
