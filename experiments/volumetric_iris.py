"""An iris as a volume of scatterers, path traced by Mitsuba 3: a light model other than irisjax's.

The stroma is a slab with a grid of density: strands, a collarette, furrows and crypts, in an
anterior and a posterior leaf. Light scatters in it in three dimensions, so it spreads sideways. The
anterior border layer (ABL) absorbs only and lies as a sheet on the slab, with two melanins that
vary from place to place; the pigment epithelium below is black. Extinctions and masses are
irisjax's, so a pigment means the same as there.

Differences from irisjax's models, all intended: the iris has no smooth surface (nothing is
refracted or reflected between it and the aqueous humour), scattering is several times LB06's, by
Rayleigh's or Henyey and Greenstein's phase function, and light is traced rather than solved.

Approximations: the slab is flat and seen from straight above; the ABL has no thickness of its own;
nine wavelengths, linear between them, make three channels.

Arrays stand on a square of the iris plane, x and y from -6 to 6 mm: row 0 at y = -6, x right.
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import mitsuba as mi
import numpy as np
from scipy import ndimage

from experiments.eye_in_mitsuba import film_of, matt, rgb
from irisjax.anatomy.eye import Cornea
from irisjax.render.bands import colour_bands
from irisjax.tissue.iris import Iris
from irisjax.tissue.pigments import extinction

HALF = 6.0
"""Half the side of the square of the iris plane, mm."""
DEPTH = 0.5
"""Depth of the slab, mm."""
ROOT = 5.9
"""Radius of the iris's root, mm: beyond it there is no tissue."""
LEAF = 0.5
"""Share of the slab that is the anterior leaf."""
WAVELENGTHS = np.array([420.0, 450, 480, 510, 540, 570, 600, 630, 660])
"""nm, three in each rendering."""
REFERENCE = 550.0
"""Wavelength at which scattering is stated, nm."""
_BOUNCES = 40
_WINDOW = 0.15  # standard deviation of the window of the regression that removes noise, mm
_ANGLES, _RADII = 1024, 160  # of noise in polar coordinates


@dataclass(frozen=True)
class Pigmentation:
    """Melanin of the ABL, µg/mm², from the pupil outwards.

    Attributes:
        eumelanin: Mass in the outer zone.
        pheomelanin: The same.
        ring: Eumelanin and pheomelanin that are added inside the ring.
        reach: Outer edge of the ring, relative radius from 0 at the pupil to 1 at the root.
        sector: Eumelanin that is added in a sector.
        spots: Number of naevi.
    """

    eumelanin: float
    pheomelanin: float
    ring: tuple[float, float] = (0.0, 0.0)
    reach: float = 0.4
    sector: float = 0.0
    spots: int = 0


@dataclass(frozen=True)
class Kind:
    """One kind of eye.

    Attributes:
        scattering: Reduced scattering coefficient of the dense stroma at 550 nm, 1/mm.
        power: Exponent of the wavelength in it; 4 is Rayleigh's.
        mean_cosine: Of Henyey and Greenstein's phase function; `None` for Rayleigh's.
        abl: Melanin of the anterior border layer.
        stroma: Concentrations of eumelanin and pheomelanin in the dense stroma, mg/ml.
        crypts: Number of crypts.
        pupil: Radius of the pupil, mm.
        off: Place of the pupil's middle, mm.
    """

    scattering: float
    power: float
    mean_cosine: float | None
    abl: Pigmentation
    stroma: tuple[float, float]
    crypts: int
    pupil: float
    off: tuple[float, float] = (0.0, 0.0)


KINDS = {
    "blue": Kind(
        2.3, 4.0, None, Pigmentation(0.012, 0.008, spots=2), (0.01, 0.01), 26, 1.7, (-0.12, 0.1)
    ),
    "hazel": Kind(
        4.0,
        2.4,
        0.4,
        Pigmentation(0.04, 0.06, ring=(0.14, 0.22), reach=0.45, spots=3),
        (0.08, 0.12),
        34,
        1.5,
        (-0.15, 0.05),
    ),
    "brown": Kind(
        4.2,
        2.0,
        0.4,
        Pigmentation(0.24, 0.16, ring=(0.08, 0.06), reach=0.3),
        (0.4, 0.25),
        20,
        1.9,
        (-0.1, 0.12),
    ),
    "green": Kind(
        3.4,
        3.3,
        0.3,
        Pigmentation(0.012, 0.1, ring=(0.03, 0.14), reach=0.35),
        (0.01, 0.12),
        30,
        1.8,
        (-0.2, 0.1),
    ),
    "grey": Kind(
        3.6,
        2.3,
        0.5,
        Pigmentation(0.03, 0.01, sector=0.5, spots=2),
        (0.05, 0.02),
        28,
        2.1,
        (0.15, 0.12),
    ),
}
"""Eyes that are made. Pupils lie off the axis, most towards the nose."""


@dataclass(frozen=True)
class Tissue:
    """The slab through which light is traced.

    Attributes:
        density: Shape (depths, rows, columns), depths from the base upwards; 1 is dense stroma.
        abl: Masses of eumelanin and pheomelanin in the ABL, µg/mm², shape (2, rows, columns).
        pupil: Signed share by which a place lies outside the pupil, (rows, columns).
    """

    kind: Kind
    density: np.ndarray
    abl: np.ndarray
    pupil: np.ndarray = field(repr=False)

    @property
    def thickness(self) -> np.ndarray:
        """Dense stroma above each place, mm, (rows, columns)."""
        return self.density.mean(0) * DEPTH


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the middles of cells, mm."""
    along = (np.arange(size) + 0.5) * (2 * HALF / size) - HALF
    return along[None, :], along[:, None]


def outside_pupil(kind: Kind, x, y) -> np.ndarray:
    """Distance from the pupil's middle over the pupil's radius in that direction, minus one.

    The pupil is round but for one and a half per cent.
    """
    dx, dy = x - kind.off[0], y - kind.off[1]
    turn = np.arctan2(dy, dx)
    uneven = 1 + 0.008 * np.cos(2 * turn + 1) + 0.007 * np.cos(3 * turn)
    return np.hypot(dx, dy) / (kind.pupil * uneven) - 1


def grow(kind: Kind, size: int, layers: int, rng: np.random.Generator) -> Tissue:
    """Draw the tissue of an eye at random on a grid of `size` × `size` × `layers` cells."""
    x, y = grid(size)
    share, turn = _place(kind, x, y)
    polar = _Noise(rng, share, turn)
    inside = (np.hypot(x, y) < ROOT) & (share > 0)
    ring = 0.27 + 0.035 * polar(14, 200)  # the collarette, a zigzag about a quarter of the way
    pupillary = _step((ring - share) / 0.03)

    # Strands: ridges of noise that is long towards the root, bent a little.
    bent = polar.bent(0.02 * polar(25, 30))
    ridges = [1 - 1.6 * np.abs(bent(width, 50)) for width in (8.0, 4.0, 2.2)]
    strands = 0.5 * ridges[0] + 0.45 * ridges[1] + 0.3 * ridges[2]
    patches = _step(0.6 * polar(28, 22) + 0.3)  # where strands stand apart
    anterior = 0.62 + (0.25 + 0.35 * patches) * np.clip(strands, -1.2, 1.3)
    anterior -= 0.25 * pupillary
    anterior += 0.5 * np.exp(-(((share - ring) / 0.04) ** 2)) * (1 + 0.4 * polar(6, 60))
    other = _Noise(rng, share, turn)
    posterior = 0.6 + 0.2 * other(5, 60) + 0.1 * other(20, 20)
    furrows = sum(
        0.25 * np.exp(-(((share - at - 0.02 * polar(30, 160)) / 0.012) ** 2))
        * _step((polar(60, 160) + 0.3) / 0.4)
        for at in (0.62, 0.73, 0.83)
    )  # fmt: skip
    anterior = anterior - furrows
    pits = _crypts(kind.crypts, x, y, kind, rng, polar)
    anterior, posterior = anterior * (1 - pits), posterior * (1 - 0.55 * pits)
    # Thinner at the pupil and at the root.
    profile = (0.55 + 0.45 * _step((share - 0.02) / 0.25)) * (1 - 0.35 * _step((share - 0.8) / 0.2))
    leaves = [np.clip(leaf, 0.02, 1.3) * profile * inside for leaf in (posterior, anterior)]
    heights = (np.arange(layers) + 0.5) / layers
    density = np.stack([leaves[int(h > 1 - LEAF)] for h in heights])
    density = ndimage.gaussian_filter1d(density, 0.7, axis=0, mode="nearest")

    abl = _abl(kind.abl, share, turn, polar, x, y, rng) * (1 - 0.7 * pits) * inside
    return Tissue(kind, density.astype(np.float32), abl, outside_pupil(kind, x, y))


def _abl(p: Pigmentation, share, turn, polar: "_Noise", x, y, rng) -> np.ndarray:
    """Masses of both melanins, µg/mm², (2, rows, columns)."""
    mottled = np.exp(0.28 * polar(9, 30) + 0.18 * polar(30, 12))
    eumelanin, pheomelanin = p.eumelanin * mottled, p.pheomelanin * mottled
    edge = p.reach * (1 + 0.16 * polar(10, 90) + 0.1 * polar(3, 60))
    within = _step((edge - share) / 0.12) * np.exp(0.3 * polar(4, 40))
    eumelanin = eumelanin + p.ring[0] * within
    pheomelanin = pheomelanin + p.ring[1] * within
    # Denser towards the root, as a dark ring.
    rim = 1 + 1.3 * _step((share - 0.93 - 0.02 * polar(12, 60)) / 0.16)
    eumelanin, pheomelanin = eumelanin * rim, pheomelanin * rim
    if p.sector:
        away = np.abs((turn - 4.0 + np.pi) % (2 * np.pi) - np.pi)
        eumelanin = eumelanin + p.sector * _step((0.32 + 0.06 * polar(3, 60) - away) / 0.1)
    for _ in range(p.spots):
        at, out, radius = rng.uniform(0, 2 * np.pi), rng.uniform(2.8, 4.8), rng.uniform(0.12, 0.3)
        far = np.hypot(x - out * np.cos(at), y - out * np.sin(at)) / radius
        eumelanin = eumelanin + 0.12 * _step((1.1 - far + 0.2 * polar(6, 10)) / 0.5)
    return np.stack([eumelanin, pheomelanin])


def _crypts(count: int, x, y, kind: Kind, rng, polar: "_Noise") -> np.ndarray:
    """Depth of pits, 0 to 1: uneven lozenges, long towards the root, most beside the collarette."""
    found = np.zeros(np.broadcast(x, y).shape)
    uneven = 0.22 * polar(12, 8) + 0.12 * polar(5, 4)
    for _ in range(count):
        at, out = rng.uniform(0, 2 * np.pi), np.clip(rng.gamma(9, 0.045), 0.2, 0.75)
        long, wide = rng.uniform(0.15, 0.55), rng.uniform(0.1, 0.32)
        dx, dy = (
            c - o - (kind.pupil + (5.5 - kind.pupil) * out) * unit
            for c, o, unit in zip((x, y), kind.off, (np.cos(at), np.sin(at)), strict=True)
        )
        along, across = dx * np.cos(at) + dy * np.sin(at), dy * np.cos(at) - dx * np.sin(at)
        far = (np.abs(along / long) ** 1.5 + np.abs(across / wide) ** 1.5) ** (1 / 1.5)
        found = np.maximum(found, rng.uniform(0.4, 0.95) * _step((1.1 - far + uneven) / 0.5))
    return found


def _place(kind: Kind, x, y) -> tuple[np.ndarray, np.ndarray]:
    """Relative radius from the pupil to the root, and the angle about a middle that moves from the
    pupil's to the eye's.
    """
    share = np.zeros(np.broadcast(x, y).shape)
    for _ in range(4):
        dx, dy = (c - o * (1 - np.clip(share, 0, 1)) for c, o in zip((x, y), kind.off, strict=True))
        share = (np.hypot(dx, dy) - kind.pupil) / (5.5 - kind.pupil)
    return np.where(outside_pupil(kind, x, y) > 0, np.maximum(share, 1e-3), 0), np.arctan2(dy, dx)


class _Noise:
    """Smooth noise of mean 0 and standard deviation 1 over angle and relative radius; a call draws
    it with standard deviations of its Gaussians in 1024ths of a turn and 160ths of the radius.
    """

    def __init__(self, rng: np.random.Generator, share, turn) -> None:
        self.rng, self.row = rng, turn % (2 * np.pi) * (_ANGLES / (2 * np.pi))
        self.column = share * (_RADII - 1)

    def bent(self, angle) -> "_Noise":
        """The same, turned by an angle."""
        other = _Noise.__new__(_Noise)
        other.rng, other.column = self.rng, self.column
        other.row = self.row + angle * (_ANGLES / (2 * np.pi))
        return other

    def __call__(self, around: float, outwards: float) -> np.ndarray:
        drawn = self.rng.normal(size=(_ANGLES, 2 * _RADII))
        drawn = ndimage.gaussian_filter(drawn, (around, outwards), mode=("wrap", "reflect"))
        drawn = (drawn - drawn.mean()) / drawn.std()
        place = np.stack([self.row, self.column])
        return ndimage.map_coordinates(drawn, place, order=1, mode="grid-wrap")


def _step(x) -> np.ndarray:
    """Rise smoothly from 0 at -1/2 to 1 at 1/2."""
    t = np.clip(x + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


@lru_cache(maxsize=1)
def _weights() -> np.ndarray:
    """Matrix (3, wavelengths) to linear sRGB under D65, through the cornea's haze twice."""
    bands = colour_bands(cornea=Cornea(), all_wavelengths=True)
    every = np.asarray(bands.wavelengths)
    hats = np.stack([np.interp(every, WAVELENGTHS, one) for one in np.eye(len(WAVELENGTHS))], -1)
    return np.asarray(bands.weights, float) @ hats


def lb06_scattering() -> float:
    """LB06's scattering coefficient at the reference wavelength, 1/mm."""
    iris = Iris()
    layers = iris.layers(extinction(np.array([REFERENCE])))
    return float(layers.stroma_scattering[0] / iris.stroma_thickness)


def albedo(tissue: Tissue, light: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """Linear sRGB (rows, columns, 3) of an iris, relative to a matt white sheet in the same light,
    seen from above.

    - `light`: radiance as it arrives in the chamber, an environment of Mitsuba's, (rows, columns).
    """
    matrix, kind = _weights(), tissue.kind
    found = np.zeros((*tissue.thickness.shape, 3))
    irradiance = irradiance_of(light)
    e, plain = extinction(WAVELENGTHS), Iris()
    factor = float(plain.intensification)
    melanins = np.stack([e.eumelanin, e.pheomelanin]).astype(float) * factor
    sheet = np.einsum("kij,kw->ijw", tissue.abl, melanins)
    absorbing = np.asarray(kind.stroma) @ melanins
    absorbing = absorbing + np.asarray(
        plain.oxyhemoglobin * e.oxyhemoglobin
        + plain.deoxyhemoglobin * e.deoxyhemoglobin
        + plain.lutein * e.lutein
        + plain.zeaxanthin * e.zeaxanthin
    )
    g = 0.0 if kind.mean_cosine is None else kind.mean_cosine
    scattering = kind.scattering / (1 - g) * (WAVELENGTHS / REFERENCE) ** -kind.power
    for first in range(0, len(WAVELENGTHS), 3):
        part = slice(first, first + 3)
        known = tissue.density, scattering[part], absorbing[part], sheet[..., part]
        radiance = traced_slab(*known, kind.mean_cosine, light, samples, seed + first)
        found += radiance @ matrix[:, part].T * (math.pi / irradiance)
    return np.maximum(_denoised(found, tissue), 0)


def _denoised(noisy: np.ndarray, tissue: Tissue) -> np.ndarray:
    """Local linear regression on what is known without noise, as renderers do with their features:
    the thickness as it is and blurred twice (light spreads sideways), and both melanins.
    """
    thick = tissue.thickness
    cell = 2 * HALF / len(thick)
    # Few paths are far brighter than all others of their neighbourhood.
    failed = ~np.isfinite(noisy).all(-1)
    noisy = np.where(failed[..., None], 0, noisy)
    near = ndimage.gaussian_filter(noisy, (2, 2, 0))
    noisy = np.minimum(noisy, 4 * near + 0.01)
    blurred = [ndimage.gaussian_filter(thick, width / cell) for width in (0.08, 0.25)]
    features = np.stack([np.ones_like(thick), thick, *blurred, *tissue.abl], -1)
    scale = features[..., 1:].std((0, 1)) + 1e-9
    inside = (tissue.pupil > 0) & (thick > 0)
    sound = inside & ~failed
    features[..., 1:] /= scale
    values = np.concatenate([features, noisy], -1) * sound[..., None]
    count = features.shape[-1]

    def mean(a, b):
        return ndimage.gaussian_filter(values[..., a] * values[..., b], _WINDOW / cell)

    products = np.zeros((*thick.shape, count, count + 3))
    for i in range(count):
        for j in range(i, count + 3):
            products[..., i, j] = mean(i, j)
            if j < count:
                products[..., j, i] = products[..., i, j]
    normal, right = products[..., :count], products[..., count:]
    # A little towards no slope, where a feature hardly varies.
    ridge = np.diag([1e-9] + [1e-3] * (count - 1)) * (normal[..., :1, :1] + 1e-9)
    slopes = np.linalg.solve(normal + ridge + 1e-12 * np.eye(count), right)
    found = np.einsum("ijk,ijkc->ijc", features, slopes)
    return np.where(inside[..., None], found, 0)


def irradiance_of(light: np.ndarray) -> float:
    """Compute the irradiance on the iris by an environment."""
    towards, solid = directions(*light.shape)
    return float((light * np.maximum(towards[..., 2], 0) * solid).sum())


def directions(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (rows, columns, 3) of an environment's pixels in Mitsuba's frame, and their solid
    angles.
    """
    polar = (np.arange(rows)[:, None] + 0.5) * (math.pi / rows)
    turn = (np.arange(columns)[None] + 0.5) * (2 * math.pi / columns)
    x, y, z = np.sin(turn) * np.sin(polar), np.cos(polar), -np.cos(turn) * np.sin(polar)
    towards = np.stack(np.broadcast_arrays(x, y, z), -1)
    solid = np.sin(polar) * (math.pi / rows) * (2 * math.pi / columns)
    return towards, np.broadcast_to(solid, (rows, columns))


def traced_slab(
    density, scattering, absorbing, sheet, g, light, samples: int, seed: int
) -> np.ndarray:
    """Radiance (rows, columns, 3) of three wavelengths, upwards."""
    place = mi.ScalarTransform4f()
    box = place.translate([-HALF, -HALF, -DEPTH]).scale([2 * HALF, 2 * HALF, DEPTH])
    total = scattering + absorbing
    cells = np.array(density[..., None] * total, np.float32)
    # A corner, where no tissue is, is the densest: elsewhere delta tracking divides by no zero.
    cells[:, 0, 0] = 1.02 * cells.max((0, 1, 2))
    stroma = {
        "type": "heterogeneous",
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(cells),
            "to_world": box,
            "raw": True,
            "wrap_mode": "clamp",
        },
        "albedo": {"type": "constvolume", "value": rgb((scattering / total).tolist())},
        "phase": {"type": "rayleigh"} if g is None else {"type": "hg", "g": g},
    }
    environment = np.repeat(light[..., None], 3, -1).astype(np.float32)
    rows, columns = sheet.shape[:2]
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": _BOUNCES, "rr_depth": 6},
        "stroma": {
            "type": "cube",
            "to_world": place.translate([0, 0, -DEPTH / 2]).scale([HALF, HALF, DEPTH / 2]),
            "bsdf": {"type": "null"},
            "interior": stroma,
        },
        "epithelium": {
            "type": "rectangle",
            "to_world": place.translate([0, 0, -DEPTH - 0.01]).scale(4 * HALF),
            "bsdf": matt([0.0] * 3),
        },
        "abl": {
            "type": "rectangle",
            "to_world": place.translate([0, 0, 0.005]).scale(HALF),
            "bsdf": {"type": _sheet_plugin(), "depth": _raw(sheet)},
        },
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(environment),
        },
        "sensor": {
            "type": "orthographic",
            "to_world": place.look_at(origin=[0, 0, 1], target=[0, 0, 0], up=[0, 1, 0])
            @ place.scale([HALF, HALF, 1]),
            "film": film_of(columns, rows),
        },
    }
    loaded = mi.load_dict(scene)
    picture = sum(
        np.asarray(mi.render(loaded, spp=now, seed=1000 * seed + i), np.float64) * now
        for i, now in enumerate(_portions(samples, rows * columns))
    )
    return np.asarray(picture)[::-1] / samples


def _portions(samples: int, pixels: int) -> list[int]:
    """Samples a call: programs of LLVM hold all paths of a call at once."""
    most = max(1, 4_000_000 // pixels)
    return [min(most, samples - done) for done in range(0, samples, most)]


def _raw(values: np.ndarray) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


@lru_cache(maxsize=4)
def _registered(variant: str) -> str:
    class Sheet(mi.BSDF):
        """A sheet that absorbs by an optical `depth` and changes no direction."""

        def __init__(self, props) -> None:
            mi.BSDF.__init__(self, props)
            self.depth = props["depth"]
            flags = mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [flags]
            self.m_flags = flags

        def sample(self, ctx, si, sample1, sample2, active=True):
            del ctx, sample1, sample2
            found = mi.BSDFSample3f()
            found.wo = -si.wi
            found.pdf = mi.Float(1.0)
            found.eta = mi.Float(1.0)
            found.sampled_type = mi.UInt32(+mi.BSDFFlags.Null)
            found.sampled_component = mi.UInt32(0)
            return found, self.eval_null_transmission(si, active)

        def eval(self, ctx, si, wo, active=True):
            del ctx, si, wo, active
            return mi.Spectrum(0.0)

        def pdf(self, ctx, si, wo, active=True):
            del ctx, si, wo, active
            return mi.Float(0.0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def eval_null_transmission(self, si, active=True):
            cosine = abs(mi.Frame3f.cos_theta(si.wi)) + 1e-6
            return mi.Spectrum(math.e) ** (-self.depth.eval(si, active) / cosine)

    name = "absorbing_sheet"
    mi.register_bsdf(name, lambda props: Sheet(props))
    return name


def _sheet_plugin() -> str:
    """Name of the plugin of absorbing sheets in the variant that is set."""
    return _registered(str(mi.variant()))


def dense_depth(kind: Kind) -> float:
    """Reduced scattering of the dense stroma at 550 nm relative to LB06's."""
    return float(jnp.asarray(kind.scattering) / lb06_scattering())
