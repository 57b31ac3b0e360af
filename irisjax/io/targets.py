"""Paint and other kinds of eye in files: targets that paint is matched to, and paint as tissue."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.io.clone_folders import check_summary
from irisjax.io.clones import UNREFRACTED_PICTURE, VISIBLE_MASK
from irisjax.io.images import READABLE, read_image
from irisjax.io.maps import encode_maps
from irisjax.io.scenes import read_scene, scene_text
from irisjax.ocularist.plan import TEXTURE_SHAPE
from irisjax.ocularist.tissue import Tissue, reflectance_of
from irisjax.photo.texture import HALF_WIDTH, to_polar
from irisjax.render.integrators import integrator_name
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable

TISSUE_MAPS, TISSUE_SCENE = "maps.exr", "scene.toml"
"""Names of the files of a painted eye as tissue."""

_WHOLE = 0.999  # least share of a cell that has to be visible


class Target(NamedTuple):
    """A target for paint, with the name of its file or folder.

    Attributes:
        texture: Linear reflectance, polar as in `IrisMaps`.
        known: Texels that show the iris; the others have the mean of the known ones of the nearest
            radius that has some.
        pupil: Radius of the pupil over the iris's.
    """

    name: str
    texture: Float[np.ndarray, "angles radii 3"]
    known: Bool[np.ndarray, "angles radii"]
    pupil: float


def read_target(path: str | Path, pupil: float) -> Target:
    """Read a target: the folder of `irisjax clone` (the iris laid flat, as photographed); a scene
    file (the reflectance of its tissue without the cornea, times the scene's exposure); or a square
    picture of an iris laid flat whose outer edge touches the four sides, unknown where its alpha is
    0, the radius of whose `pupil` is given over the iris's.

    Raises:
        ValueError: for a file of another kind, a clone without its texture, a picture that is not
            square, a scene of an integrator without a reflectance.
    """
    path = Path(path)
    if path.is_dir():
        return _of_clone(path)
    if path.suffix == ".toml":
        return _of_scene(path)
    if path.suffix.lower() in READABLE:
        return _of_picture(path, pupil)
    pictures = ", ".join(READABLE)
    message = "neither the folder of a clone, nor a scene file (.toml), nor a picture"
    raise ValueError(f"{path}: {message} ({pictures})")


def tissue_files(tissue: Tissue, eye: Eye) -> dict[str, bytes]:
    """The files, by name, of a painting's `nearest_tissue`: maps, and a scene of the painted eye
    with that iris, behind F09's cornea, at an exposure at which it is as bright as the paint;
    without the white, which would be overexposed.
    """
    scene = Scene(
        tissue.iris,
        tissue.maps,
        eye=eye.replace(cornea=Cornea.f09(), aqueous_index=1.376, sclera=None),
    )
    entries = {"maps": {"file": TISSUE_MAPS}, "picture": {"exposure": tissue.exposure}}
    remark = (
        "A painted eye as tissue, by irisjax. Its colours differ from the paint's by a mean dE*ab"
        f"\n# of {tissue.left.mean:.1f} at this exposure; the white (sclera = true) is overexposed."
    )
    text = scene_text(scene, entries, remark)
    return {TISSUE_MAPS: encode_maps(TISSUE_MAPS, tissue.maps), TISSUE_SCENE: text.encode()}


def _of_clone(folder: Path) -> Target:
    summary = check_summary(folder)
    names = "pupil_radius_mm", "iris_radius_mm"
    if not {*names} <= summary.keys() or not (folder / VISIBLE_MASK).exists():
        message = "it was stopped before its texture or is an older one; run irisjax clone again"
        raise ValueError(f"{folder}: the clone has no {VISIBLE_MASK}, {message}")
    pixels = read_image(folder / UNREFRACTED_PICTURE, decode=True).pixels
    shown = read_image(folder / VISIBLE_MASK).pixels[..., 0]
    inner, outer = (float(summary[name]) for name in names)
    return _unroll(folder.resolve().name, pixels, shown > 0.5, inner, outer)


def _of_scene(path: Path) -> Target:
    file = read_scene(path)
    scene = file.scene()
    eye, integrator = scene.eye, scene.integrator
    if not isinstance(integrator, Separable | RadiativeIntegrator):
        need = "has no reflectance; need separable or radiative-transfer"
        raise ValueError(f"{path}: an iris of the integrator {integrator_name(integrator)} {need}")
    # Separable: with degrees for the wide ranges of maps, by default.
    method = None if isinstance(integrator, Separable) else integrator
    values = np.asarray(reflectance_of(scene.tissue, scene.maps, eye, method))
    if scene.maps is None:
        values = np.broadcast_to(values[:1, :1], (*TEXTURE_SHAPE, 3))
    pupil = float(eye.pupil_radius / eye.iris_radius)
    return Target(path.name, file.exposure * values, np.ones(values.shape[:2], bool), pupil)


def _of_picture(path: Path, pupil: float) -> Target:
    image = read_image(path, decode=True)
    rows, columns, _ = image.pixels.shape
    if rows != columns:
        message = "it must be square, the outer edge of the iris touching its four sides"
        raise ValueError(f"{path}: is {columns} x {rows} pixels; {message}")
    colours = [i for i, name in enumerate(image.channels) if name != "A"][:3]
    pixels = image.pixels[..., colours if len(colours) == 3 else colours[:1] * 3]
    shown = np.ones((rows, columns), bool)
    if "A" in image.channels:
        shown = image.pixels[..., image.channels.index("A")] > 0.5
    return _unroll(path.name, pixels, shown, HALF_WIDTH * pupil, HALF_WIDTH)


def _unroll(name: str, pixels: np.ndarray, shown: np.ndarray, inner: float, outer: float) -> Target:
    """Mean visible colours of polar cells; radii in mm, the picture 2 `HALF_WIDTH` wide."""
    share = to_polar(shown.astype(float), inner, outer, TEXTURE_SHAPE)
    known = share > _WHOLE
    if not known.any():
        raise ValueError(f"{name}: nothing of the iris is visible")
    colours = np.moveaxis(np.where(shown[..., None], pixels, 0), 2, 0)
    cells = [to_polar(colour, inner, outer, TEXTURE_SHAPE) for colour in colours]
    texture = np.stack(cells, -1) / np.where(known, share, 1)[..., None]
    count = known.sum(0)
    radii = np.flatnonzero(count)
    sums = np.where(known[..., None], texture, 0).sum(0)[radii] / count[radii, None]
    mean = np.stack([np.interp(np.arange(len(count)), radii, channel) for channel in sums.T], -1)
    return Target(name, np.where(known[..., None], texture, mean), known, inner / outer)
