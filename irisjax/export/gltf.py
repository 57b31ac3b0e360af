"""A scene as one glTF 2 binary, with planar textures of the iris: what engines and viewers read.

Lengths are in metres, x right, y up and +z out of the eye, as glTF's front. Every texture is seen
from ahead and centred on the axis: u = 1/2 + x / 2R and v = 1/2 + y / 2R from its lower edge, with
R of the iris's root, of the limbus or of the globe.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import ndimage

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.media import TEAR
from irisjax.anatomy.sclera import sphere, vein_place
from irisjax.io.images import encode_png, to_steps
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.interpolation import polar_bilinear, smoothstep
from irisjax.optics.conicoid import from_parts
from irisjax.render.project import IrisPixels
from irisjax.render.scene import Scene
from irisjax.render.shading import camera_share, facing_at, relief_field, sample_textures
from irisjax.tissue.maps import texel_places

if TYPE_CHECKING:
    from trimesh import Trimesh

FOOTPRINT = 0.1
"""Width, mm, over which the roughness of the iris gathers the normals of its relief: a pixel of a
picture in which the iris is about 100 pixels wide.
"""
_SIZES = 256, 4096  # smallest and largest side of a texture, powers of two
_WHITE = 1024  # side of the texture of the white
_MM = 1e-3
_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}  # held at edges


def gltf_files(
    scene: Scene,
    meshes: "Mapping[str, Trimesh]",
    colour: Float[np.ndarray, "angles radii 3"],
    white: Float[np.ndarray, "azimuths polars 3"] | None,
    haze: Float[np.ndarray, "3"] | None,
) -> dict[str, bytes]:
    """Compute eye.glb and the textures in it, by the files' names.

    - Nodes: `iris`, `pupil` (a black disc), `cornea` (its front), `sclera` and those of
        `strip_meshes`, of those that the eye has.
    - iris_base_color.png (8-bit sRGB, fading into the pupil as pictures do), iris_thickness.png
        (ABL and stroma over their largest, which is the material's `thicknessFactor`); where the
        iris has a relief iris_normal.png and iris_roughness.png, in green the square root of GGX's
        α, with α² twice the variance of the slopes within `FOOTPRINT`, in red what the relief
        leaves of the sky.

    The cornea is one surface with the index of the humour behind it: glTF has no index below one,
    which the cornea's back would need. The two surfaces nearly cancel: the pupil's image is 0.06 %
    larger, and mirror images are those of the tear film but for 0.6 %.

    Args:
        scene: The scene.
        meshes: Meshes of `eye_meshes` and `strip_meshes`, converted by `right_handed`, mm.
        colour: Albedo of the iris, linear sRGB in [0, 1].
        white: Albedo of the white from the limbus to the equator, or `None`.
        haze: Transmittance of one passage of the cornea, linear sRGB; `None` for a clear one.
    """
    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    eye = scene.eye
    pictures, thickest = _iris_pictures(scene, colour)
    textures: dict[str, dict[str, Any]] = {"iris": dict(pictures)}
    halves = {"iris": eye.iris_radius, "cornea": eye.limbus_radius}
    colours = {"pupil": np.zeros(3), "occlusion": np.zeros(3)}
    if eye.sclera is not None and white is not None:
        halves["sclera"], colours["limbus"] = eye.sclera.radius, white.mean((0, 1))
        root = colour[:, -1].mean(0) * (1.0 if haze is None else haze**2)
        seen = _white_seen(eye, jnp.asarray(white), jnp.asarray(root), _WHITE)
        textures["sclera"] = {"baseColorTexture": srgb_encode(seen)}
    bodies = {name: mesh for name, mesh in meshes.items() if name not in ("anterior", "posterior")}
    bodies["pupil"] = _disc(meshes["iris"])
    if "anterior" in meshes:
        bodies["cornea"] = meshes["anterior"]
    whole = trimesh.Scene(metadata=_described(eye))
    for name, mesh in bodies.items():
        half = halves.get(name)
        uv = None if half is None else 0.5 + mesh.vertices[:, :2] / (2 * float(half))
        given = textures.get(name, {})
        images: Any = {slot: Image.fromarray(to_steps(x, 8)[0]) for slot, x in given.items()}
        visual = TextureVisuals(uv=uv, material=PBRMaterial(name=name, **images))
        if "alpha" in mesh.vertex_attributes:
            opacity = np.rint(255 * mesh.vertex_attributes["alpha"])[:, None]
            rgba = np.pad(opacity, ((0, 0), (3, 0)), constant_values=255)
            visual.vertex_attributes["color"] = rgba.astype(np.uint8)
        body = trimesh.Trimesh(
            _MM * mesh.vertices,
            mesh.faces,
            vertex_normals=mesh.vertex_normals,
            visual=visual,
            process=False,
        )
        whole.add_geometry(body, node_name=name, geom_name=name)

    settings = _materials(scene, haze, thickest)

    def finish(tree: dict[str, Any]) -> None:
        """Complete the materials, of which trimesh writes the textures alone."""
        used = set()
        for material in tree["materials"]:
            name = material["name"]
            roughness, extensions = settings[name]
            # A slot that is free carries the picture of the thickness.
            if (thickness := material.pop("occlusionTexture", None)) is not None:
                extensions["KHR_materials_volume"]["thicknessTexture"] = thickness
            own = material.setdefault("pbrMetallicRoughness", {})
            if "metallicRoughnessTexture" in own:  # its red channel is glTF's occlusion
                material["occlusionTexture"] = dict(own["metallicRoughnessTexture"])
            own |= {"metallicFactor": 0.0, "roughnessFactor": roughness}
            if name in colours:
                own["baseColorFactor"] = [*colours[name].tolist(), 1.0]
            if "alpha" in bodies[name].vertex_attributes:
                material["alphaMode"] = "BLEND"
            material["extensions"] = extensions
            used |= set(extensions)
        tree["extensionsUsed"] = sorted(used)
        tree["samplers"] = [_SAMPLER]
        for texture in tree["textures"]:
            texture["sampler"] = 0
        tree["asset"]["generator"] = "irisjax"

    data = whole.export(
        file_type="glb", include_normals=True, unitize_normals=True, tree_postprocessor=finish
    )
    assert isinstance(data, bytes)
    return {"eye.glb": data} | {
        name: encode_png(name, pictures[slot], remark="simulated by irisjax")[0]
        for slot, name in _FILES.items()
        if slot in pictures
    }


_FILES = {
    "baseColorTexture": "iris_base_color.png",
    "normalTexture": "iris_normal.png",
    "metallicRoughnessTexture": "iris_roughness.png",
    "occlusionTexture": "iris_thickness.png",
}


def _iris_pictures(scene: Scene, colour: np.ndarray) -> tuple[dict[str, np.ndarray], float]:
    """Encoded textures of the iris by their slot, and its largest thickness, mm."""
    eye, maps, iris = scene.eye, scene.maps, scene.tissue
    depth = np.zeros(colour.shape[:2])
    for layer in ("abl", "stroma"):
        given = None if maps is None else getattr(maps, f"{layer}_depth")
        depth = depth + np.asarray(getattr(iris, f"{layer}_thickness") if given is None else given)
    thickest, width = float(depth.max()), 2 * float(eye.iris_radius)
    span = width / 2 - float(eye.pupil_radius)
    side = int(np.clip(2 ** math.ceil(math.log2(width / span * colour.shape[1])), *_SIZES))
    relief = None if maps is None else maps.relief
    stacked = jnp.asarray(np.concatenate([colour, depth[..., None] / thickest], -1))
    seen, normal, share, sky = map(np.asarray, _iris_seen(eye, stacked, relief, side))
    pictures = {
        "baseColorTexture": np.asarray(srgb_encode(seen[..., :3] * share)),
        "occlusionTexture": np.repeat(seen[..., 3:] * (share > 0), 3, -1),
    }
    normal = np.where(share > 0, normal, [0.0, 0.0, 1.0])
    if relief is not None:
        pictures["normalTexture"] = (1 + normal) / 2
        cells = max(2, round(FOOTPRINT * side / width))
        # A mean of unit normals is the shorter, the more they spread [Toksvig 2005].
        mean = [
            ndimage.uniform_filter(n, cells, mode="nearest") for n in np.moveaxis(normal, -1, 0)
        ]
        length = np.minimum(np.linalg.norm(mean, axis=0), 1.0)[..., None]
        rough = np.minimum(2 * (1 - length) / length, 1.0) ** 0.25
        pictures["metallicRoughnessTexture"] = np.concatenate([sky, rough, 0 * rough], -1)
    return pictures, thickest


@eqx.filter_jit
def _iris_seen(
    eye: Eye,
    textures: Float[Array, "angles radii channels"],
    relief: Float[Array, "angles radii"] | None,
    side: int,
) -> tuple[Array, Array, Array, Array]:
    """Textures, normals (x, y, z towards the viewer), share of the iris, and share of the sky that
    its relief leaves, in a square about it: shape (rows, columns, channels), the top row first.
    """
    x, y = map(jnp.ravel, texel_places(side, eye.iris_radius, textures.dtype))
    one = jnp.ones_like(x)
    pixels = IrisPixels(None, (x, y, eye.iris_depth * one), (0 * x, 0 * x, one), one, one)
    found = sample_textures(pixels, eye, jnp.moveaxis(textures, -1, 0))
    (u, v, w), sky = (0 * x, 0 * x, -one), one
    if relief is not None:
        (u, v, w), sky = facing_at(pixels, eye.replace(iris_slope=None), relief_field(relief, eye))
    every = found, jnp.stack([u, v, -w]), camera_share(pixels, eye)[None], sky[None]
    found, normal, share, sky = (_rows(values, side) for values in every)
    return found, normal, share, sky


@eqx.filter_jit
def _white_seen(
    eye: Eye, white: Float[Array, "azimuths polars 3"], root: Float[Array, "3"], side: int
) -> Array:
    """Colours of the white's front half in a square about it, the top row first.

    From the limbus on it blends with the root of the iris as in pictures.
    """
    globe = sphere(eye)
    x, y = map(jnp.ravel, texel_places(side, globe.radius, white.dtype))
    r = jnp.minimum(jnp.hypot(x, y), globe.radius)
    place = vein_place(eye, from_parts([x, y, globe.apex + globe.sagitta(r)]))
    found = polar_bilinear(jnp.moveaxis(white, -1, 0), *place)
    share = smoothstep((r - eye.limbus_radius) / eye.limbus_width + 0.5)
    return _rows(root[:, None] + share * (found - root[:, None]), side)


def _rows(pixels: Float[Array, "channels pixels"], side: int) -> Array:
    return jnp.moveaxis(pixels.reshape(-1, side, side), 0, -1)


def _disc(iris: "Trimesh") -> "Trimesh":
    """A disc in the pupil, within the edge of the iris."""
    import trimesh

    edge = iris.vertices[iris.vertex_attributes["v"] == 0][:-1]
    i = np.arange(len(edge))
    faces = np.stack([i, np.roll(i, -1), np.full_like(i, len(edge))], -1)
    points = np.concatenate([edge, [edge.mean(0)]])
    normal = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    return trimesh.Trimesh(points, faces, vertex_normals=normal, process=False)


def _materials(
    scene: Scene, haze: np.ndarray | None, thickest: float
) -> dict[str, tuple[float, dict[str, Any]]]:
    """Roughness and extensions of each node's material. An index of one mirrors nothing."""
    eye = scene.eye
    aqueous, depth = float(eye.aqueous_index), _MM * float(eye.iris_depth)
    abl = float(scene.tissue.indices(eye.aqueous_index).abl) / aqueous
    chamber: dict[str, Any] = {"thicknessFactor": depth}
    if haze is not None:
        chamber |= {"attenuationColor": haze.tolist(), "attenuationDistance": depth}
    glass, opaque = ({"KHR_materials_transmission": {"transmissionFactor": t}} for t in (1.0, 0.0))
    thickness = {"KHR_materials_volume": {"thicknessFactor": _MM * thickest}}
    return {
        "iris": (1.0, _index(max(abl, 1 / abl)) | opaque | thickness),
        "pupil": (1.0, _index(1.0)),
        "cornea": (0.0, _index(aqueous) | glass | {"KHR_materials_volume": chamber}),
        "tear_line": (0.0, _index(TEAR) | glass),
        "occlusion": (1.0, _index(1.0)),
        **dict.fromkeys(("sclera", "limbus"), (0.0, _index(TEAR))),
    }


def _index(value: float) -> dict[str, Any]:
    return {"KHR_materials_ior": {"ior": value}}


def _described(eye: Eye) -> dict[str, Any]:
    """Return measures of the eye (m) for shaders of engines, as extras of the scene."""
    names = "iris_radius", "iris_depth", "pupil_radius", "pupil_margin", "limbus_radius"
    lengths = {name: round(_MM * float(getattr(eye, name)), 9) for name in (*names, "limbus_width")}
    cornea = None if eye.cornea is None else float(eye.cornea.index)
    indices = {"aqueous_index": float(eye.aqueous_index), "cornea_index": cornea}
    return {"source": "simulated by irisjax; lengths in m", **lengths, **indices}
