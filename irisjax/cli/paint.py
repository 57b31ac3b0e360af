"""`irisjax paint`: a recipe of coats in, the painted eye and every coat out."""

import itertools
import os
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
from tqdm import tqdm

from irisjax import io
from irisjax.cli import matching
from irisjax.cli import options as opt
from irisjax.cli.animate import sheet
from irisjax.cli.compiled import kept_tables
from irisjax.cli.files import check_folder, check_is_folder, png_of
from irisjax.cli.paints import PaintOptions, check_no_seed, of_file
from irisjax.cli.scenes import changed, environment_of
from irisjax.export.mesh import FORMATS, painting_files
from irisjax.io.recipes import Recipe, recipe_text
from irisjax.io.targets import TISSUE_MAPS, TISSUE_SCENE, read_target, tissue_files
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range
from irisjax.ocularist.coats import LIMBUS, PUPIL_RADIUS, Painting, over
from irisjax.ocularist.components import COMPONENTS
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.painting import OPACITY_SIZE, SCAN, painted, studio
from irisjax.ocularist.tissue import nearest_tissue
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.picture import draw, draw_bands
from irisjax.render.scene import Scene

_STEPS = 12  # pictures of the progression at most
_SMALL = 320, 240
_COATS, _MESHES, _TISSUE = "coats", "meshes", "tissue"  # folders of a painted eye
# Files of a painted eye that only some eyes have, in its folder.
_NAMES = [f"[0-9]*_{component}" for component in (*COMPONENTS, SCAN)]
_BODIES = itertools.product((*_NAMES, "cornea", "white"), (*FORMATS, "mtl", "png"))
_OF_AN_EYE = (
    matching.MATCH,
    matching.DIFFERENCES,
    f"{matching.RETOUCH}[0-9]*.png",
    *(f"{_COATS}/{name}.png" for name in _NAMES),
    f"{_TISSUE}/{TISSUE_MAPS}",
    f"{_TISSUE}/{TISSUE_SCENE}",
    *(f"{_MESHES}/{name}.{suffix}" for name, suffix in _BODIES),
)


class PaintedEye(PaintOptions):
    """Which eye."""

    ONLY_WITH: ClassVar = {"retouch": ("match", ())}

    recipe: Path | None = opt.argument("coats of paint (TOML)", "RECIPE")
    seed: int = opt.seeded("coats of a --type")
    match: Path | None = opt.option(
        "folder of irisjax clone, scene file, or square picture of an iris laid flat: its pupil, "
        "and shares of paints and opacities fitted to it; with neither recipe nor --type: those of "
        "the nearest colour",
        metavar="TARGET",
    )
    retouch: int | None = opt.whole(
        f"with --match: coats on top that follow its pattern; default {matching.RETOUCHES}",
        Range(0, 30),
    )

    def __post_init__(self):
        super().__post_init__()
        if not self.painted(self.recipe, self.match is not None):
            raise ValueError("give a recipe or --type, one of them")
        if self.recipe is not None and self.match is None:
            check_no_seed(self.typed)


class PaintedPicture(opt.Group, panel="Picture"):
    """How it is drawn."""

    light: list[str] | None = opt.option(
        "as of render; repeatable; in place of two lamps", metavar="POLAR,AZIMUTH[,IRRADIANCE]"
    )
    environment: str | None = opt.option(
        f"{', '.join(ENVIRONMENTS)}, or a latitude-longitude panorama; in place of lamps, or "
        "beside those of --light",
        metavar="NAME|FILE",
    )
    camera: str | None = opt.option("as of render", metavar="POLAR,AZIMUTH[,WIDTH]")
    size: str | None = opt.option("pixels; default 800x600", metavar="WIDTHxHEIGHT")
    samples: int = opt.whole("along each side of a pixel, {}", Range(1, 8), 1)
    texels: int = opt.whole("along a side of opacity maps", Range(64, 4096), OPACITY_SIZE)
    shadow: str = opt.choice(
        "shadows; as-printed: by the paper's Eq. 2 as it stands there",
        ("tinted", "as-printed"),
        "tinted",
    )


class PaintedFiles(opt.Group, panel="Files"):
    """Where it goes."""

    output: Path = opt.output("folder for the eye", "DIR", ...)
    meshes: str | None = opt.choice(
        "a mesh of every coat, of cornea and white, in meshes/", FORMATS
    )
    tissue: bool = opt.flag("the nearest tissue, in tissue/: maps and a scene file")
    overwrite: bool = opt.flag("replace a painted eye in that folder")


@opt.grouped
def paint_command(subject: PaintedEye, picture: PaintedPicture, results: PaintedFiles) -> None:
    """Paint an eye in semi-transparent coats, as ocularists do.

    For example: irisjax paint --type detail --colour blue -o blue_eye

    Writes the picture (eye.png), its progress from the base up (progression.png), every coat
    (coats/) and the recipe as it was used (recipe.toml). No physics of tissue: paint.
    With --match also the target and its match laid flat (match.png) and how far apart their
    colours are (match.json).
    """
    folder = results.output
    check_folder(folder, "recipe.toml", "a painted eye", results.overwrite)
    asked = (_COATS, True), (_MESHES, results.meshes is not None), (_TISSUE, results.tissue)
    for name in (name for name, wanted in asked if wanted):
        check_is_folder(folder / name)
    recipe, scans, more, messages = _prepared(subject, picture.texels, folder)
    # Half the memory of double precision, and the same picture to a few levels of 255.
    jax.config.update("jax_enable_x64", False)
    eye = recipe.eye()
    with of_file(subject.recipe):
        painting = painted(recipe.coats, recipe.mixer(), eye, size=picture.texels, scans=scans)
    scene = studio(painting, eye)
    scene = changed(scene, picture.light, None, picture.size, picture.camera)
    if picture.environment is not None:
        around = environment_of(picture.environment)
        scene = scene.replace(environment=around, lights=scene.lights if picture.light else None)
    files = {folder / name: data for name, data in more.items()}
    names = [coat.name for coat in painting.coats]
    pictures = [folder / _COATS / f"{name.replace(' ', '_')}.png" for name in names]
    made = {} if results.meshes is None else painting_files(painting, results.meshes, eye=eye)
    bodies = {folder / _MESHES / name: data for name, data in made.items()}
    own = [folder / name for name in ("recipe.toml", "eye.png", "progression.png")]
    _check_spared(recipe, {*own, *pictures, *bodies})
    files |= bodies
    files[folder / "recipe.toml"] = recipe_text(recipe.moved(folder)).encode()
    drawn = _drawn(scene, painting, picture)
    remark = "painted and simulated by irisjax"
    for name, linear in zip(("eye.png", "progression.png"), drawn, strict=True):
        files[folder / name] = png_of(folder / name, np.asarray(srgb_encode(linear)), remark)
    for path, coat in zip(pictures, painting.coats, strict=True):
        on_white = over(1.0, coat.opacity[..., None], coat.colour, 1.0)
        files[path] = png_of(path, np.asarray(srgb_encode(on_white)), remark)
    if results.tissue:
        alike = nearest_tissue(painting, eye)
        files |= {folder / _TISSUE / n: data for n, data in tissue_files(alike, eye).items()}
        messages.append(
            f"mean colour difference (95 % below) of the nearest tissue: {alike.left.mean:.1f} "
            f"({alike.left.q95:.1f})"
        )
    for path in {path.parent for path in files}:
        path.mkdir(parents=True, exist_ok=True)
    io.write_together(files)
    _remove_left_over(folder, recipe, files)
    print(*messages, f"{len(painting.coats)} coats; written: {folder}", sep="\n")


def _prepared(subject: PaintedEye, size: int, folder: Path) -> matching.Matched:
    """The recipe, matched if that is asked for."""
    given = subject.recipe is not None or subject.type is not None
    recipe = subject.read(subject.recipe, subject.seed) if given else None
    if subject.match is None:
        assert recipe is not None
        with of_file(subject.recipe):
            return matching.Matched(recipe, recipe.scans(), {}, [])
    asked = subject.pupil_radius or (PUPIL_RADIUS if recipe is None else recipe.pupil_radius)
    target = read_target(subject.match, asked / LIMBUS)
    if subject.pupil_radius is not None and not np.isclose(target.pupil * LIMBUS, asked):
        raise ValueError(f"--pupil-radius: {subject.match} has a pupil of its own")
    if recipe is None:
        recipe = subject.changed(matching.nearest_colour(target, subject.seed))
    count = matching.RETOUCHES if subject.retouch is None else subject.retouch
    how = {"count": count, "size": size, "seed": subject.seed}
    with of_file(subject.recipe):
        return matching.matched(target, recipe, folder, **how)


def _drawn(
    scene: Scene, painting: Painting, picture: PaintedPicture
) -> tuple[np.ndarray, np.ndarray]:
    """The picture and the sheet of its progress, linear. The cached steps, most of the command's
    memory, are freed on return.
    """

    def of(scene: Scene, part: Painting) -> Scene:
        as_printed = picture.shadow == "as-printed"
        return scene.replace(integrator=Painted(painting=part, as_printed=as_printed))

    shown = _shown(len(painting.coats))
    with tqdm(total=1 + len(shown), unit="picture", disable=not sys.stderr.isatty()) as bar:
        scene = of(scene, painting)
        tables = kept_tables(scene)
        parts = draw_bands(scene, tables, samples=picture.samples)
        whole_eye = np.concatenate([band.pixels for band in parts])
        bar.update()
        small, steps = scene.replace(camera=replace(scene.camera, size=_SMALL)), []
        for count in shown:
            part = of(small, Painting(painting.coats[:count], painting.profile))
            steps.append(np.asarray(draw(part, tables)))
            bar.update()
    return whole_eye, sheet(steps)


def _shown(count: int) -> list[int]:
    """Numbers of coats, up to `count`, after which the progress is shown."""
    return sorted({round(1 + i * (count - 1) / (_STEPS - 1)) for i in range(_STEPS)})


def _check_spared(recipe: Recipe, written: Iterable[Path]) -> None:
    """Raise `ValueError` where files to be `written` are pictures or paints that the recipe uses:
    the recipe as used could not be painted again, and an artist's scan would be lost.
    """
    places = {os.path.realpath(path): path for path in written}
    for path in _needed(recipe) & places.keys():
        raise ValueError(
            f"{places[path]}: the recipe paints with this file, which would be overwritten; "
            "give another folder"
        )


def _remove_left_over(folder: Path, recipe: Recipe, written: Iterable[Path]) -> None:
    """Remove the files of a replaced eye, recognised by their names, that are neither `written` now
    nor used by the recipe.
    """
    kept = {os.path.realpath(path) for path in written} | _needed(recipe)
    for path in itertools.chain(*(folder.glob(pattern) for pattern in _OF_AN_EYE)):
        if os.path.realpath(path) not in kept:
            path.unlink()
    for name in (_COATS, _MESHES, _TISSUE):
        if (folder / name).is_dir() and not any((folder / name).iterdir()):
            (folder / name).rmdir()


def _needed(recipe: Recipe) -> set[str]:
    names = recipe.scan_files() | ({recipe.paints} if recipe.paints is not None else set())
    return {os.path.realpath(recipe.folder / name) for name in names}
