"""How often outlines are right that are said to be: on made photographs with all that hides an eye.

Irides of the simulated photographs are put, with a limbus and a pupil of other sizes, places and
softness, behind lids and lashes, under mirrored lamps, windows and skies, at several sizes in a
picture, and go through a camera with noise and JPEG. An outline is right if its centre and its mean
radius are within 4 % of the limbus's radius.
"""

import io
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import jax
import numpy as np
from PIL import Image
from scipy import ndimage, optimize, special

from experiments.common import RESULTS, start, write
from irisjax.io.profiles import srgb_to_linear
from irisjax.measure.colour import srgb_encode
from irisjax.photo.evidence import Evidence
from irisjax.photo.outlines import find_boundaries
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.pose import LIMBUS_OVAL, PUPIL_OVAL, tilts_of_people

FOLDER = RESULTS.parent.parent / "data" / "photographs"
NUMBER = 200
RIGHT = 0.04
"""Most error of centre and radius of a right outline, relative to the limbus's radius."""
RIDGE = 0.2
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
SKIN = np.array([0.45, 0.26, 0.18])
_FRONTAL = 649.5, 539.5, 499.4  # column, row, radius of the limbus in the frontal photographs
_PUPILS = {"brown": 192.9, "green": 172.8, "blue": 212.8}  # px


class Made(NamedTuple):
    """A made photograph and the truth about it."""

    photograph: Photograph
    limbus: Ellipse
    pupil: Ellipse
    tilt: float


def main(key, quick=False, out=RESULTS):
    """Write the outlines of each photograph, the 95 % intervals of its tilt in degrees, how often
    outlines of each confidence are right, and the weights of the evidence that say so.
    """
    seed, number = int(jax.random.key_data(key)[-1]), 3 if quick else NUMBER
    about = [f"{number} made photographs, seed {seed}; errors relative to the limbus's radius"]
    rows, counted = [], {"limbus": [], "pupil": []}
    for k, made in enumerate(made_photographs(number, seed)):
        try:
            found = find_boundaries(made.photograph)
        except ValueError:
            continue
        row = [k]
        for name in ("limbus", "pupil"):
            off = error(getattr(found, name), getattr(made, name), made.limbus)
            sure = getattr(found, f"{name}_confidence")
            counted[name].append((sure, off <= RIGHT))
            row += [off, sure]
        spread = np.hypot([LIMBUS_OVAL, PUPIL_OVAL], found.flattening_sd)
        _, interval, _ = tilts_of_people(found.limbus, found.pupil, spread)
        tilts = (float(np.degrees(tilt)) for tilt in (made.tilt, *interval))
        rows.append((*row, *(found.evidence or ()), *tilts))
    names = "photograph", "limbus_error", "limbus_confidence", "pupil_error", "pupil_confidence"
    columns = *names, *Evidence._fields, "tilt", "tilt_from", "tilt_to"
    write(out / "outline_confidence.csv", about, columns, rows)
    table = [(name, *line) for name in counted for line in reliability(counted[name])]
    columns = "outline", "from", "to", "number", "mean_confidence", "share_right"
    write(out / "outline_confidence_table.csv", about, columns, table)
    evidence = np.array([row[5:-3] for row in rows])
    weights = [(n, *fitted_weights(evidence, [right for _, right in counted[n]])) for n in counted]
    columns = "outline", "constant", *Evidence._fields
    write(out / "outline_confidence_weights.csv", about, columns, weights)


def reliability(counted: list[tuple[float, bool]]) -> Iterator[tuple]:
    """Yield bounds, number, mean confidence and share of right ones of each bin of confidence."""
    sure, right = np.array(counted, float).T
    for low, high in pairwise(BINS):
        there = (sure >= low) & ((sure < high) | (high == 1))
        if there.any():
            yield low, high, int(there.sum()), float(sure[there].mean()), float(right[there].mean())


def fitted_weights(evidence: np.ndarray, right: list[bool]) -> list[float]:
    """Constant and weights, none negative, of the evidence in the logarithm of the odds.

    Real photographs differ from these, so no weight may grow large: a ridge.
    """
    known = np.column_stack([np.ones(len(evidence)), evidence])
    names = Evidence._fields
    possible = evidence[:, names.index("shape")] * evidence[:, names.index("whole")]

    def loss(weights):
        sure = np.clip(special.expit(known @ weights) * possible, 1e-6, 1 - 1e-6)
        return RIDGE * (weights[1:] ** 2).sum() - np.log(np.where(right, sure, 1 - sure)).sum()

    start, bounds = np.append(-3, np.ones(len(names))), [(None, None)] + [(0, None)] * len(names)
    return [float(w) for w in optimize.minimize(loss, start, bounds=bounds).x]


def error(found: Ellipse, true: Ellipse, limbus: Ellipse) -> float:
    """The larger of the errors of centre and mean radius, relative to the limbus's radius."""
    off = np.hypot(*np.subtract(found.centre, true.centre))
    return float(max(off, abs(found.mean_radius - true.mean_radius)) / limbus.mean_radius)


def made_photographs(number: int, seed: int) -> Iterator[Made]:
    """Yield photographs made from the irides of the simulated ones."""
    textures = {colour: _texture(colour) for colour in _PUPILS}
    for k in range(number):
        yield _made(np.random.default_rng([seed, k]), textures)


def _texture(colour: str) -> np.ndarray:
    """The iris of a frontal photograph (angles, places from pupil to limbus, 3), linear."""
    pixels = np.asarray(Image.open(FOLDER / f"{colour}.jpg").convert("RGB"))
    linear = np.asarray(srgb_to_linear(pixels))
    x, y, limbus = _FRONTAL
    angle, place = np.arange(512) * (2 * np.pi / 512), np.linspace(0.02, 0.97, 128)
    radius = _PUPILS[colour] + place * (limbus - _PUPILS[colour])
    at = y - np.sin(angle)[:, None] * radius, x + np.cos(angle)[:, None] * radius
    return np.stack(
        [ndimage.map_coordinates(c, at, order=1) for c in np.moveaxis(linear, -1, 0)], -1
    )


def _made(random: np.random.Generator, textures: dict[str, np.ndarray]) -> Made:
    chance, between = (lambda p: random.random() < p), random.uniform
    whole = chance(0.6)  # a close-up, or an eye in a face
    columns = int(between(240, 420))
    rows = int(columns * between(0.6, 1.0))
    size = between(0.16, 0.42) * rows if whole else max(between(0.05, 0.14) * columns, 16.0)
    margin = 0.9 * size if whole else 2.5 * size
    x, y = (between(min(margin, n / 2), max(n - margin, n / 2)) for n in (columns, rows))
    # Outlines.
    tilt = np.radians(between(0, 32)) if chance(0.35) else np.radians(between(0, 6))
    side = between(0, 2 * np.pi)
    turned = -np.log(np.cos(tilt)) * np.exp(2j * (side + np.pi / 2))
    limbus = _ellipse((x, y), size, turned + 0.03 + 0.03 * _complex(random))
    aside = 0.045 * _complex(random) + 0.04j + 0.12 * np.sin(tilt) * np.exp(1j * side)
    middle = x + size * aside.real, y - size * aside.imag
    share = between(0.2, 0.62)
    pupil = _ellipse(middle, share * size, turned / 1.25 + 0.02 * _complex(random))
    row, column = np.mgrid[:rows, :columns]
    outer, inner = limbus.relative_radius(column, row), pupil.relative_radius(column, row)
    u, v = (column - x) / size, (row - y) / size
    # The iris.
    texture = textures[str(random.choice(list(textures)))]
    beyond = np.maximum((inner - 1) * share, 0)
    place = np.clip(beyond / (beyond + np.maximum(1 - outer, 1e-3)), 0, 1)
    angle = np.arctan2(-(v - (middle[1] - y) / size), u - (middle[0] - x) / size) + between(0, 6)
    at = angle / (2 * np.pi) % 1 * 512, place * 127
    iris = np.stack(
        [ndimage.map_coordinates(c, at, order=1, mode="wrap") for c in np.moveaxis(texture, -1, 0)],
        -1,
    )
    mean = iris[outer < 1].mean(0)
    iris = mean * (np.maximum(iris, 1e-4) / mean) ** between(0.8, 2.2)
    iris = iris * np.exp(random.normal(0, 0.2, 3)) * np.exp(between(-0.3, 1.2))
    if chance(0.3):
        edge = between(0.2, 0.5) + 0.06 * np.sin(7 * angle) + 0.04 * np.sin(13 * angle)
        near = 1 / (1 + np.exp((place - edge) / 0.06))[..., None]
        iris = iris * (1 - near + near * [2.2, 1.25, 0.4])
    ring = between(0, 0.8) * np.exp(-np.maximum(1 - outer, 0) / between(0.03, 0.12))
    iris = iris * (1 - ring[..., None])
    softness = between(0.01, 0.06) if chance(0.5) else between(0.06, 0.2)
    white = (
        np.array([0.62, 0.57, 0.52])
        * between(0.6, 1.2)
        * (1 + 0.05 * _noise(random, u.shape, size / 5))[..., None]
    )
    rising = _smoothstep((outer - 1) / softness + 0.5)[..., None]
    margin = np.clip((inner - 1) * share * size / (0.5 + between(0, 0.05) * size) + 0.5, 0, 1)[
        ..., None
    ]
    eye = rising * white * (1 - 0.25 * np.clip(abs(u) - 1, 0, 1) ** 2)[..., None]
    eye = eye + (1 - rising) * iris * margin
    eye = eye * np.exp(random.normal(0, 0.3) * u + random.normal(0, 0.1) * v)[..., None]
    # Windows and lamps are mirrored in the cornea.
    mirrored = np.zeros(u.shape)
    for _ in range(int(random.integers(0, 3))):
        mirrored += 3.0 * (
            np.hypot(u - between(-0.6, 0.6), v - between(-0.5, 0.5)) < between(0.02, 0.1)
        )
    if chance(0.35):
        left, top = between(-0.7, 0.2), between(-0.8, 0.1)
        window = (abs(u - left - 0.25) < between(0.1, 0.35)) & (
            abs(v - top - 0.2) < between(0.1, 0.35)
        )
        bars = (abs(u - left - 0.25) < 0.02) | (abs(v - top - 0.2) < 0.02)
        mirrored += (
            between(0.1, 1.5)
            * window
            * (1 - bars * chance(0.5))
            * (v > -0.5 + 0.1 * np.sin(40 * u))
        )
    if chance(0.2):
        sky = (
            (outer < 0.85)
            & (abs(u) < between(0.3, 0.8))
            & (v < between(-0.1, 0.2))
            & (v > -between(0.3, 0.7))
        )
        mirrored += between(0.03, 0.3) * sky
    mirrored = ndimage.gaussian_filter(mirrored, 0.01 * size) * (outer < 1.02)
    eye = eye + mirrored[..., None] * [0.8, 1.0, 1.1]
    # Lids, lashes, brow and the socket's shade.
    corner = between(1.7, 2.6)
    upper, lower = between(0.45, 1.2) if chance(0.92) else between(-0.2, 0.4), between(0.7, 1.25)
    skew = between(-0.15, 0.15) * u
    top = -upper + (upper + 0.15) * (u / corner) ** 2 + skew
    bottom = lower - (lower - 0.1) * (u / corner) ** 2 + skew
    skin = SKIN * between(0.4, 1.7) * np.exp(random.normal(0, 0.12, 3))
    skin = (
        skin
        * (1 + 0.06 * _noise(random, u.shape, size / 40) + 0.15 * _noise(random, u.shape, size))[
            ..., None
        ]
    )
    skin = (
        skin
        * (1 - between(0, 0.6) * np.exp(-(((v + upper + 0.35 - 0.2 * u**2) / 0.06) ** 2)))[
            ..., None
        ]
    )
    socket = 1 / (1 + np.exp((np.hypot(u / between(2.5, 5), v / between(2, 4)) - 1) / 0.1))
    skin = skin * (1 - between(0, 0.5) * socket)[..., None]
    shade = 1 - between(0.1, 0.7) * np.exp(-np.maximum(v - top, 0) / between(0.05, 0.25))
    open_ = ndimage.gaussian_filter(((v > top) & (v < bottom)).astype(float), 0.015 * size)[
        ..., None
    ]
    picture = open_ * eye * shade[..., None] + (1 - open_) * skin
    lashes = _lashes(random, (x, y), size, u.shape, upper, corner)
    picture = picture * (1 - between(0.5, 0.95) * lashes[..., None])
    if chance(0.7):
        away = v + between(1.8, 2.8) - 0.15 * u**2
        brow = (abs(away) < between(0.15, 0.35)) & (abs(u) < 2.5)
        picture = picture * (
            1 - 0.8 * ndimage.gaussian_filter(brow.astype(float), 0.08 * size)[..., None]
        )
    return Made(_camera(random, picture), limbus, pupil, float(tilt))


def _camera(random: np.random.Generator, picture: np.ndarray) -> Photograph:
    """Exposure, white balance, blur, noise, tone curve and JPEG."""
    picture = picture * random.uniform(0.7, 1.2) * np.exp(random.normal(0, 0.08, 3))
    picture = np.stack(
        [ndimage.gaussian_filter(c, random.uniform(0.3, 1.2)) for c in np.moveaxis(picture, -1, 0)],
        -1,
    )
    picture = picture + random.normal(0, random.uniform(0.002, 0.012), picture.shape)
    contrast, grey = random.uniform(0.8, 1.4), random.random() < 0.12
    encoded = np.asarray(srgb_encode(np.clip(picture, 0, 1))) ** contrast
    if grey:
        encoded = np.repeat(encoded.mean(-1, keepdims=True), 3, -1)
    stream = io.BytesIO()
    Image.fromarray(np.round(255 * encoded).astype("uint8")).save(
        stream, "JPEG", quality=int(random.integers(60, 95))
    )
    pixels = np.asarray(Image.open(stream))
    return Photograph(np.asarray(srgb_to_linear(pixels)), (pixels >= 254).any(-1), bool(grey))


def _lashes(random, middle, size, shape, upper, corner) -> np.ndarray:
    """Thin arcs that hang from the upper lid, most over the skin above it."""
    covered = np.zeros(shape)
    t = np.linspace(0, 1, int(2 * size) + 8)
    for _ in range(int(random.integers(0, 60))):
        begin, length = random.uniform(-0.8, 0.8) * corner, random.uniform(0.2, 0.7)
        down = length if random.random() < 0.25 else -length
        lean = random.normal(0, 0.1) + 0.2 * begin
        column = middle[0] + size * (begin + lean * t**2)
        row = middle[1] + size * (-upper + (upper + 0.15) * (begin / corner) ** 2 + down * t)
        inside = (row >= 0) & (column >= 0) & (row < shape[0] - 1) & (column < shape[1] - 1)
        covered[row[inside].astype(int), column[inside].astype(int)] = 1
    return np.minimum(
        3 * ndimage.gaussian_filter(covered, max(0.008 * size, 0.4)) * max(0.015 * size, 0.8), 1
    )


def _noise(random, shape, width) -> np.ndarray:
    field = ndimage.gaussian_filter(random.normal(size=shape), max(width, 0.5))
    return field / field.std()


def _complex(random) -> complex:
    return complex(*random.normal(0, 1, 2))


def _smoothstep(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _ellipse(centre, radius, flattening: complex) -> Ellipse:
    half = abs(flattening) / 2
    axes = radius * np.exp(half), radius * np.exp(-half)
    return Ellipse(centre, axes, float(np.angle(flattening) / 2 % np.pi))


if __name__ == "__main__":
    start(main, __doc__)
