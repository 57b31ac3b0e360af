"""`irisjax paint`: a recipe of coats in, the painted eye and every coat out."""

import itertools
import os
import posixpath
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
from tqdm import tqdm

from irisjax import io
from irisjax.cli import options as opt
from irisjax.cli.compiled import cached_tables
from irisjax.cli.files import check_folder, check_is_folder, encode_picture
from irisjax.cli.paints import PaintOptions, check_no_seed
from irisjax.cli.render import contact_sheet
from irisjax.cli.scenes import change_scene, find_environment
from irisjax.export.mesh import FORMATS, painting_files
from irisjax.io.recipes import Recipe, recipe_text
from irisjax.io.sections import json_of
from irisjax.io.targets import TISSUE_MAPS, TISSUE_SCENE, Target, read_target, tissue_files
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range
from irisjax.numerics.streams import key_of
from irisjax.ocularist.coats import LIMBUS, PUPIL_RADIUS, Painting, over
from irisjax.ocularist.components import COMPONENTS
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.matching import match, retouch
from irisjax.ocularist.painting import OPACITY_SIZE, SCAN, painted, studio
from irisjax.ocularist.plan import difference, rolled, texture_of
from irisjax.ocularist.recipes import EYE_COLOURS
from irisjax.ocularist.recipes import coats as coats_of
from irisjax.ocularist.tissue import nearest_tissue
from irisjax.render.environment import ENVIRONMENTS
from irisjax.render.picture import draw, draw_bands
from irisjax.render.scene import Scene
from irisjax.tissue.iris import Iris

_RETOUCHES = 6  # coats that follow a target's pattern, by default
_SEARCH = 300  # evaluations of a match at most
_PICTURES = 12  # pictures of the progression at most
_SMALL = 320, 240
_COATS, _MESHES, _TISSUE = "coats", "meshes", "tissue"  # folders of a painted eye
# Names of files in the folder of a painted eye that only some eyes have.
_NAMES = [f"[0-9]*_{component}" for component in (*COMPONENTS, SCAN)]
_BODIES = itertools.product((*_NAMES, "cornea", "white"), (*FORMATS, "mtl", "png"))
_STALE_PATTERNS = (
    "match.png",
    "match.json",
    "retouch-[0-9]*.png",
    *(f"{_COATS}/{name}.png" for name in _NAMES),
    f"{_TISSUE}/{TISSUE_MAPS}",
    f"{_TISSUE}/{TISSUE_SCENE}",
    *(f"{_MESHES}/{name}.{suffix}" for name, suffix in _BODIES),
)


# A recipe, its scans by their files, contents of further files to write, and lines to print.
_Prepared = tuple[Recipe, dict[str, np.ndarray], dict[str, bytes], list[str]]


class PaintedEye(PaintOptions):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {"retouch": ("match", ())}

    seed: int = opt.seeded("coats of a --type")
    match: Path | None = opt.option(
        "folder of irisjax clone, scene file, or square picture of an iris laid flat: its pupil, "
        "and shares of paints and opacities fitted to it; with neither recipe nor --type: those of "
        "the nearest colour",
        metavar="TARGET",
    )
    retouch: int | None = opt.whole(
        f"with --match: coats on top that follow its pattern; default {_RETOUCHES}",
        Range(0, 30),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.painted(self.match is not None):
            raise ValueError("give a recipe or --type, one of them")
        if self.recipe is not None and self.match is None:
            check_no_seed(self.typed)


class PaintedPicture(opt.Group, panel="Picture"):
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
    folders = (_COATS, True), (_MESHES, results.meshes is not None), (_TISSUE, results.tissue)
    for name in (name for name, wanted in folders if wanted):
        check_is_folder(folder / name)
    # Wrong options are refused before the work.
    change_scene(Scene(Iris()), picture.light, picture.size, picture.camera)
    around = picture.environment
    with jax.enable_x64(False):  # as the picture is drawn
        environment = None if around is None else find_environment(around)
    recipe, scans, files, messages = _prepare(subject, picture.texels, folder)
    # Single precision takes half the memory, for the same picture to a few levels of 255.
    jax.config.update("jax_enable_x64", False)
    eye = recipe.eye()
    with subject.in_file():
        painting = painted(recipe.coats, recipe.mixer(), eye, size=picture.texels, scans=scans)
    scene = studio(painting, eye)
    scene = change_scene(scene, picture.light, picture.size, picture.camera)
    if environment is not None:
        scene = scene.replace(
            environment=environment, lights=scene.lights if picture.light else None
        )
    pictures = [f"{_COATS}/{coat.name.replace(' ', '_')}.png" for coat in painting.coats]
    mesh_files = {} if results.meshes is None else painting_files(painting, results.meshes, eye=eye)
    bodies = {f"{_MESHES}/{name}": data for name, data in mesh_files.items()}
    drawn = "eye.png", "progression.png", *pictures
    _check_inputs_kept(recipe, [folder / name for name in ("recipe.toml", *drawn, *bodies)])
    files |= {**bodies, "recipe.toml": recipe_text(recipe.moved(folder)).encode()}
    coats = (over(1.0, c.opacity[..., None], c.colour, 1.0) for c in painting.coats)
    linear_pictures = (*_draw_pictures(scene, painting, picture), *coats)
    for name, linear in zip(drawn, linear_pictures, strict=True):
        encoded = np.asarray(srgb_encode(linear))
        files[name] = encode_picture(folder / name, encoded, "painted and simulated by irisjax")
    if results.tissue:
        tissue = nearest_tissue(painting, eye)
        files |= {f"{_TISSUE}/{name}": data for name, data in tissue_files(tissue, eye).items()}
        left = f"{tissue.left.mean:.1f} ({tissue.left.q95:.1f})"
        messages.append(f"mean colour difference (95 % below) of the nearest tissue: {left}")
    written = {folder / name: data for name, data in files.items()}
    for path in {path.parent for path in written}:
        path.mkdir(parents=True, exist_ok=True)
    io.write_together(written)
    _remove_stale(folder, recipe, written)
    print(*messages, f"{len(painting.coats)} coats; written: {folder}", sep="\n")


def _prepare(subject: PaintedEye, size: int, folder: Path) -> _Prepared:
    """Return the recipe, matched to a target if there is one."""
    has_recipe = subject.recipe is not None or subject.type is not None
    recipe = subject.read(subject.seed) if has_recipe else None
    if subject.match is None:
        assert recipe is not None
        with subject.in_file():
            return recipe, recipe.scans(), {}, []
    pupil_radius = subject.pupil_radius or (PUPIL_RADIUS if recipe is None else recipe.pupil_radius)
    target = read_target(subject.match, pupil_radius / LIMBUS)
    if subject.pupil_radius is not None and not np.isclose(target.pupil * LIMBUS, pupil_radius):
        raise ValueError(f"--pupil-radius: {subject.match} has a pupil of its own")
    if recipe is None:
        recipe = subject.changed(_nearest_colour(target, subject.seed))
    count = _RETOUCHES if subject.retouch is None else subject.retouch
    with subject.in_file():
        return _match(target, recipe, folder, count, size, key_of(subject.seed))


def _nearest_colour(target: Target, seed: int) -> Recipe:
    """Return the default coats of the eye colour that differs least from the target."""
    by_difference = {}
    for colour in EYE_COLOURS:
        recipe = Recipe(coats_of("detail", colour, seed=seed), pupil_radius=target.pupil * LIMBUS)
        eye = recipe.eye()
        painting = painted(recipe.coats, recipe.mixer(), eye, size=128)
        texture = texture_of(painting, eye, target.known.shape)
        by_difference[difference(texture, target.texture, target.known).mean] = recipe
    return by_difference[min(by_difference)]


def _match(
    target: Target, recipe: Recipe, folder: Path, count: int, size: int, key: jax.Array
) -> _Prepared:
    """Match a recipe to a target, and add `count` coats whose scans are written to `folder`."""
    recipe = recipe._replace(pupil_radius=target.pupil * LIMBUS)
    eye, mixer, scans, known = recipe.eye(), recipe.mixer(), recipe.scans(), target.known
    arguments = mixer, eye, target.texture
    options = {"scans": scans, "size": size}
    fitted = match(recipe.coats, *arguments, known, **options, max_steps=_SEARCH, key=key)
    if not fitted.converged:
        opt.notice(f"the match was stopped after {fitted.steps} steps")
    relative = Path(os.path.relpath(folder, recipe.folder)).as_posix()
    prefix = posixpath.normpath(posixpath.join(relative, "retouch-"))
    # Hidden texels are painted with the mean of their radius.
    retouched = retouch(fitted.recipes, *arguments, count=count, prefix=prefix, **options)
    combined = recipe._replace(coats=(*fitted.recipes, *retouched.recipes))
    textures = [
        texture_of(painted(coats, mixer, eye, size=size, scans=retouched.scans), eye, known.shape)
        for coats in (fitted.recipes, combined.coats)
    ]
    final = difference(textures[1], target.texture, known)
    steps = {"before": fitted.before, "matched": fitted.after, "retouched": final}
    measure = {"measure": "CIE 1976 dE*ab, D65"}
    summary = {
        "target": target.name,
        "colour_difference": {name: d._asdict() | measure for name, d in steps.items()},
        "steps": fitted.steps,
        "converged": fitted.converged,
    }
    flat = []  # the textures as the iris laid flat
    for texture in (target.texture, *textures):
        row, column, on = rolled(texture.shape[:2], eye, size)
        flat.append(np.where(on[..., None], np.asarray(srgb_encode(texture))[row, column], 0))
    pictures = {"match.png": np.concatenate(flat, 1)}
    for name in retouched.scans.keys() - scans.keys():
        pictures[posixpath.basename(name)] = np.repeat(retouched.scans[name][..., None], 3, 2)
    remark = "painted by irisjax to match a target"
    files = {
        name: encode_picture(folder / name, pixels, remark) for name, pixels in pictures.items()
    }
    files["match.json"] = json_of(summary, 17)
    stages = "as it was", "matched", f"with {len(retouched.recipes)} coats on top"
    differences = "; ".join(
        f"{w} {d.mean:.1f} ({d.q95:.1f})" for w, d in zip(stages, steps.values(), strict=True)
    )
    measured = "mean colour difference (95 % below), CIE 1976, flat and in plain light"
    return combined, retouched.scans, files, [f"{measured}: {differences}"]


def _draw_pictures(
    scene: Scene, painting: Painting, picture: PaintedPicture
) -> tuple[np.ndarray, np.ndarray]:
    """Draw the linear picture and the sheet of its progress; most memory is freed on return."""
    painted_by = partial(Painted, as_printed=picture.shadow == "as-printed")
    counts = _progress_counts(len(painting.coats))
    with tqdm(total=1 + len(counts), unit="picture", disable=None) as bar:
        scene = scene.replace(integrator=painted_by(painting=painting))
        tables = cached_tables(scene)
        bands = draw_bands(scene, tables, samples=picture.samples)
        whole_eye = np.concatenate([band.pixels for band in bands])
        bar.update()
        small, steps = scene.replace(camera=replace(scene.camera, size=_SMALL)), []
        for count in counts:
            integrator = painted_by(painting=Painting(painting.coats[:count], painting.profile))
            steps.append(np.asarray(draw(small.replace(integrator=integrator), tables)))
            bar.update()
    return whole_eye, contact_sheet(steps)


def _progress_counts(count: int) -> list[int]:
    """Choose the numbers of coats, up to `count`, after which the progress is shown."""
    return sorted({round(1 + i * (count - 1) / (_PICTURES - 1)) for i in range(_PICTURES)})


def _check_inputs_kept(recipe: Recipe, written: Iterable[Path]) -> None:
    """Raise `ValueError` where an artist's scan or paints of the recipe would be overwritten."""
    targets = {os.path.realpath(path): path for path in written}
    for path in _input_files(recipe) & targets.keys():
        raise ValueError(
            f"{targets[path]}: the recipe paints with this file, which would be overwritten; "
            "give another folder"
        )


def _remove_stale(folder: Path, recipe: Recipe, written: Iterable[Path]) -> None:
    """Remove files of a replaced eye that are neither `written` now nor used by the recipe."""
    spared = {os.path.realpath(path) for path in written} | _input_files(recipe)
    for path in itertools.chain(*(folder.glob(pattern) for pattern in _STALE_PATTERNS)):
        if os.path.realpath(path) not in spared:
            path.unlink()
    for name in (_COATS, _MESHES, _TISSUE):
        if (folder / name).is_dir() and not any((folder / name).iterdir()):
            (folder / name).rmdir()


def _input_files(recipe: Recipe) -> set[str]:
    names = recipe.scan_files() | {name for name in (recipe.paints,) if name is not None}
    return {os.path.realpath(recipe.folder / name) for name in names}
