"""A scene for other renderers: meshes, textures, a BRDF table, and a scene file for Mitsuba 3.

All files are in one folder, in mm, x right and y up as the viewer sees them, +z out of the eye.
Textures of the iris are pictures in the uv of its mesh: columns run with u = angle / 2π, and the
pupil's edge is the bottom row.
"""

import errno
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.media import TEAR
from irisjax.export.gltf import gltf_files
from irisjax.export.mesh import eye_meshes, mesh_files, right_handed, strip_meshes
from irisjax.export.mitsuba import WIDEST, filled, mitsuba_scene
from irisjax.io.images import encode_exr, encode_png, spectral_channels
from irisjax.io.maps import encode_maps
from irisjax.io.tables import format_table, new_folder, write_together
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import check_known
from irisjax.render.albedo import CONE, LambertError, Matt
from irisjax.render.bands import Bands, colour_bands
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.outside import Blood, colour_table
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable

FORMS = "obj", "glb"
"""Kinds of hand-over: `glb` adds a glTF binary to the files of `obj`."""
REFLECTANCE_WAVELENGTHS = tuple(400.0 + 20.0 * i for i in range(16))
"""Wavelengths of the layers of reflectance.exr, nm."""
_LAYERS = spectral_channels(REFLECTANCE_WAVELENGTHS, layer="T")


class Exported(NamedTuple):
    """The result of `export_scene`.

    Attributes:
        files: Paths by the files' names.
        clipped: Number of texels that were clipped.
        error: Error of a matt iris against the model.
    """

    files: dict[str, Path]
    clipped: int
    error: LambertError


def export_scene(
    folder: str | Path, scene: Scene, *, spacing: float = 0.1, form: str = "obj"
) -> Exported:
    """Write a scene for other renderers into a new or empty folder: all files or none.

    - Meshes of the eye's surfaces (anterior, posterior, iris, sclera) as .ply and .obj, with
        triangles of about `spacing` mm.
    - albedo.exr: linear sRGB under the scene's illuminant of each texel, its
        directional–hemispherical reflectance at normal incidence (`render.albedo`), by radiative
        transfer where that is the scene's integrator, else by ILIT;
        albedo.png: the same, 8-bit sRGB. Texels outside sRGB are clipped in both: renderers
        drop light paths that meet a negative albedo. reflectance.exr: the spectral albedo, a layer
        for each of `REFLECTANCE_WAVELENGTHS`, never clipped; relief.exr: height towards the viewer,
        mm, where the iris has a relief.
    - maps.exr: the maps themselves (`read_maps`), if there are any. brdf.csv: the uniform iris's.
    - eye.glb and planar textures of the iris (`export.gltf`), where `form` is "glb".
    - environment.exr, where the scene has one; scene.xml for Mitsuba 3; README.txt, which describes
        the files and states the error of a matt iris.

    Args:
        folder: New or empty.
        scene: The scene.
        spacing: Size of the triangles, mm.
        form: One of `FORMS`.

    Raises:
        OSError: naming the file, also for a folder that is not empty.
        ValueError: for a bad `spacing` or `form`.
    """
    check_known("form", form, FORMS)
    folder = Path(folder)
    check_new_folder(folder)
    data, clipped, error = _contents(scene, spacing, form)
    with new_folder(folder):
        write_together({folder / name: content for name, content in data.items()})
    return Exported({name: folder / name for name in data}, clipped, error)


def check_new_folder(folder: str | Path) -> None:
    """Raise `OSError` unless the folder is empty, or can be made."""
    folder = Path(folder)
    if folder.is_dir():
        if any(folder.iterdir()):
            raise OSError(errno.ENOTEMPTY, "not empty; give a new folder", str(folder))
    elif folder.exists():
        raise NotADirectoryError(errno.ENOTDIR, "is a file, not a folder", str(folder))
    elif not folder.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(folder.parent))


def _contents(
    scene: Scene, spacing: float, form: str
) -> tuple[dict[str, bytes], int, LambertError]:
    eye, maps, around, integrator = scene.eye, scene.maps, scene.environment, scene.integrator
    if not isinstance(integrator, Separable | RadiativeIntegrator):
        integrator = Separable()
    meshes = {name: right_handed(mesh) for name, mesh in eye_meshes(eye, spacing).items()}
    data = mesh_files(meshes) | mesh_files(meshes, "obj", {"iris": "albedo.png"})

    said = f"simulated by irisjax; {integrator.process}; a texel's albedo at normal incidence"
    remark = {"comments": said}
    bands, hazy = (colour_bands(scene.illuminant, scene.observer, c) for c in (None, eye.cornea))
    matt = Matt.build(scene.tissue, maps, eye, _joined(bands, hazy), integrator)
    colour, through, spectral = np.split(np.asarray(matt.albedo()), [3, 6], axis=-1)
    if maps is not None and maps.residual is not None:
        kept = np.asarray(maps.residual)
        colour, through = colour * kept, through * kept
    clear = eye.cornea is None or eye.cornea.scatter is None
    haze = None if clear else _haze(colour, through, bands, hazy)
    clipped = int(((colour < 0) | (colour > 1)).any(-1).sum())
    colour = np.clip(colour, 0, 1)
    white = _white(scene)
    if form == "glb":
        strips = {name: right_handed(mesh) for name, mesh in strip_meshes(eye, spacing).items()}
        data |= gltf_files(scene, meshes | strips, colour, white, haze)
    colour = _in_uv(colour)
    encoded = np.asarray(srgb_encode(colour))
    data["albedo.exr"] = encode_exr("albedo.exr", colour, metadata=remark)
    data["albedo.png"] = encode_png("albedo.png", encoded, remark="simulated by irisjax")[0]
    data["reflectance.exr"] = encode_exr("reflectance.exr", _in_uv(spectral), _LAYERS, remark)
    relief = None if maps is None else maps.relief
    if relief is not None:
        remark, height = {"comments": "height, mm"}, _in_uv(relief[..., None])
        data["relief.exr"] = encode_exr("relief.exr", height, ("Y",), remark)
    if maps is not None and maps.present():
        data["maps.exr"] = encode_maps("maps.exr", maps)
    data["brdf.csv"] = _brdf(matt.first_channels(3), scene.illuminant, integrator).encode()
    if around is not None:
        data["environment.exr"] = encode_exr("environment.exr", np.asarray(around.radiance))
    white = None if white is None else white.mean((0, 1))
    xml = mitsuba_scene(scene, relief=relief is not None, white=white, haze=haze)
    data["scene.xml"] = xml.encode()
    error = matt.first_channels(3).error()
    shares = error._asdict().items()
    values = {
        **dict.fromkeys(data, ""),
        **{name: ", ".join(f"{100 * v:.2g}" for v in share) + " %" for name, share in shares},
        "process": str(integrator.process),
        "table": f"{100 * float(matt.response.error):.1g}",
        "clipped": str(clipped) if clipped else None,
        **_approximations(eye),
    }
    data["README.txt"] = filled("readme.txt", values).encode()
    return data, clipped, error


def _approximations(eye: Eye) -> dict[str, str | None]:
    """Numbers of README.txt that the eye decides."""
    aqueous = float(eye.aqueous_index)
    solid = eye.cornea is None or eye.cornea.posterior is None
    cornea = aqueous if eye.cornea is None or solid else float(eye.cornea.index)
    mirrored = [((index - 1) / (index + 1)) ** 2 for index in (cornea, TEAR)]
    return {
        "attenuation": None if eye.attenuation is None else "",
        "cone": f"{CONE:g}",
        "limbus": f"{float(eye.limbus_width):.2g}",
        "margin": f"{float(eye.pupil_margin):.2g}",
        "glass": f"{cornea:.5g}",
        "inner": f"{aqueous / cornea:.5g}",
        "cornea": f"{cornea:g}",
        "aqueous": f"{aqueous:g}",
        "tear": f"{TEAR:g}",
        "mirrored": f"{100 * (mirrored[0] / mirrored[1] - 1):+.2g}",
        "widest": f"{np.degrees(WIDEST):g}",
    }


def _in_uv(texture) -> np.ndarray:
    """A texture (angles, radii, channels) as a picture (rows, columns, channels) in uv."""
    return np.rot90(np.asarray(texture))


def _joined(bands: Bands, hazy: Bands) -> Bands:
    """Channels of `bands` and `hazy`, and reflectances: one table serves all."""
    colours = jnp.concatenate([bands.weights, hazy.weights])
    ones = jnp.ones_like(bands.white, shape=len(_LAYERS))
    return Bands(
        bands.wavelengths + REFLECTANCE_WAVELENGTHS,
        jnp.asarray(block_diag(colours, jnp.diag(ones)), colours.dtype),
        jnp.concatenate([bands.white, hazy.white, ones]),
        (*bands.channels, *hazy.channels, *_LAYERS),
    )


def _haze(colour: np.ndarray, through: np.ndarray, bands: Bands, hazy: Bands) -> np.ndarray:
    """Linear sRGB transmittance of one passage of the cornea that dims this iris as its spectrum
    is dimmed.

    Channels in which the iris reflects hardly any light take the transmittance for white, which
    errs by 3 % for a blue iris.
    """
    white = np.asarray(hazy.weights.sum(axis=1) / bands.weights.sum(axis=1))
    before, after = colour.mean((0, 1)), through.mean((0, 1))
    twice = np.where(before > 1e-3, after / np.where(before > 1e-3, before, 1.0), white)
    return np.sqrt(np.where((twice > 0) & (twice <= 1), twice, white))


def _white(scene: Scene) -> np.ndarray | None:
    """Albedo of the white, linear sRGB (azimuths, polars, 3)."""
    if scene.eye.sclera is None:
        return None
    bands = colour_bands(scene.illuminant, scene.observer, all_wavelengths=True)
    table = colour_table(scene.eye.sclera, np.asarray(bands.wavelengths), bands.weights)
    v = scene.veins
    blood = Blood(jnp.zeros((2, 2))) if v is None else Blood(v.depth, v.cover, v.deep)
    return np.asarray(table(blood))


def _brdf(matt: Matt, illuminant: str, integrator: AbstractIntegrator) -> str:
    angle, azimuth = np.arange(0.0, 90.0, 5.0), np.array([0.0, 90.0, 180.0])
    cosine = jnp.cos(jnp.radians(jnp.asarray(angle)))
    values = matt.brdf(cosine, cosine, jnp.radians(jnp.asarray(azimuth)))
    place = np.stack(np.meshgrid(angle, angle, azimuth, indexing="ij"), axis=-1)
    header = {
        "simulated": "BRDF of the uniform iris in the aqueous humour, without the light "
        "mirrored by its surface",
        "process": str(integrator.process),
        "unit": f"1/sr, linear sRGB under {illuminant}",
        "directions": "degrees from the normal; dphi 0 is forward scattering, where a mirror "
        "would send the light",
    }
    names = "theta_i_deg", "theta_o_deg", "dphi_deg", "red", "green", "blue"
    columns = np.concatenate([place.reshape(-1, 3), np.asarray(values).reshape(-1, 3)], axis=1)
    return format_table(header, dict(zip(names, columns.T, strict=True)))
