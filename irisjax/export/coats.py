"""Painted coats as triangles: each its cones, with its picture as texture  [L03 Section 3.1]."""

import io
import math
from pathlib import Path

import numpy as np
from PIL import Image

from irisjax.anatomy.eye import Eye
from irisjax.export.mesh import Mesh, encode_obj, encode_ply, revolved, right_handed
from irisjax.io.tables import write_together
from irisjax.measure.colour import srgb_encode
from irisjax.numerics.checks import check_whole
from irisjax.ocularist.coats import Coat, Painting
from irisjax.ocularist.cones import Cones
from irisjax.ocularist.shell import shell

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
    folder: str | Path,
    painting: Painting,
    form: str = "obj",
    around: int = AROUND,
    eye: Eye | None = None,
) -> dict[str, Path]:
    """Write the files of `painting_files` into an existing folder, all or none. Returns the meshes'
    files by the coats' names.

    Raises:
        ValueError: for an unknown form. OSError: naming a file that cannot be written.
    """
    files = painting_files(painting, form, around, eye)
    write_together({Path(folder) / name: data for name, data in files.items()})
    names = [coat.name for coat in painting.coats] + ([] if eye is None else ["cornea", "white"])
    return {name: Path(folder) / f"{_stem(name)}.{form}" for name in names}


def painting_files(
    painting: Painting, form: str = "obj", around: int = AROUND, eye: Eye | None = None
) -> dict[str, bytes]:
    """Files, by their names, of a mesh of every coat and its picture with opacity; of an `eye` also
    its `cornea` and `white`, without pictures.

    Meshes are in the frame of other renderers, x right, y up, +z towards the viewer, mm. Files bear
    the coats' names, with underscores for spaces.

    Raises:
        ValueError: for an unknown form.
    """
    if form not in FORMATS:
        raise ValueError(f"unknown kind of mesh {form!r}; known: {', '.join(FORMATS)}")
    meshes = {coat.name: coat_mesh(painting, coat.name, around) for coat in painting.coats}
    if eye is not None:
        outside = shell(eye)._asdict()
        meshes |= {name: cone_mesh(cones, around) for name, cones in outside.items()}
    files = {f"{_stem(coat.name)}.png": _picture(coat) for coat in painting.coats}
    for name, mesh in meshes.items():
        stem, mesh = _stem(name), right_handed(mesh)
        picture = f"{stem}.png" if f"{stem}.png" in files else None
        if form == "ply":
            files[f"{stem}.ply"] = encode_ply(mesh)
        else:
            files |= encode_obj(mesh, stem, picture)
    return files


def _stem(name: str) -> str:
    return name.replace(" ", "_")


def _picture(coat: Coat) -> bytes:
    """A PNG of colour and opacity."""
    opacity = np.asarray(coat.opacity)[..., None]
    colour = np.asarray(srgb_encode(np.asarray(coat.colour)))
    both = np.concatenate([np.broadcast_to(colour, (*opacity.shape[:2], 3)), opacity], -1)
    data = io.BytesIO()
    Image.fromarray(np.rint(255 * both).astype(np.uint8)).save(data, "png")
    return data.getvalue()
