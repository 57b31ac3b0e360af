"""The eye and painted coats as triangles, for other renderers.

Meshes are in the eye frame and in mm, as in `irisjax.anatomy.eye`; `right_handed` converts them.
All are surfaces of revolution. Those of one eye have the same number of points round the axis, so
that cornea and sclera share the points of the limbus.
"""

import io
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import optimize

from irisjax.anatomy.eye import Eye, cornea_of, slope_of
from irisjax.anatomy.sclera import sphere
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import Range, check_known, check_range, check_whole
from irisjax.numerics.interpolation import smoothstep
from irisjax.ocularist.coats import Coat, Painting
from irisjax.ocularist.cones import Cones, shell
from irisjax.optics.conicoid import Conicoid

if TYPE_CHECKING:
    from trimesh import Trimesh

AROUND = 256
"""Points of painted coats round the axis."""
FORMATS = "obj", "ply"
"""Kinds of file that hold meshes."""

_SPACING = Range(0, math.inf, "mm", above=True)
# Made up, drawn from no face: heights of the lids' lines before an open eye, parabolas that meet
# in its corners, and the distance of these from its middle; height of a lid's edge, and of the tear
# meniscus; height of the occlusion above the eye, which keeps the two apart in a depth buffer.
_LIDS = 4.3, -5.3
_WIDE, _EDGE, _MENISCUS, _LIFT = 11.0, 2.0, 0.25, 0.05  # mm


def eye_meshes(eye: Eye, spacing: float = 0.1) -> "dict[str, Trimesh]":
    """Meshes of an eye's surfaces, by name, with triangles of about `spacing` mm.

    - `anterior`: cap of the cornea from the apex to the limbus: air outside, `cornea.index` inside
        (with one surface: `aqueous_index`).
    - `posterior`: `cornea.index` outside, `aqueous_index` inside. It ends where it meets the plane
        or cone of the iris, so that no ray reaches the iris unrefracted.
    - `iris`: from the pupil's edge to the root. u = angle / 2π from +x towards +y, v = 0 at the
        pupil and 1 at the root: an image of it has the columns for rows and the rows for columns of
        `IrisMaps`.
    - `sclera`: sphere through the limbus, without the part that the cornea replaces.

    Caps are open: an interface acts by the side of its normal from which a ray comes. Anterior
    cornea and sclera share the points of the limbus and close the eye together.

    Raises:
        ValueError: for a spacing that is no positive number.
    """
    check_range("spacing", spacing, _SPACING)
    limbus, root, pupil = float(eye.limbus_radius), float(eye.iris_radius), float(eye.pupil_radius)
    around = _around(eye, spacing)
    depth, slope = float(eye.iris_depth), float(slope_of(eye))
    meshes, edge = {}, 0.0
    if eye.cornea is not None:
        edge = float(_depth(eye.cornea.anterior, limbus))
        meshes["anterior"] = _cap(eye.cornea.anterior, limbus, spacing, around)
        behind = eye.cornea.posterior
        if behind is not None:
            meshes["posterior"] = _cap(behind, _meeting(behind, depth, slope), spacing, around)

    r = np.linspace(pupil, root, _steps(root - pupil, spacing))
    # A seam: the points at u = 1 are those at u = 0 once more.
    iris = _revolved(r, depth + slope * r, np.full_like(r, slope), -np.ones_like(r), around, True)
    if eye.pupil_centre is not None or eye.pupil_harmonics is not None:
        iris = _moved(eye, iris, (root - r) / (root - pupil))
    u, v = np.meshgrid(np.arange(around + 1) / around, (r - pupil) / (root - pupil))
    meshes["iris"] = _mesh(*iris, np.stack([u.ravel(), v.ravel()], -1))

    if eye.sclera is not None:
        radius = float(eye.sclera.radius)
        centre = edge + math.sqrt(radius**2 - limbus**2)
        start = math.asin(limbus / radius)
        angle = np.linspace(start, math.pi, _steps(radius * (math.pi - start), spacing))
        r, z = radius * np.sin(angle), centre - radius * np.cos(angle)
        r[0], z[0], r[-1] = limbus, edge, 0.0
        meshes["sclera"] = _mesh(*_revolved(r, z, r, z - centre, around))
    return meshes


def strip_meshes(eye: Eye, spacing: float = 0.1) -> "dict[str, Trimesh]":
    """Strips on an eye with cornea and white (else none), by name, most with opacities as their
    attribute `alpha`.

    The model has no lids: their lines are made up, for an eye that gets lids elsewhere.

    - `limbus`: a ring on the cornea whose opacity is the share of white in pictures: of the width
        `limbus_width` its inner half.
    - `tear_line`: menisci, a quarter of a circle tangent to the eye and to the lid's edge.
    - `occlusion`: ribbons close before the eye; their opacity is the share of a uniform sky's
        irradiance that an upright edge of height h takes from a plane,
        (1 − s / √(s² + h²)) / 2 at distance s, here as seen from ahead.

    Raises:
        ValueError: for a spacing that is no positive number.
    """
    check_range("spacing", spacing, _SPACING)
    if eye.cornea is None or eye.sclera is None:
        return {}
    turn, tears, shades = np.linspace(np.pi / 2, 0, 7), [], []
    x = 0.98 * np.linspace(-_WIDE, _WIDE, _steps(2 * _WIDE, spacing))
    open_by, middle = np.array([1 - (x / _WIDE) ** 2, -2 * x / _WIDE**2]), sum(_LIDS) / 2
    reach = np.minimum(3 * _EDGE, (_LIDS[0] - _LIDS[1]) * open_by[0])
    away = np.linspace(0, 1, 25)[:, None] * reach
    alpha = (1 - away / np.hypot(away, _EDGE)) / 2
    for height in _LIDS:
        (y, slope), inwards = (height - middle) * open_by, -np.sign(height)
        y = y + middle
        edge, out = map(np.asarray, _front(eye, x, y))
        across = np.cross(np.gradient(edge, axis=0), out) * inwards
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        sin, cos = np.sin(turn)[:, None, None], np.cos(turn)[:, None, None]
        points = edge + _MENISCUS * ((1 - sin) * across + (1 - cos) * out)
        tears.append((points, sin * across + cos * out))
        step = away * inwards / np.hypot(slope, 1)
        points, out = map(np.asarray, _front(eye, x - slope * step, y + step))
        shades.append((points + _LIFT * out, out))
    made = {"tear_line": _ribbons(tears), "occlusion": _ribbons(shades)}
    made["occlusion"].vertex_attributes["alpha"] = np.tile(alpha.ravel(), 2)
    share, around = np.linspace(0, 0.5, 13), _around(eye, spacing)
    r = float(eye.limbus_radius) + (share - 0.5) * float(eye.limbus_width)
    points, out = map(np.asarray, _front(eye, r, 0 * r))
    points = points + _LIFT / 2 * out
    ring = _revolved(points[:, 0], points[:, 2], out[:, 0], out[:, 2], around)
    made["limbus"] = _mesh(*ring)
    alpha = np.asarray(smoothstep(jnp.asarray(share)))
    made["limbus"].vertex_attributes["alpha"] = np.repeat(alpha, around)
    return made


def cone_mesh(cones: Cones, around: int = AROUND) -> "Trimesh":
    """Triangles of a stack of cones; each cone has its own corners, so that seams stay sharp.

    u and v are those of a picture seen from ahead whose sides touch the widest circle: u = 0 at its
    left, v = 0 at its foot.

    Raises:
        ValueError: for fewer than 3 points round the axis.
    """
    check_whole("around", around, 3)
    z, radius = (np.asarray(v, np.float64) for v in (cones.z, cones.radius))
    every, count = [], 0
    for i in range(len(z) - 1):
        rise, out = np.full(2, z[i + 1] - z[i]), np.full(2, radius[i + 1] - radius[i])
        cone = _revolved(radius[i : i + 2], z[i : i + 2], rise, -out, around)
        every.append((*cone[:2], cone[2] + count))
        count += len(cone[0])
    points, normals, faces = map(np.concatenate, zip(*every, strict=True))
    return _mesh(points, normals, faces, (points[:, :2] / radius.max() + 1) / 2)


def painting_files(
    painting: Painting, form: str = "obj", around: int = AROUND, eye: Eye | None = None
) -> dict[str, bytes]:
    """Files, by their names, of a mesh of every coat and its picture with opacity.

    Meshes are those of `right_handed`. Files bear the coats' names, with underscores for spaces.

    Args:
        painting: The coats.
        form: One of `FORMATS`.
        around: Points round the axis.
        eye: Adds meshes of its `cornea` and `white`, without pictures.

    Raises:
        ValueError: for an unknown form.
    """
    profile, meshes, files = painting.profile, {}, {}
    for coat in painting.coats:
        stem = coat.name.replace(" ", "_")
        meshes[stem] = cone_mesh(Cones(profile.z - float(coat.height), profile.radius), around)
        files[f"{stem}.png"] = _picture(coat)
    if eye is not None:
        meshes |= {name: cone_mesh(cones, around) for name, cones in shell(eye).items()}
    meshes = {name: right_handed(mesh) for name, mesh in meshes.items()}
    textures = {stem: f"{stem}.png" for stem in meshes if f"{stem}.png" in files}
    return files | mesh_files(meshes, form, textures)


def mesh_files(
    meshes: "Mapping[str, Trimesh]", form: str = "ply", textures: Mapping[str, str] | None = None
) -> dict[str, bytes]:
    """Files of meshes, by their names: binary PLY with normals (and u, v where a mesh has them), or
    OBJ with its material, whose base colour is a file of `textures`, by the mesh's name.

    Raises:
        ValueError: for an unknown form.
    """
    check_known("kind of mesh", form, FORMATS)
    files = {}
    for name, mesh in meshes.items():
        if form == "ply":
            single = mesh.copy(include_cache=True)
            for axis, values in mesh.vertex_attributes.items():
                single.vertex_attributes[axis] = values.astype(np.float32)
            files[f"{name}.ply"] = single.export(file_type="ply", vertex_normal=True)
        else:
            files |= _obj(mesh, name, (textures or {}).get(name))
    return files


def right_handed(mesh: "Trimesh") -> "Trimesh":
    """A mesh in the frame of other renderers: x right, y up, +z out of the eye towards the viewer.

    The eye's own frame (+z into the eye) is left-handed: read without conversion, its meshes show
    a mirrored iris.
    """
    return mesh.copy(include_cache=True).apply_transform(np.diag([1.0, 1.0, -1.0, 1.0]))


def _mesh(
    points: np.ndarray, normals: np.ndarray, faces: np.ndarray, uv: np.ndarray | None = None
) -> "Trimesh":
    import trimesh

    made = trimesh.Trimesh(points, faces, vertex_normals=normals, process=False)
    if uv is not None:
        made.vertex_attributes.update(u=uv[:, 0], v=uv[:, 1])
    return made


def _obj(mesh: "Trimesh", name: str, texture: str | None) -> dict[str, bytes]:
    from trimesh.exchange.obj import export_obj
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import SimpleMaterial

    if "u" in mesh.vertex_attributes:
        uv = np.stack([mesh.vertex_attributes[axis] for axis in "uv"], -1)
        white = {"ambient": [255] * 3, "diffuse": [255] * 3, "specular": [0] * 3}
        material = SimpleMaterial(name=name, **white)
        mesh = mesh.copy(include_cache=True)
        mesh.visual = TextureVisuals(uv=uv, material=material)
    text, more = export_obj(
        mesh,
        include_normals=True,
        return_texture=True,
        mtl_name=f"{name}.mtl",
        header="simulated by irisjax",
    )
    colour = b"" if texture is None else f"\nmap_Kd {texture}\n".encode()
    return {f"{name}.obj": text.encode(), **{file: data + colour for file, data in more.items()}}


def _around(eye: Eye, spacing: float) -> int:
    return max(12, math.ceil(2 * math.pi * float(eye.limbus_radius) / spacing))


def _steps(length: float, spacing: float) -> int:
    return max(3, math.ceil(length / spacing) + 1)


@eqx.filter_jit
def _front(eye: Eye, x: Any, y: Any) -> tuple[Array, Array]:
    """Points of cornea and white ahead of places (x, y), mm, and their normals."""
    r = jnp.hypot(x, y)
    inside = r <= eye.limbus_radius
    found = []
    for surface, radius in ((cornea_of(eye).anterior, jnp.where(inside, r, 0.0)), (sphere(eye), r)):
        points = jnp.stack([x, y, surface.apex + surface.sagitta(radius)], axis=-1)
        found.append((points, surface.normal(points)))
    (cap, tilt), (globe, out) = found
    within = inside[..., None]
    return jnp.where(within, cap, globe), jnp.where(within, tilt, out)


def _ribbons(strips: list[tuple[np.ndarray, np.ndarray]]) -> "Trimesh":
    """Points and normals of the upper and of the lower lid's strip, rows from the lid's edge."""
    upper, lower = (np.arange(p[..., 0].size).reshape(p.shape[:2]) for p, _ in strips)
    faces = [_triangles(i[:, :-1], i[:, 1:]) for i in (upper, lower[:, ::-1] + upper.size)]
    points, normals = (np.concatenate([s[k].reshape(-1, 3) for s in strips]) for k in (0, 1))
    return _mesh(points, normals, np.concatenate(faces))


def _triangles(here: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Triangles between rows of corners and those beside them."""
    a, b, c, d = (corner.ravel() for corner in (here[:-1], after[:-1], here[1:], after[1:]))
    return np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])


def _cap(surface: Conicoid, edge: float, spacing: float, around: int) -> "Trimesh":
    length = math.hypot(edge, float(_depth(surface, edge) - _depth(surface, 0)))
    r = np.linspace(0, edge, _steps(length, spacing))
    z = _depth(surface, r)
    # The gradient of the surface's equation [F09 Eq. 3].
    inwards = float(surface.radius) - float(surface.shape) * (z - float(surface.apex))
    return _mesh(*_revolved(r, z, r, -inwards, around))


def _moved(
    eye: Eye, iris: tuple[np.ndarray, np.ndarray, np.ndarray], shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and triangles of an iris, each ring moved by its share of the pupil's way and
    of its irregularity.
    """
    points, _, faces = iris
    share, across = np.repeat(shares, len(points) // len(shares))[:, None], points[:, :2]
    centre = np.zeros(2) if eye.pupil_centre is None else np.asarray(eye.pupil_centre)
    out = np.asarray(eye.pupil_edge(*(across + centre).T)) - float(eye.pupil_radius)
    across = across * (1 + share.T * out / np.hypot(*across.T)).T + share * centre
    deep = float(eye.iris_depth) + float(slope_of(eye)) * np.hypot(*across.T)
    points = np.column_stack([across, deep])
    return points, np.asarray(eye.iris_normal(jnp.asarray(points)), points.dtype), faces


def _depth(surface: Conicoid, r: Any) -> np.ndarray:
    return np.asarray(surface.apex + surface.sagitta(jnp.asarray(r, float)), np.float64)


def _meeting(surface: Conicoid, depth: float, slope: float) -> float:
    """Radius at which a surface meets that of the iris; its equator, if it ends before."""
    radius, p = float(surface.radius), float(surface.shape)
    widest = radius / math.sqrt(p) if p > 0 else 4 * radius

    def below(r):
        return float(_depth(surface, r)) - depth - slope * r

    if below(widest) < 0:
        return widest
    return float(optimize.root_scalar(below, bracket=(0.0, widest), xtol=1e-14).root)


def _revolved(
    r: np.ndarray,
    z: np.ndarray,
    out: np.ndarray,
    along: np.ndarray,
    around: int,
    seam: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, unit normals and triangles of a profile of radii `r` and places `z` turned about z;
    rings of radius 0 are single points; with a `seam` a ring's first point is repeated as its last.

    `out` and `along` are the normals' components, of any length, away from the axis and along z.
    Triangles face to the left of the profile's direction (to −z where r grows).
    """
    angle = np.arange(around + seam) * (2 * math.pi / around)
    cos, sin = np.cos(angle), np.sin(angle)
    cos[around:], sin[around:] = 1.0, 0.0
    index = np.arange(len(r) * len(cos)).reshape(len(r), len(cos))
    index[r == 0] = index[r == 0][:, :1]
    after = index[:, 1:] if seam else np.roll(index, -1, axis=1)
    here = index[:, :-1] if seam else index
    faces = _triangles(here, after)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    used, faces = np.unique(faces, return_inverse=True)
    length = np.hypot(np.where(r > 0, out, 0.0), along)
    length = np.where(length > 0, length, 1.0)

    def turned(radial, axial):
        rows = np.outer(radial, cos), np.outer(radial, sin), np.outer(axial, np.ones_like(cos))
        return np.stack(rows, -1).reshape(-1, 3)[used]

    normals = turned(np.where(r > 0, out, 0.0) / length, along / length)
    return turned(r, z), normals, faces.reshape(-1, 3)


def _picture(coat: Coat) -> bytes:
    """A PNG of colour and opacity."""
    from PIL import Image

    opacity = np.asarray(coat.opacity)[..., None]
    colour = np.asarray(srgb_encode(np.asarray(coat.colour)))
    both = np.concatenate([np.broadcast_to(colour, (*opacity.shape[:2], 3)), opacity], -1)
    data = io.BytesIO()
    Image.fromarray(np.rint(255 * both).astype(np.uint8)).save(data, "png")
    return data.getvalue()
