"""`irisjax paint`: a recipe of coats in, the painted eye and every coat out."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import typer
from tqdm import tqdm

from irisjax import io
from irisjax.anatomy.eye import Eye
from irisjax.cli.animate import sheet
from irisjax.cli.cache import cores, kept_tables
from irisjax.cli.files import check_folder
from irisjax.cli.options import SEED_HELP, Group, grouped, name_of, option, read_seed, whole
from irisjax.cli.paints import Paints, of_file
from irisjax.cli.scenes import changed
from irisjax.export.coats import FORMATS, write_painting
from irisjax.io.images import encode_png
from irisjax.io.recipes import Recipe, recipe_text
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.programs import program
from irisjax.ocularist.coats import Coat, Painting, over
from irisjax.ocularist.easel import SIZE, painted, studio
from irisjax.ocularist.integrator import Painted
from irisjax.render.scene import Scene
from irisjax.render.stages import Memory
from irisjax.render.tiles import bands

_STEPS = 12  # pictures of the progression at most
_SMALL = 320, 240
_SHADOWS = "tinted", "as-printed"


@dataclass(frozen=True, kw_only=True)
class Subject(Paints):
    """Which eye."""

    recipe: Annotated[
        Path | None,
        typer.Argument(metavar="RECIPE", help="coats of paint (TOML)", show_default=False),
    ] = None
    seed: Annotated[
        int, option(parse=read_seed, metavar="number", help=f"{SEED_HELP}coats of a --type")
    ] = 0

    def __post_init__(self):
        super().__post_init__()
        if not self.painted(self.recipe):
            raise ValueError("give a recipe or --type, one of them")


@dataclass(frozen=True, kw_only=True)
class Picture(Group):
    """How it is drawn."""

    PANEL = "Picture"

    light: Annotated[
        list[str] | None,
        option(
            metavar="POLAR,AZIMUTH[,IRRADIANCE]",
            help="as of render; repeatable; in place of two lamps",
        ),
    ] = None
    camera: Annotated[str | None, option(metavar="POLAR,AZIMUTH[,WIDTH]", help="as of render")] = (
        None
    )
    size: Annotated[str | None, option(metavar="WIDTHxHEIGHT", help="pixels; default 800x600")] = (
        None
    )
    samples: Annotated[
        int, option(parse=whole(1, 8), metavar="count", help="along each side of a pixel, 1 to 8")
    ] = 1
    texels: Annotated[
        int, option(parse=whole(64, 4096), metavar="count", help="along a side of opacity maps")
    ] = SIZE
    shadow: Annotated[
        str,
        name_of("shadows; as-printed: by the paper's Eq. 2 as it stands there", *_SHADOWS),
    ] = "tinted"


@dataclass(frozen=True, kw_only=True)
class Results(Group):
    """Where it goes."""

    PANEL = "Files"

    output: Annotated[Path, option("-o", "--output", metavar="DIR", help="folder for the eye")]
    meshes: Annotated[
        str | None,
        option(metavar="name", help=f"{', '.join(FORMATS)}: a mesh of every coat, in meshes/"),
    ] = None
    overwrite: Annotated[
        bool, option("--overwrite", metavar="", help="replace a painted eye in that folder")
    ] = False

    def __post_init__(self):
        super().__post_init__()
        if self.meshes is not None and self.meshes not in FORMATS:
            raise ValueError(f"--meshes: unknown {self.meshes!r}; known: {', '.join(FORMATS)}")


@grouped
def paint(subject: Subject, picture: Picture, results: Results) -> None:
    """An eye painted in semi-transparent coats, as ocularists make them.

    For example: irisjax paint --type detail --colour blue -o blue_eye

    Writes the picture (eye.png), its progress from the base up (progression.png), every coat
    (coats/) and the recipe as it was used (recipe.toml). No physics of tissue: paint.
    """
    folder = results.output
    check_folder(folder, "recipe.toml", "a painted eye", results.overwrite)
    # Half the memory of double precision, and the same picture to a few levels of 255.
    jax.config.update("jax_enable_x64", False)
    recipe = subject.read(subject.recipe, subject.seed)
    eye = recipe.eye()
    painting = _painted(subject, recipe, eye, picture.texels)
    scene = studio(painting, eye)
    scene = changed(scene, picture.light, None, picture.size, picture.camera)
    scene = _with(scene, painting, picture.shadow)
    files = {folder / "recipe.toml": recipe_text(recipe.moved(folder)).encode()}
    shown = _shown(painting)
    with tqdm(total=1 + len(shown), unit="picture", disable=not sys.stderr.isatty()) as bar:
        tables = kept_tables(scene)
        parts = bands(scene, tables, samples=picture.samples, threads=cores())
        whole_eye = np.concatenate([band.pixels for band in parts])
        bar.update()
        steps = []
        small = scene.replace(camera=replace(scene.camera, size=_SMALL))
        memory = Memory(cores())
        for count in shown:
            part = Painting(painting.coats[:count], painting.profile)
            part = _with(small, part, picture.shadow)
            steps.append(np.asarray(memory.render(part, tables)))
            bar.update()
    remark = "painted and simulated by irisjax"
    for name, linear in (("eye.png", whole_eye), ("progression.png", sheet(steps))):
        path = folder / name
        files[path], clipped = encode_png(path, np.asarray(_encode(linear)), remark=remark)
        if clipped:
            print(
                f"irisjax: {path}: {clipped} pixels out of sRGB's range are clipped",
                file=sys.stderr,
            )
    for coat in painting.coats:
        path = folder / "coats" / f"{coat.name.replace(' ', '_')}.png"
        files[path] = encode_png(path, _on_white(coat), remark=remark)[0]
    for name in ("coats",) if results.meshes is None else ("coats", "meshes"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    io.write_together(files)
    if results.meshes is not None:
        write_painting(folder / "meshes", painting, results.meshes)
    print(f"{len(painting.coats)} coats; written: {folder}")


_encode = program(srgb_encode)


def _painted(subject: Subject, recipe: Recipe, eye: Eye, size: int) -> Painting:
    mixer, scans = recipe.mixer(), recipe.scans()
    with of_file(subject.recipe):
        return painted(recipe.coats, mixer, eye, size=size, scans=scans)


def _with(scene: Scene, painting: Painting, shadow: str) -> Scene:
    return scene.replace(integrator=Painted(painting=painting, as_printed=shadow == "as-printed"))


def _shown(painting: Painting) -> list[int]:
    """Numbers of coats after which the progress is shown."""
    count = len(painting.coats)
    return sorted({round(1 + i * (count - 1) / (_STEPS - 1)) for i in range(_STEPS)})


def _on_white(coat: Coat) -> np.ndarray:
    """A coat as it lies on white paper, encoded."""
    return np.asarray(_encode(over(1.0, coat.opacity[..., None], coat.colour, 1.0)))
