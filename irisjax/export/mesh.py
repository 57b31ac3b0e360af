"""The eye as triangles, for other renderers: cornea, iris and sclera as PLY files.

Eye frame and mm, as in `irisjax.anatomy.eye`; `right_handed` turns meshes for others. All meshes
are surfaces of revolution with the same number of points round the axis, so that cornea and sclera
share the points of the limbus.
"""

import math
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.io.tables import write_together
from irisjax.numerics.checks import Range, check_range
from irisjax.optics.conicoid import Conicoid


class Mesh(NamedTuple):
    """Triangles whose corners run counter-clockwise as seen from the side of the normals.

    - `vertices` (vertices, 3), mm; `normals` (vertices, 3), unit, of the smooth surface and out of
        the eye.
    - `uv` (vertices, 2) or `None`; `faces` (triangles, 3).
    """

    vertices: np.ndarray
    normals: np.ndarray
    uv: np.ndarray | None
    faces: np.ndarray


def write_eye(folder: str | Path, eye: Eye, spacing: float = 0.1) -> dict[str, Path]:
    """Write the meshes of an eye into an existing folder, all or none; returns the files by name.

    Binary PLY with normals, and u, v for the iris; see `eye_meshes`.

    **Raises:** `OSError` naming the file; `ValueError` for a spacing that is no positive number.
    """
    meshes = eye_meshes(eye, spacing)
    files = {name: Path(folder) / f"{name}.ply" for name in meshes}
    write_together({files[name]: encode_ply(mesh) for name, mesh in meshes.items()})
    return files


def encode_ply(mesh: Mesh) -> bytes:
    """Binary PLY with normals, and u, v where the mesh has them."""
    import trimesh
    from trimesh.exchange.ply import export_ply

    made = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False)
    if mesh.uv is not None:
        made.vertex_attributes.update(
            u=mesh.uv[:, 0].astype(np.float32), v=mesh.uv[:, 1].astype(np.float32)
        )
    return export_ply(made, vertex_normal=True)


def encode_obj(mesh: Mesh, name: str, texture: str | None = None) -> dict[str, bytes]:
    """The files `name`.obj and, where the mesh has uv, `name`.mtl, whose base colour is the file
    `texture`.
    """
    import trimesh
    from trimesh.exchange.obj import export_obj
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import SimpleMaterial

    made = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False)
    if mesh.uv is not None:
        white = SimpleMaterial(name=name, ambient=[255] * 3, diffuse=[255] * 3, specular=[0] * 3)
        made.visual = TextureVisuals(uv=mesh.uv, material=white)
    text, more = export_obj(
        made,
        include_normals=True,
        return_texture=True,
        mtl_name=f"{name}.mtl",
        header="simulated by irisjax",
    )
    files = {f"{name}.obj": text.encode()}
    for other, data in more.items():
        files[other] = data + (b"" if texture is None else f"\nmap_Kd {texture}\n".encode())
    return files


def right_handed(mesh: Mesh) -> Mesh:
    """The same mesh in the frame of other renderers: x right, y up, +z out of the eye towards the
    viewer.

    The eye's own frame (+z into the eye) is left-handed: read as it stands, its meshes show a
    mirrored iris.
    """
    turn = np.array([1.0, 1.0, -1.0])
    return Mesh(mesh.vertices * turn, mesh.normals * turn, mesh.uv, mesh.faces[:, ::-1])


def eye_meshes(eye: Eye, spacing: float = 0.1) -> dict[str, Mesh]:
    """Meshes of what the eye has, with triangles of about `spacing` mm.

    - `anterior`: cap of the cornea from the apex to the limbus: air outside, `cornea.index` inside
        (with one surface: `aqueous_index`).
    - `posterior`: `cornea.index` outside, `aqueous_index` inside. It ends where it meets the plane
        or cone of the iris, so that no ray reaches the iris unrefracted.
    - `iris`: from the pupil's edge to the root. u = angle / 2π from +x towards +y, v = 0 at the
        pupil and 1 at the root: an image of it has the columns for rows and the rows for columns of
        `IrisMaps`.
    - `sclera`: sphere through the limbus, without the part that the cornea replaces.

    Caps are open: an interface acts by the side of its normal a ray comes from. Anterior cornea and
    sclera share the points of the limbus and close the eye together.
    """
    check_range("spacing", spacing, Range(0, math.inf, "mm", above=True))
    limbus, root, pupil = float(eye.limbus_radius), float(eye.iris_radius), float(eye.pupil_radius)
    around = max(12, math.ceil(2 * math.pi * limbus / spacing))
    meshes = {}
    if eye.cornea is not None:
        meshes["anterior"] = _cap(eye.cornea.anterior, limbus, spacing, around)
        if eye.cornea.posterior is not None:
            meshes["posterior"] = _cap(
                eye.cornea.posterior, _reach(eye, eye.cornea.posterior), spacing, around
            )

    r = np.linspace(pupil, root, _steps(root - pupil, spacing))
    slope = 0.0 if eye.iris_slope is None else float(eye.iris_slope)
    # A seam: the points at u = 1 are those at u = 0 once more.
    points, faces = revolved(r, float(eye.iris_depth) + slope * r, around, seam=True)
    u, v = np.meshgrid(np.arange(around + 1) / around, (r - pupil) / (root - pupil))
    meshes["iris"] = Mesh(
        points,
        _double(eye.iris_normal(jnp.asarray(points, float))),
        np.stack([u.ravel(), v.ravel()], -1),
        faces,
    )

    if eye.sclera is not None:
        radius = float(eye.sclera.radius)
        edge = 0.0 if eye.cornea is None else float(_depth(eye.cornea.anterior, limbus))
        centre = edge + math.sqrt(radius**2 - limbus**2)
        start = math.asin(limbus / radius)
        angle = np.linspace(start, math.pi, _steps(radius * (math.pi - start), spacing))
        r, z = radius * np.sin(angle), centre - radius * np.cos(angle)
        r[0], z[0], r[-1] = limbus, edge, 0.0
        points, faces = revolved(r, z, around)
        meshes["sclera"] = Mesh(points, (points - [0, 0, centre]) / radius, None, faces)
    return meshes


def _steps(length: float, spacing: float) -> int:
    return max(3, math.ceil(length / spacing) + 1)


def _cap(surface: Conicoid, edge: float, spacing: float, around: int) -> Mesh:
    r = np.linspace(
        0,
        edge,
        _steps(math.hypot(edge, float(_depth(surface, edge) - _depth(surface, 0))), spacing),
    )
    points, faces = revolved(r, _depth(surface, r), around)
    return Mesh(points, _double(surface.normal(jnp.asarray(points, float))), None, faces)


def _depth(surface: Conicoid, r) -> np.ndarray:
    return _double(surface.apex + surface.sagitta(jnp.asarray(r, float)))


def _double(x) -> np.ndarray:
    return np.asarray(x, np.float64)


def _reach(eye: Eye, surface: Conicoid) -> float:
    """Radius at which a surface meets that of the iris; its equator, if it ends before."""
    radius, p = float(surface.radius), float(surface.shape)
    slope = 0.0 if eye.iris_slope is None else float(eye.iris_slope)
    low, high = 0.0, radius / math.sqrt(p) if p > 0 else 4 * radius
    for _ in range(60):
        middle = (low + high) / 2
        above = _depth(surface, middle) < float(eye.iris_depth) + slope * middle
        low, high = (middle, high) if above else (low, middle)
    return low


def revolved(
    r: np.ndarray, z: np.ndarray, around: int, seam: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a profile turned about z; rings of radius 0 are single points at
    either end.

    Normals lie to the left of the profile's course (to −z where r grows).
    """
    angle = np.arange(around + seam) * (2 * math.pi / around)
    cos, sin = np.cos(angle), np.sin(angle)
    cos[around:], sin[around:] = 1.0, 0.0
    tip_first, tip_last = r[0] == 0, r[-1] == 0
    rings = slice(int(tip_first), len(r) - int(tip_last))
    ring_r, ring_z = r[rings, None], np.broadcast_to(z[rings, None], (len(r[rings]), len(cos)))
    body = np.stack([ring_r * cos, ring_r * sin, ring_z], -1).reshape(-1, 3)
    width = len(cos)
    index = np.arange(len(body)).reshape(-1, width)
    after = index[:, 1:] if seam else np.roll(index, -1, axis=1)
    here = index[:, :-1] if seam else index
    a, b, c, d = (x.ravel() for x in (here[:-1], after[:-1], here[1:], after[1:]))
    faces = [np.stack([a, b, c], -1), np.stack([b, d, c], -1)]
    points = [body]
    for tip, place, at in ((tip_first, 0, 0), (tip_last, -1, -1)):
        if tip:
            point = np.full(here.shape[1], sum(map(len, points)))
            points.append(np.array([[0.0, 0.0, z[at]]]))
            corners = (
                (point, after[place], here[place])
                if place == 0
                else (point, here[place], after[place])
            )
            faces.append(np.stack(corners, -1))
    return np.concatenate(points), np.concatenate(faces)
