"""A second set of simulated photographs, by a light model other than irisjax's, with their truth.

Light in the iris is path traced through a volume (`volumetric_iris.py`), in the eye by paths
through the cornea; then a camera and its software make a JPEG of it. Nothing in irisjax is chosen
by these photographs.

The scene: the cornea's two surfaces, a white with vessels whose edge lies softly on the cornea,
lids of skin, lashes, windows and lamps mirrored in the tear film, a pupil off the axis, in some
eyes an oval limbus. All shapes but the pupil are the package's.

Approximations: the iris's reflectance is traced once, from above, in the light that reaches its
middle through the cornea, without noise by local regression; the irradiance is then traced on each
place of the flat iris, and what the iris sends back is the product. Light that goes from the iris
to the cornea and back is left out. The white is matt with the colours of a translucent one (no
light spreads in it), as are the lids; light has three channels outside of the iris.

Mitsuba's frame: mm, x right, y up, z out of the eye.
"""

import dataclasses
import io
import json
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image
from scipy import ndimage
from skimage import measure, restoration

from experiments.common import start
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.anatomy.sclera import limbus_depth
from irisjax.export.mesh import eye_meshes, right_handed
from irisjax.grow.vessels import veins
from irisjax.measure.colour import srgb_encode
from irisjax.photo.photograph import Ellipse, ellipse_through
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.outside import colour_table, sample_veins
from irisjax.render.surfaces import GlobeSurface

FOLDER = Path(__file__).parent.parent / "data" / "photographs" / "volumetric"
SIZE = (800, 600)
WIDTH, DISTANCE = 17.6, 250.0
"""Width of the field at the pupil and distance of the camera, mm: the iris is 500 px across."""
SOFT = 0.7
"""Width over which the white's edge fades on the cornea, mm; its middle is the limbus."""
LIMBUS = 5.5
"""Radius of the limbus across, mm."""
MOST = 60_000
"""Largest file, bytes."""
ABOUT = "photographs simulated by Mitsuba 3's volumetric path tracer; see README.md"
_WHITE = 0.85  # linear value of the bright part of the white
_SKIN = 0.47, 0.29, 0.215
_MAP = 192  # rows of the shipped map of thickness
_MELANIN_MAP = 96


@dataclass(frozen=True)
class Lamp:
    """Part of the environment: a window (with a cross of `bars`) or a soft box.

    Attributes:
        towards: Angles to the right of and above straight ahead, degrees.
        half: Half its width and height, degrees.
        radiance: Linear sRGB.
        bars: Half the width of the bars, degrees; 0 for none.
        round: Whether it is an ellipse.
    """

    towards: tuple[float, float]
    half: tuple[float, float]
    radiance: tuple[float, float, float]
    bars: float = 0.0
    round: bool = False


@dataclass(frozen=True)
class Shot:
    """One photograph.

    Attributes:
        kind: Name of the tissue in `KINDS`.
        lamps: Windows and soft boxes.
        room: Radiance from everywhere else.
        tilt: Polar angle and azimuth of the camera, degrees.
        oval: Height of the eye's shapes over their width.
        lids: Heights of the lids' edges above the eye's middle, mm; `None` for no lids.
        gains: White balance that is off, red, green and blue.
        contrast: Strength of the tone curve.
        exposure: Factor on the usual exposure.
        electrons: Of a full pixel.
        sharpened: Strength of the unsharp mask.
        focal: Whether the file tells the focal length.
    """

    kind: str
    lamps: tuple[Lamp, ...]
    room: float = 0.2
    tilt: tuple[float, float] = (0.0, 0.0)
    oval: float = 1.0
    lids: tuple[float, float] | None = (4.3, -5.3)
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    contrast: float = 0.3
    exposure: float = 1.0
    electrons: float = 3000.0
    sharpened: float = 0.5
    focal: bool = True


@dataclass(frozen=True)
class Effort:
    """How much is traced: `cells` and `layers` of the tissue and `samples` a cell; samples a pixel
    of the iris (`seen`) and of the rest (`outside`); cells and samples of the irradiance.
    """

    cells: int = 384
    layers: int = 12
    samples: int = 10
    seen: int = 8
    outside: int = 16
    counted: int = 64
    lit: int = 384
    spacing: float = 0.1


QUICK = Effort(24, 4, 2, 2, 2, 8, 8, 0.6)
_DAY = (1.0, 1.06, 1.2)
_WARM = (1.15, 1.0, 0.8)


def _times(radiance: float, tint=(1.0, 1.0, 1.0)) -> tuple[float, float, float]:
    r, g, b = (radiance * t for t in tint)
    return r, g, b


SHOTS: dict[str, Shot] = {
    # A window beside the camera, seen half over the pupil.
    "blue": Shot(
        "blue",
        (Lamp((-28, 26), (11, 14), _times(9, _DAY), bars=1.2),),
        room=0.22,
        gains=(0.96, 1.0, 1.05),
    ),
    # A ring of brown in a grey-green eye; a soft box; turned aside.
    "hazel": Shot(
        "hazel",
        (Lamp((22, 30), (13, 9), _times(9)), Lamp((-50, 10), (8, 16), _times(2.5, _DAY))),
        tilt=(16, 200),
        gains=(1.05, 1.0, 0.96),
        lids=(4.6, -5.5),
        focal=False,
    ),
    # Wide sky before a dark eye.
    "brown": Shot(
        "brown",
        (Lamp((0, 42), (38, 13), _times(4, _DAY), bars=1.0),),
        room=0.3,
        oval=0.96,
        exposure=1.05,
        contrast=0.45,
        focal=False,
    ),
    # Two round soft boxes; oval.
    "green": Shot(
        "green",
        (
            Lamp((30, 24), (7, 7), _times(14), round=True),
            Lamp((-30, 24), (7, 7), _times(14), round=True),
        ),
        room=0.12,
        oval=0.95,
        lids=(5.0, -5.6),
        sharpened=0.7,
    ),
    # A tall window from the side, dim room, noise.
    "grey": Shot(
        "grey",
        (Lamp((42, 12), (9, 22), _times(8, _DAY), bars=0.9),),
        room=0.15,
        tilt=(12, 30),
        gains=(1.06, 1.0, 0.93),
        electrons=1200,
        exposure=0.8,
        focal=False,
    ),
}


def main(key, quick=False, out=FOLDER, names=tuple(SHOTS)):
    """Write photographs, maps of their truth and truth.json (quick: the first, 80 pixels wide);
    with `names` some of them, beside those that truth.json has.
    """
    import mitsuba as mi

    # Old versions of LLVM end the process: what tests run needs none.
    mi.set_variant("scalar_rgb" if quick else "llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Warn)
    out.mkdir(parents=True, exist_ok=True)
    seed, file = int(jax.random.key_data(key)[-1]), out / "truth.json"
    for name in names[: 1 if quick else None]:
        shot, rng = SHOTS[name], np.random.default_rng([seed, list(SHOTS).index(name)])
        size, effort = ((80, 60), QUICK) if quick else (SIZE, Effort())
        with tempfile.TemporaryDirectory() as made:
            linear, truth = take(shot, size, effort, rng, Path(made))
        data = developed(linear, shot, truth["exposure"], size, rng)
        (out / f"{name}.jpg").write_bytes(data)
        np.savez_compressed(out / f"{name}.npz", **truth.pop("maps"))
        known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        truths = {t["file"]: t for t in known.get("photographs", ())}
        truths[f"{name}.jpg"] = {"file": f"{name}.jpg", "maps": f"{name}.npz", **truth}
        every = [truths[f"{n}.jpg"] for n in SHOTS if f"{n}.jpg" in truths]
        text = json.dumps({"about": ABOUT, "seed": seed, "photographs": every}, indent=1)
        file.write_text(text + "\n", encoding="utf-8")
        print(f"{name}.jpg: {len(data)} bytes, iris over white {truth['iris_over_white']:.2f}")


def take(shot: Shot, size, effort: Effort, rng, folder: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Linear picture (rows, columns, 3) of an eye, and its truth."""
    from experiments import volumetric_iris as iris

    kind = iris.KINDS[shot.kind]
    tissue = iris.grow(kind, effort.cells, effort.layers, rng)
    environment = _environment(shot)
    inner = _within_chamber(environment.mean(-1))
    reflectance = iris.albedo(tissue, inner, effort.samples, int(rng.integers(1 << 16)))
    scene = _Scene(shot, size, effort, folder, int(rng.integers(1 << 16)))
    linear = scene.picture(reflectance, tissue.pupil, environment)
    truth = _truth(scene, tissue, kind, linear, iris)
    return linear, truth


def _environment(shot: Shot, rows: int = 256) -> np.ndarray:
    """Radiance (rows, 2 rows, 3) from everywhere: a room that is brighter above, lamps, and whoever
    holds the camera, dark before them.
    """
    from experiments.volumetric_iris import directions

    x, y, z = np.moveaxis(directions(rows, 2 * rows)[0], -1, 0)
    right, up = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(np.clip(y, -1, 1)))
    level = shot.room * (0.9 + 0.5 * y)
    tint = np.stack([1 - 0.05 * y, np.ones_like(y), 1 + 0.08 * y], -1)
    light = level[..., None] * tint
    polar, azimuth = map(math.radians, shot.tilt)
    sideways = math.degrees(math.atan2(math.sin(polar) * math.cos(azimuth), math.cos(polar)))
    above = math.degrees(math.asin(math.sin(polar) * math.sin(azimuth)))
    aside, over = right - sideways, up - above
    head = (aside / 7) ** 2 + (over / 10) ** 2 < 1
    body = (aside / 22) ** 2 + ((over + 42) / 32) ** 2 < 1
    light *= 1 - 0.8 * ndimage.gaussian_filter((head | body).astype(float), 1.5)[..., None]
    for lamp in shot.lamps:
        across, along = (
            (a - t) / h for a, t, h in zip((right, up), lamp.towards, lamp.half, strict=True)
        )
        if lamp.round:
            inside = across**2 + along**2 < 1
        else:
            inside = (np.abs(across) < 1) & (np.abs(along) < 1)
        if lamp.bars:
            bar = np.minimum(np.abs(across) * lamp.half[0], np.abs(along) * lamp.half[1])
            inside = inside & (bar > lamp.bars)
        shade = (1 + 0.25 * np.clip(along, -1, 1))[..., None]
        light = np.where(inside[..., None], np.asarray(lamp.radiance) * shade, light)
    return light


def _within_chamber(light: np.ndarray, rows: int = 32) -> np.ndarray:
    """Radiance (rows, 2 rows) as it comes to the middle of the iris, through a spherical cornea."""
    from experiments.volumetric_iris import directions

    eye = Eye()
    assert eye.cornea is not None
    index, radius = float(eye.aqueous_index), float(eye.cornea.anterior.radius)
    depth = float(eye.iris_depth)
    d = directions(rows, 2 * rows)[0].reshape(-1, 3)
    # From the iris to the sphere whose middle lies behind it.
    middle = np.array([0, 0, depth - radius])
    along = d @ middle
    t = along + np.sqrt(along**2 - middle @ middle + radius**2)
    point = t[:, None] * d
    normal = (point - middle) / radius
    cosine = (d * normal).sum(-1)
    square = 1 - index**2 * (1 - cosine**2)
    out = index * d + (np.sqrt(np.maximum(square, 0)) - index * cosine)[:, None] * normal
    seen = (square > 0) & (np.hypot(point[:, 0], point[:, 1]) < LIMBUS) & (d[:, 2] > 0)
    soft = ndimage.gaussian_filter(light, 0.02 * len(light), mode=("nearest", "wrap"))
    row = np.arccos(np.clip(out[:, 1], -1, 1)) / math.pi * len(light)
    column = np.arctan2(out[:, 0], -out[:, 2]) % (2 * math.pi) / math.pi * len(light)
    place = row.astype(int).clip(0, len(light) - 1), column.astype(int) % light.shape[1]
    return np.where(seen, soft[place], 0).reshape(rows, 2 * rows)


class _Scene:
    """Shapes of an eye, and what Mitsuba renders of them."""

    def __init__(self, shot: Shot, size, effort: Effort, folder: Path, seed: int) -> None:
        from experiments import lids

        self.shot, self.effort, self.folder, self.seed = shot, effort, folder, seed
        # The shapes meet where the white has faded in; the limbus is halfway.
        self.eye = Eye(limbus_radius=jnp.asarray(LIMBUS + SOFT / 2), sclera=Sclera())
        polar, azimuth = map(math.radians, shot.tilt)
        self.camera = Camera(polar, azimuth, DISTANCE, WIDTH, size)
        rng = np.random.default_rng(seed)
        meshes = eye_meshes(self.eye, effort.spacing)
        globe = meshes["sclera"]
        colours = _white_colours(self.eye, globe.vertices, seed)
        self.matt = {"sclera": self._file("sclera", right_handed(globe), colours=colours)}
        self.glass = {n: self._file(n, right_handed(meshes[n])) for n in ("anterior", "posterior")}
        self.iris = self._file("iris", self._disc(), uv=True)
        self.fading = self._fading()
        self.hair = {}
        if shot.lids is not None:
            for name, mesh in lids.lid_meshes(self.eye, shot.lids).items():
                self.matt[name] = self._file(name, mesh, colours=_skin_colours(mesh.vertices, rng))
            self.hair = {"lashes": lids.lashes(self.eye, folder, rng, shot.lids[0]), **lids.face()}

    def picture(self, reflectance: np.ndarray, pupil: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Linear sRGB (rows, columns, 3)."""
        import mitsuba as mi

        from experiments import eye_in_mitsuba as eyes

        around = {
            "room": {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(light, np.float32))}
        }
        self.irradiance = self._irradiance(around)
        radiance = reflectance * self._at_cells(self.irradiance, len(reflectance)) / math.pi
        seen = self.through_cornea(radiance * _coverage(pupil)[..., None], self.effort.seen)
        index = float(self.eye.cornea.index)  # pyright: ignore[reportOptionalMemberAccess]
        # A conductor without absorption mirrors as the cornea does, see `eye_in_mitsuba`.
        mirror = {"type": "conductor", "eta": eyes.rgb([index] * 3), "k": eyes.rgb([0.0] * 3)}
        front = {"anterior": {**self.glass["anterior"], "bsdf": mirror}}
        shapes = {**front, **self._coloured(), **self.hair, **around}
        sensor = eyes.sensor_of(self.camera, self.eye)
        outside = eyes.traced(shapes, sensor, self.effort.outside, self.seed + 3, depth=5)
        outside = _without_noise(outside)
        self.iris_light, self.outside_light = seen, outside
        return seen + outside

    def through_cornea(self, radiance: np.ndarray, samples: int) -> np.ndarray:
        """Trace the picture of an iris of some radiance on its cells, behind cornea and lids."""
        import mitsuba as mi

        from experiments import eye_in_mitsuba as eyes

        fine = ndimage.zoom(radiance, (2, 2, 1), order=1, grid_mode=True, mode="nearest")
        bitmap = mi.Bitmap(np.ascontiguousarray(fine, np.float32))
        texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
        black = eyes.matt([0.0] * 3)
        iris = {**self.iris, "bsdf": black, "light": {"type": "area", "radiance": texture}}
        dark = {n: {**s, "bsdf": _both_sides(black)} for n, s in {**self.matt, **self.hair}.items()}
        shapes = {**self._refracting(), **dark, "fading": self._fade(black), "iris": iris}
        sensor = eyes.sensor_of(self.camera, self.eye)
        return eyes.traced(shapes, sensor, samples, self.seed + 2, depth=5)

    def _irradiance(self, around) -> np.ndarray:
        """Irradiance (rows from -y, columns from -x, 3) on a square of the iris plane of the half
        width `eye_in_mitsuba.HALF`.
        """
        from experiments import eye_in_mitsuba as eyes

        cells, grey, start = self.effort.counted, 0.02, -1.0
        depth = float(self.eye.iris_depth) + start
        sensor = {
            "type": "perspective",
            "to_world": eyes.look_at([0, 0, start], [0, 0, start - 1]),
            "fov": 2 * math.degrees(math.atan(eyes.HALF / depth)),
            "near_clip": 1e-3,
            "film": eyes.film_of(cells, cells),
        }
        iris = {**self.iris, "bsdf": eyes.matt([grey] * 3)}
        shapes = {**self._refracting(), **self._coloured(), **self.hair, "iris": iris, **around}
        found = eyes.traced(shapes, sensor, self.effort.lit, self.seed + 1, depth=6)
        found = found[::-1] * (math.pi / grey)
        spread = 0.3 * cells / (2 * eyes.HALF)
        line = (np.arange(cells) + 0.5) * (2 * eyes.HALF / cells) - eyes.HALF
        inside = (np.hypot(*np.meshgrid(line, line)) < LIMBUS).astype(float)
        weight = np.maximum(ndimage.gaussian_filter(inside, spread), 1e-6)
        return np.stack(
            [ndimage.gaussian_filter(found[..., c] * inside, spread) / weight for c in range(3)], -1
        )

    def _at_cells(self, irradiance: np.ndarray, cells: int) -> np.ndarray:
        """Irradiance at the middles of the tissue's cells."""
        from experiments import eye_in_mitsuba as eyes
        from experiments.volumetric_iris import grid

        x, y = grid(cells)
        place = [((c + eyes.HALF) * len(irradiance) / (2 * eyes.HALF) - 0.5) for c in (y, x)]
        place = np.stack(np.broadcast_arrays(*place))
        return np.stack(
            [
                ndimage.map_coordinates(irradiance[..., c], place, order=1, mode="nearest")
                for c in range(3)
            ],
            -1,
        )

    def _refracting(self) -> dict[str, Any]:
        from experiments.eye_in_mitsuba import dielectric

        assert self.eye.cornea is not None
        index, aqueous = float(self.eye.cornea.index), float(self.eye.aqueous_index)
        return {
            "anterior": {**self.glass["anterior"], "bsdf": dielectric(index, 1.0)},
            "posterior": {**self.glass["posterior"], "bsdf": dielectric(aqueous, index)},
        }

    def _coloured(self) -> dict[str, Any]:
        """White and lids as they look in light."""
        own = {"type": "mesh_attribute", "name": "vertex_color"}
        wet = {"type": "principled", "base_color": own, "roughness": 0.15, "specular": 0.35}
        skin = {"type": "principled", "base_color": own, "roughness": 0.55, "specular": 0.4}
        shapes = {
            n: {**s, "bsdf": _both_sides(wet if n == "sclera" else skin)}
            for n, s in self.matt.items()
        }
        from experiments.eye_in_mitsuba import matt

        return {**shapes, "fading": self._fade(matt(self.edge))}

    def _fade(self, bsdf) -> dict[str, Any]:
        import mitsuba as mi

        share = np.linspace(0, 1, 64, dtype=np.float32)
        opacity = (share * share * (3 - 2 * share))[None, :, None]
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(opacity), "raw": True}
        texture["wrap_mode"] = "clamp"
        mask = {"type": "mask", "opacity": texture, "of": _both_sides(bsdf)}
        return {**self.fading, "bsdf": mask}

    def _fading(self) -> dict[str, Any]:
        """A ring on the cornea where the white fades; u rises from its inner to the outer rim."""
        assert self.eye.cornea is not None
        share, turn = np.linspace(0, 1, 9), np.linspace(0, 2 * np.pi, 361)
        radius = LIMBUS + SOFT * (share - 0.5)
        front = self.eye.cornea.anterior
        height = 0.01 - np.asarray(front.apex + front.sagitta(jnp.asarray(radius)))
        points = np.stack(
            [
                np.outer(radius, np.cos(turn)),
                np.outer(radius, np.sin(turn)),
                np.broadcast_to(height[:, None], (len(radius), len(turn))),
            ],
            -1,
        )
        uv = np.stack(np.broadcast_arrays(share[:, None], 0.5 + 0 * turn), -1).reshape(-1, 2)
        # Shaded as the cornea within and as the globe beyond: no edge is seen between the two.
        slope = np.gradient(height, radius)
        middle = float(-limbus_depth(self.eye)) - math.sqrt(
            float(self.eye.sclera.radius) ** 2 - (LIMBUS + SOFT / 2) ** 2  # pyright: ignore[reportOptionalMemberAccess]
        )
        front_normal = np.stack([-slope, np.ones_like(slope)], -1)
        globe_normal = np.stack([radius, height - middle], -1)
        normal = [
            n / np.linalg.norm(n, axis=-1, keepdims=True) for n in (front_normal, globe_normal)
        ]
        normal = (1 - share[:, None]) * normal[0] + share[:, None] * normal[1]
        normals = np.stack(
            [
                np.outer(normal[:, 0], np.cos(turn)),
                np.outer(normal[:, 0], np.sin(turn)),
                np.broadcast_to(normal[:, 1:], points.shape[:2]),
            ],
            -1,
        ).reshape(-1, 3)
        self.edge = tuple(np.asarray(_white_of(self.eye)).tolist())
        return self._written(
            "fading", points.reshape(-1, 3), _faces(*points.shape[:2]), normals, uv=uv
        )

    def _disc(self):
        """The flat iris."""
        import trimesh

        reach = 5.74  # where the back of the cornea meets the plane
        radius, turn = np.linspace(0.01, reach, 40), np.linspace(0, 2 * np.pi, 181)
        points = np.stack(
            [
                np.outer(radius, np.cos(turn)),
                np.outer(radius, np.sin(turn)),
                np.full((40, 181), -float(self.eye.iris_depth)),
            ],
            -1,
        )
        faces = _faces(40, 181)
        return trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)

    def _file(self, name: str, mesh, colours=None, uv=False) -> dict[str, Any]:
        from experiments.volumetric_iris import HALF

        points = np.array(mesh.vertices, float)
        oval = self.shot.oval if name not in ("upper", "lower") else 1.0
        flat = (points * [1, oval, 1])[:, :2] / (2 * HALF) + 0.5 if uv else None
        normals = np.array(mesh.vertex_normals, float)
        return self._written(name, points, np.asarray(mesh.faces), normals, colours, flat)

    def _written(self, name, points, faces, normals=None, colours=None, uv=None) -> dict[str, Any]:
        """A PLY file; the eye's own shapes are made oval."""
        if name not in ("upper", "lower"):
            points = points * [1, self.shot.oval, 1]
            if normals is not None:
                normals = normals / [1, self.shot.oval, 1]
                normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        parts, names = [points], ["x", "y", "z"]
        for part, more in ((normals, "nx ny nz"), (uv, "u v"), (colours, "r g b")):
            if part is not None:
                parts.append(part)
                names += more.split()
        table = np.concatenate(parts, -1).astype("<f4")
        corners = np.zeros(len(faces), [("n", "u1"), ("i", "<i4", 3)])
        corners["n"], corners["i"] = 3, faces
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
        head += [f"property float {n}" for n in names]
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        path = self.folder / f"{name}.ply"
        text = "\n".join([*head, "end_header"]) + "\n"
        path.write_bytes(text.encode() + table.tobytes() + corners.tobytes())
        return {"type": "ply", "filename": str(path)}


def _faces(rows: int, columns: int) -> np.ndarray:
    """Triangles of a sheet of points; their front is where rows × columns point."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    return np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])


def _both_sides(bsdf) -> dict[str, Any]:
    return {"type": "twosided", "of": bsdf}


def _without_noise(light: np.ndarray) -> np.ndarray:
    """Non-local means of what skin, white and tear film send, on a scale of even noise."""
    root = np.sqrt(np.clip(light, 0, 4))
    # Each sample's noise is alone; second differences along both axes remove most of the picture.
    rough = np.diff(np.diff(root, 2, axis=0), 2, axis=1)
    bright = root[1:-1, 1:-1] > np.median(root)
    noise = float(np.median(np.abs(rough)[bright])) / 0.6745 / 6
    known: dict[str, Any] = {"patch_size": 5, "patch_distance": 5, "channel_axis": -1}
    found = restoration.denoise_nl_means(root, h=noise, sigma=noise, fast_mode=True, **known)
    return np.where(light > 4, light, found**2)


def _coverage(pupil: np.ndarray) -> np.ndarray:
    """Share of the iris's light about the pupil: none within, and a dark ruff at its edge."""
    inside = np.clip(0.5 + pupil / 0.03, 0, 1)
    return inside * (1 - 0.6 * np.exp(-((pupil / 0.04) ** 2)))


def _white_table(eye: Eye):
    assert eye.sclera is not None
    bands = colour_bands(all_wavelengths=True)
    return colour_table(eye.sclera, np.asarray(bands.wavelengths), bands.weights)


def _white_of(eye: Eye) -> np.ndarray:
    from irisjax.render.outside import Blood

    return np.asarray(_white_table(eye)(Blood(jnp.full(1, 2e-4))))[0]


def _white_colours(eye: Eye, points: np.ndarray, seed: int) -> np.ndarray:
    """Albedo of the white at points of the eye's frame, redder towards the corners of the lids."""
    grown = veins(eye, shape=(2048, 768), key=jax.random.key(seed))
    assert grown is not None
    place = GlobeSurface(eye).texture_coordinates(jnp.asarray(points))
    found = np.asarray(_white_table(eye)(sample_veins(grown, *place)))
    aside = np.clip((np.abs(points[:, :1]) - 7) / 4, 0, 1)
    return np.clip(found * (1 - aside * [0.05, 0.18, 0.2]), 0, 1)


def _skin_colours(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Albedo of a lid's skin: mottled, moist and pink at the edge, darker beside the lashes."""
    shape = -1, 161
    rows = points.reshape(-1, 161, 3).shape[0]
    spots = [rng.normal(size=(rows, 161)) for _ in range(2)]
    spots = [
        ndimage.gaussian_filter(n, s) / w
        for n, s, w in zip(spots, (0.7, 5), (0.4, 0.06), strict=True)
    ]
    albedo = np.asarray(_SKIN) * (1 + 0.04 * spots[0] + 0.05 * spots[1])[..., None]
    row = np.arange(rows)[:, None, None]
    moist = np.clip((11 - row) / 6, 0, 1)
    albedo = albedo * (1 - moist) + np.asarray([0.62, 0.36, 0.33]) * moist
    albedo = albedo * (1 - 0.35 * np.exp(-(((row - 14) / 2.5) ** 2)))
    return np.clip(albedo.reshape(-1, 3), 0, 1) if shape else albedo


def developed(linear: np.ndarray, shot: Shot, exposure: float, size, rng) -> bytes:
    """Take a picture as a camera and its software do, and return the bytes of a JPEG file."""
    light = linear * exposure * np.asarray(shot.gains)
    light = np.stack([ndimage.gaussian_filter(light[..., c], 0.55) for c in range(3)], -1)
    electrons = rng.poisson(np.clip(light, 0, 1.2) * shot.electrons)
    light = (electrons + rng.normal(0, 6, light.shape)) / shot.electrons
    value = np.asarray(srgb_encode(jnp.asarray(np.clip(light, 0, 1))))
    # A curve that is steeper in the middle, and sharpening with its halos.
    value = value + shot.contrast * 0.5 * value * (1 - value) * (value - 0.45)
    soft = np.stack([ndimage.gaussian_filter(value[..., c], 1.3) for c in range(3)], -1)
    value = np.clip(value + shot.sharpened * (value - soft), 0, 1)
    image = Image.fromarray(np.round(255 * value).astype(np.uint8))
    exif = Image.Exif()
    exif[0x010E] = "simulated with Mitsuba 3 for irisjax"
    if shot.focal:
        more = exif.get_ifd(0x8769)
        focal = DISTANCE / WIDTH * size[0]
        # FocalLengthIn35mmFilm: of the same angle across the diagonal, 43.27 mm.
        more[0xA405] = round(focal * 43.27 / np.hypot(*size))
    for quality in (90, 86, 82, 78, 74, 70, 60):
        data = io.BytesIO()
        image.save(data, "JPEG", quality=quality, subsampling="4:2:0", exif=exif)
        if len(data.getvalue()) <= MOST:
            break
    return data.getvalue()


def _truth(scene: _Scene, tissue, kind, linear: np.ndarray, iris) -> dict[str, Any]:
    shot, camera, eye = scene.shot, scene.camera, scene.eye
    limbus = _limbus(scene)
    x, y, clear = _places(scene, iris)
    pupil = _contour(iris.outside_pupil(kind, x, y), clear)
    rows, columns = np.indices(linear.shape[:2])
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    out = limbus.relative_radius(columns, rows)
    turn = np.arctan2(rows - limbus.centre[1], columns - limbus.centre[0])
    beside = (out > 1.1) & (out < 1.4) & (np.abs(np.sin(turn)) < 0.4)
    white = linear[beside] if beside.any() else linear.reshape(-1, 3)
    exposure = shot.exposure * _WHITE / float(np.quantile(white.max(-1), 0.85))
    own = scene.iris_light @ [0.2126, 0.7152, 0.0722]
    seen = (clear > 0.5) & (iris.outside_pupil(kind, x, y) > 0.1) & (out < 0.95)
    ratio = float(np.median(own[seen]) / np.median(luminance[beside])) if seen.any() else 0.0
    lit = _lit(scene, iris, x, y, seen)
    melanin = _reduced(tissue.abl.sum(0), _MELANIN_MAP)
    thick = tissue.thickness
    there = (tissue.pupil > 0.1) & (thick > 0) & (np.hypot(*iris.grid(len(thick))) < 5.0)
    masses = [float(np.mean(m[there])) for m in tissue.abl]
    share = _reduced(tissue.abl[1], _MELANIN_MAP) / np.maximum(melanin, 1e-9)
    return {
        "maps": {
            **_packed("thickness", _reduced(thick, _MAP)),
            **_packed("abl_melanin", melanin),
            **_packed("abl_pheomelanin_share", share),
            "lit": np.packbits(lit[::-1], axis=1),
        },
        "size_px": list(camera.size),
        "limbus": _in_file(limbus),
        "pupil": _in_file(pupil),
        "exposure": exposure,
        "iris_over_white": ratio,
        "scattering": {
            "reduced_per_mm": kind.scattering,
            "wavelength_nm": iris.REFERENCE,
            "power": kind.power,
            "mean_cosine": kind.mean_cosine,
            "over_lb06": iris.dense_depth(kind),
        },
        "abl_mean": {"eumelanin": masses[0], "pheomelanin": masses[1], "unit": "ug/mm2"},
        "stroma": {"eumelanin": kind.stroma[0], "pheomelanin": kind.stroma[1], "unit": "mg/ml"},
        "eye": {
            "limbus_radius": LIMBUS,
            "oval": shot.oval,
            "pupil_radius": kind.pupil,
            "pupil_centre": list(kind.off),
            "iris_depth": float(eye.iris_depth),
        },
        "camera": {
            "polar": float(camera.polar),
            "azimuth": float(camera.azimuth),
            "distance": float(camera.distance),
            "width": float(camera.width),
            "focal_px": float(camera.distance) * camera.size[0] / float(camera.width),
            "focal_in_file": shot.focal,
            "gains": list(shot.gains),
            "contrast": shot.contrast,
            "electrons": shot.electrons,
            "sharpened": shot.sharpened,
        },
        "room": shot.room,
        "lamps": [dataclasses.asdict(lamp) for lamp in shot.lamps],
        "lids": shot.lids,
    }


def _limbus(scene: _Scene) -> Ellipse:
    """The middle of the white's soft edge, in pixels."""
    assert scene.eye.cornea is not None
    angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    z = float(limbus_depth(scene.eye.replace(limbus_radius=jnp.asarray(LIMBUS))))
    ring = np.stack(
        [
            LIMBUS * np.cos(angle),
            LIMBUS * scene.shot.oval * np.sin(angle),
            np.full_like(angle, z),
        ],
        -1,
    )
    column, row = scene.camera.pixel(jnp.asarray(ring), scene.eye)
    return ellipse_through(np.stack([np.asarray(column), np.asarray(row)], -1))


def _places(scene: _Scene, iris) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the iris (mm) that pixels show, and the share of its light that comes to them."""
    x, y = iris.grid(64)
    marks = np.stack(np.broadcast_arrays(x / 12 + 0.5, y / 12 + 0.5, 1.0), -1)
    # Every sample of a place would add its own noise; the ratio has none.
    found = scene.through_cornea(marks, scene.effort.seen)
    whole = np.maximum(found[..., 2], 1e-6)
    return 12 * (found[..., 0] / whole - 0.5), 12 * (found[..., 1] / whole - 0.5), found[..., 2]


def _contour(outside: np.ndarray, clear: np.ndarray) -> Ellipse:
    """The ellipse through the pupil's edge."""
    smooth = ndimage.gaussian_filter(outside, 0.5)
    lines = [
        line
        for line in measure.find_contours(np.where(clear > 0.3, smooth, np.nan), 0.0)
        if len(line) > 8
    ]
    row, column = np.concatenate(lines).T
    return ellipse_through(np.stack([column, row], -1))


def _lit(scene: _Scene, iris, x, y, seen: np.ndarray) -> np.ndarray:
    """Cells (rows from y = -6) that the photograph shows in good light: not behind lids or lashes,
    mirrored lamps below half of the iris's own light, more than half of the usual irradiance.
    """
    from experiments.eye_in_mitsuba import HALF

    own, mirrored = scene.iris_light.mean(-1), scene.outside_light.mean(-1)
    good = seen & (mirrored < 0.5 * own)
    counts = [np.histogram2d(y[m], x[m], _MELANIN_MAP, [[-6, 6], [-6, 6]])[0] for m in (seen, good)]
    light = scene.irradiance.mean(-1)
    row, column = (
        np.broadcast_to((c + HALF) * len(light) / (2 * HALF), (_MELANIN_MAP,) * 2)
        .astype(int)
        .clip(0, len(light) - 1)
        for c in iris.grid(_MELANIN_MAP)[::-1]
    )
    here = light[row, column]
    usual = np.median(here[counts[0] > 0]) if counts[0].any() else 0.0
    return (counts[0] > 0) & (counts[1] > 0.7 * counts[0]) & (here > 0.5 * usual)


def _reduced(values: np.ndarray, cells: int) -> np.ndarray:
    """Means over cells of a coarser grid."""
    if len(values) % cells:
        return ndimage.zoom(values, cells / len(values), order=1, grid_mode=True, mode="nearest")
    n = len(values) // cells
    return values.reshape(cells, n, cells, n).mean((1, 3))


def _packed(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """A map in 8 bits, row 0 at y = +6 mm, and the value of 255."""
    most = float(values.max())
    return {
        name: np.round(255 * values[::-1] / most).astype(np.uint8),
        f"{name}_most": np.array(most),
    }


def _in_file(ellipse: Ellipse) -> dict[str, Any]:
    return {
        "centre_px": [float(v) for v in ellipse.centre],
        "semi_axes_px": [float(v) for v in ellipse.semi_axes],
        "angle": float(ellipse.angle),
    }


if __name__ == "__main__":
    start(main, __doc__, FOLDER)
