"""Painted coats as triangles: each its cones, with its picture as texture  [L03 Section 3.1]."""

import io
import math
from pathlib import Path

import numpy as np
from PIL import Image

from irisjax.export.mesh import Mesh, encode_obj, encode_ply, revolved, right_handed
from irisjax.io.tables import write_together
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import check_whole
from irisjax.ocularist.coats import Coat, Painting
from irisjax.ocularist.cones import Cones

AROUND = 256
"""Points round the axis."""
FORMATS = "obj", "ply"
"""Kinds of file that hold meshes."""


def cone_mesh(cones: Cones, around: int = AROUND) -> Mesh:
    """Triangles of a stack of cones, mm in the eye's frame; each cone has corners of its own, so
    that seams stay sharp.

    u and v are those of a picture seen from ahead whose sides touch the widest circle: u = 0 at its
    left, v = 0 at its foot.

    Raises:
        ValueError: for fewer than 3 points round the axis.
    """
    check_whole("around", around, 3)
    z, radius = (np.asarray(v, np.float64) for v in (cones.z, cones.radius))
    points, normals, faces, count = [], [], [], 0
    for i in range(len(z) - 1):
        body, corners = revolved(radius[i : i + 2], z[i : i + 2], around)
        x, y, _ = body.T
        rise, out = z[i + 1] - z[i], radius[i + 1] - radius[i]
        r = np.hypot(x, y)
        # A tip has no side: its normal is along the axis.
        r = np.where(r > 0, r, math.inf)
        normal = np.stack([rise * x / r, rise * y / r, np.full_like(x, -out)], -1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        points.append(body)
        normals.append(normal / np.where(length > 0, length, 1.0))
        faces.append(corners + count)
        count += len(body)
    every = np.concatenate(points)
    uv = (every[:, :2] / radius.max() + 1) / 2
    return Mesh(every, np.concatenate(normals), uv, np.concatenate(faces))


def coat_mesh(painting: Painting, name: str, around: int = AROUND) -> Mesh:
    """`cone_mesh` of one coat.

    Raises:
        ValueError: for a name that no coat has.
    """
    height = float(painting.coat(name).height)
    return cone_mesh(Cones(painting.profile.z - height, painting.profile.radius), around)


def write_painting(
    folder: str | Path, painting: Painting, form: str = "obj", around: int = AROUND
) -> dict[str, Path]:
    """Write a mesh of every coat and its picture with opacity into an existing folder, all or none.

    Meshes are in the frame of other renderers, x right, y up, +z towards the viewer. Returns the
    meshes' files by the coats' names; spaces become underscores.

    Raises:
        ValueError: for an unknown form. OSError: naming a file that cannot be written.
    """
    if form not in FORMATS:
        raise ValueError(f"unknown kind of mesh {form!r}; known: {', '.join(FORMATS)}")
    files, found = {}, {}
    for coat in painting.coats:
        mesh = right_handed(coat_mesh(painting, coat.name, around))
        stem = coat.name.replace(" ", "_")
        picture = f"{stem}.png"
        files[Path(folder) / picture] = _picture(coat)
        found[coat.name] = Path(folder) / f"{stem}.{form}"
        if form == "ply":
            files[found[coat.name]] = encode_ply(mesh)
        else:
            made = encode_obj(mesh, stem, picture)
            files |= {Path(folder) / name: data for name, data in made.items()}
    write_together(files)
    return found


def _picture(coat: Coat) -> bytes:
    """A PNG of colour and opacity."""
    opacity = np.asarray(coat.opacity)[..., None]
    colour = np.asarray(srgb_encode(np.asarray(coat.colour)))
    both = np.concatenate([np.broadcast_to(colour, (*opacity.shape[:2], 3)), opacity], -1)
    data = io.BytesIO()
    Image.fromarray(np.rint(255 * both).astype(np.uint8)).save(data, "png")
    return data.getvalue()
