"""Lids, lashes and skin about an eye, for Mitsuba: what hides parts of an iris in photographs.

Right-handed frame: mm, x right, y up, z out of the eye. All made up, drawn from no face.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import mesh_files

SKIN = 0.55, 0.36, 0.27
"""Albedo, linear sRGB."""
LASH = 0.03, 0.02, 0.015
WIDEST = 12.5
"""Half the length of the lids, mm."""
INNER, OUTER = 12.1, 13.1
"""Distance of their inner and outer side from the middle of the globe, mm."""
EDGES = 4.3, -5.3
"""Height of the lids' edges above the eye's middle, mm: the upper one hides the top of the iris,
the lower one its rim.
"""


def face() -> dict[str, Any]:
    """Skin behind the globe, where the lids end."""
    import mitsuba as mi

    place = mi.ScalarTransform4f().translate([0, 0, -8]).scale(60)
    return {"face": {"type": "rectangle", "to_world": place, "bsdf": _matt(SKIN)}}


def lids(eye: Eye, folder: Path, seed: int) -> dict[str, Any]:
    """Both lids and the upper one's lashes, four of which hang before the iris; files go to a
    folder.
    """
    shapes = {}
    for name, mesh in lid_meshes(eye).items():
        path = folder / f"{name}_lid.ply"
        path.write_bytes(mesh_files({name: mesh})[f"{name}.ply"])
        shapes[name] = {"type": "ply", "filename": str(path), "bsdf": _matt(SKIN)}
    return {**shapes, "lashes": lashes(eye, folder, np.random.default_rng(seed))}


def lid_meshes(eye: Eye, edges: tuple[float, float] = EDGES) -> dict[str, trimesh.Trimesh]:
    """Both lids; 161 points along each, in rows from the inner side over the edge and away."""
    return {
        name: _lid(_globe(eye), up, edge)
        for name, up, edge in (("upper", 1, edges[0]), ("lower", -1, edges[1]))
    }


def lashes(eye: Eye, folder: Path, random: np.random.Generator, edge: float = EDGES[0]):
    """Lashes of an upper lid whose edge is that high."""
    file = folder / "lashes.txt"
    file.write_text("\n\n".join(_lashes(_globe(eye), random, edge)) + "\n")
    return {"type": "bsplinecurve", "filename": str(file), "bsdf": _matt(LASH)}


def _globe(eye: Eye) -> float:
    """z of the middle of the globe, mm."""
    assert eye.cornea is not None
    assert eye.sclera is not None
    limbus = float(eye.limbus_radius)
    edge = float(eye.cornea.anterior.sagitta(eye.limbus_radius) + eye.cornea.anterior.apex)
    return -edge - math.sqrt(float(eye.sclera.radius) ** 2 - limbus**2)


def _margin(x, up: int, edge: float):
    """Height of a lid's edge, mm, `edge` in its middle."""
    return edge - 0.034 * x**2 if up > 0 else edge + 0.022 * x**2


def _on_sphere(x, y, centre: float, radius):
    return centre + np.sqrt(np.maximum(radius**2 - x**2 - y**2, 4.0))


def _lid(centre: float, up: int, edge: float) -> trimesh.Trimesh:
    """From the inner side over a rounded edge and away from the eye."""
    x = np.linspace(-WIDEST, WIDEST, 161)
    turn = np.linspace(-math.pi / 2, math.pi / 2, 13)
    half = (OUTER - INNER) / 2
    away = np.concatenate([half * (1 - np.cos(turn)), np.linspace(half, 12, 40)[1:]])
    radius = np.concatenate([(INNER + OUTER) / 2 + half * np.sin(turn), np.full(39, OUTER)])
    x, away = np.meshgrid(x, away)
    y = _margin(x, up, edge) + up * away
    points = np.stack([x, y, _on_sphere(x, y, centre, radius[:, None])], -1)
    rows, columns = x.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])
    return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)


def _lashes(centre: float, random: np.random.Generator, edge: float) -> list[str]:
    """Control points and radii, a curve each."""
    curves = []
    for i in range(70):
        hanging = i < 4
        x = random.uniform(-4, 4) if hanging else random.uniform(-9, 9)
        y = _margin(x, 1, edge) + random.uniform(0, 0.4)
        length = random.uniform(5, 6) if hanging else random.uniform(4.5, 7)
        droop = random.uniform(1.3, 1.5) if hanging else random.uniform(0.5, 0.85)
        aside = 0.07 * x + random.normal(0, 0.15)
        t = np.linspace(-0.1, 1, 8)
        path = np.stack(
            [
                x + length * aside * t,
                y + length * (0.6 * t**2 - droop * t),
                _on_sphere(x, y, centre, OUTER - 0.2) + length * (0.8 * t - 0.2 * t**2),
                0.055 * (1.05 - np.clip(t, 0, 1)),
            ],
            -1,
        )
        curves.append("\n".join(" ".join(f"{v:.5f}" for v in p) for p in path))
    return curves


def _matt(albedo) -> dict[str, Any]:
    rgb = {"type": "rgb", "value": list(albedo)}
    return {"type": "twosided", "of": {"type": "diffuse", "reflectance": rgb}}
