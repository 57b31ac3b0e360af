"""Lids with grown lashes and skin; equal keys give equal lids."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.lids import EDGE_WIDTH, FACE, FENCE, Lids
from irisjax.anatomy.sclera import sclera_centre
from irisjax.numerics.checks import check_whole
from irisjax.numerics.streams import words_of
from irisjax.numerics.strokes import stamp_strokes, stroke_sections

_POINTS = 14  # along a lash


def lids(eye: Eye, *, texels: int = 1024, key: PRNGKey, **fields: Any) -> Lids:
    """Grow lids for an eye: lashes along both margins, and the relief and redness of their skin.

    Args:
        eye: The eye, not traced.
        texels: Number of texels along each side of the maps.
        key: Random key.
        **fields: Fields of `Lids`.

    Raises:
        ValueError: The eye has no cornea or no sclera, or a field is out of range.
    """
    check_whole("texels", texels, 2)
    plain = Lids(**fields)
    eye.replace(lids=plain)  # raises if the eye cannot have lids
    rng = np.random.default_rng(words_of(key))
    centre = sclera_centre(eye)
    lashes = _lashes(rng, plain, centre)
    maps = {"lashes": lashes, "skin": _skin(rng, texels), "fence": _fence(lashes, float(centre))}
    grown: dict[str, Any] = {k: jnp.asarray(v, jnp.result_type(float)) for k, v in maps.items()}
    return Lids(**fields, **grown)


def _lashes(rng, lids: Lids, centre) -> np.ndarray:
    """Grow three rows of lashes on the upper lid and two on the lower: points and radii of each."""
    rows = [(True, 100), (True, 85), (True, 60), (False, 70), (False, 30)]
    row = np.repeat(np.arange(len(rows)), [n for _, n in rows])
    count = len(row)
    upper = np.concatenate([np.full(n, of_upper) for of_upper, n in rows])
    s = np.concatenate([np.linspace(-0.97, 0.8 if up else 0.72, n) for up, n in rows])
    s = s + rng.normal(0, 0.008, count)
    t = np.linspace(0, 1, _POINTS)
    # Neighbouring lashes lean together in tufts, whose tips meet.
    tufts = np.repeat(np.arange(count), rng.integers(2, 6, count))[:count]
    _, tufts = np.unique(tufts * len(rows) + row, return_inverse=True)  # none in two rows
    middle = (np.bincount(tufts, s) / np.bincount(tufts))[tufts]
    lean = rng.normal(0, 0.05, count)[tufts] + 1.5 * (middle - s)
    outward = s * lids.nose * np.where(s < 0, 1.3, 0.7) * np.where(upper, 0.7, 0.5)
    fan = outward + lean + rng.normal(0, 0.025, count)
    side = np.outer(fan, 0.5 * t * (1 + t)) + np.outer(rng.normal(0, 0.05, count), t**2)
    lift = rng.normal(1, 0.12, count)
    # Upper lashes reach forwards before they curl up, so that the tear film mirrors their tips.
    rising, falling = np.outer(lift, 0.7 * t**2 - 0.08 * t), 0.3 * t**2 - np.outer(lift, 0.85 * t)
    up = np.where(upper[:, None], rising, falling)
    out = np.where(upper[:, None], 0.95 * t - 0.15 * t**2, 0.5 * t + 0.1 * t**2)
    length = np.where(upper, 6.8, 3.4) * (1 - 0.4 * s**2 - 0.25 * s)
    along = (length * rng.uniform(0.45, 1.05, count))[:, None]
    beyond = rng.uniform(0.1, 0.55, count) * EDGE_WIDTH
    place = jnp.asarray(np.stack([s, beyond]))
    x, y, z = np.asarray(_roots(lids, jnp.asarray(upper), place, centre))
    path = x[:, None] + along * side, y[:, None] + along * up, z[:, None] - along * out
    radius = np.where(upper, 0.05, 0.034) * rng.uniform(0.65, 1.15, count)
    return np.stack([*path, np.outer(radius, 1.02 - t)], -1)


@eqx.filter_jit
def _roots(lids: Lids, upper, place, centre):
    """Return x, y and z of the roots of lashes, from their positions between the corners and beyond
    the margin.
    """
    along, beyond = place
    start, end = lids.along(jnp.zeros(())), lids.along(jnp.ones(()))
    x = (along - start) / (end - start)
    high, low = lids.margins(along)
    y = jnp.where(upper, high + beyond, low - beyond)
    return jnp.stack([x, y, lids.depth(x, y, centre) + 0.15])


def _fence(lashes: np.ndarray, centre: float) -> np.ndarray:
    """Draw the lashes on the sphere of `FENCE` as seen from the middle of the cornea."""
    side, start = 512, np.array([0.0, 0.0, 0.5])
    away = lashes[..., :3] - start
    length = np.linalg.norm(away, axis=-1)
    direction = away / length[..., None]
    offset = start - np.array([0.0, 0.0, centre])
    along = direction @ offset
    distance = np.sqrt(along**2 - offset @ offset + FENCE**2) - along
    projected = start + distance[..., None] * direction
    magnification, cell = distance / length, 2 * FACE / side
    place = (projected[..., :2] + FACE) / cell - 0.5
    radius = magnification * lashes[..., 3] / cell
    pixels = np.concatenate([place, radius[..., None]], -1)
    return np.asarray(stamp_strokes(jnp.asarray(pixels), (side, side), *stroke_sections(40, 4)))


def _skin(rng, texels: int) -> np.ndarray:
    """Draw slopes and redness of skin: pores, fine lines and blotches from filtered noise."""
    frequency = np.fft.fftfreq(texels, 2 * FACE / texels)  # 1/mm
    fx, fy = np.meshgrid(frequency, frequency)

    def noise(x: float, y: float) -> np.ndarray:
        """Return a field of noise whose details are about x by y mm in size."""
        size = (fx * x) ** 2 + (fy * y) ** 2
        band = size * np.exp(-2 * size)
        field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(texels, texels))) * band).real
        return field / field.std()

    lines = noise(2.2, 0.7)
    pores = np.minimum(noise(0.32, 0.32), 0.4) + 0.4 * noise(0.5, 0.5)
    height = 0.0035 * pores + 0.004 * np.minimum(lines, 0.2)
    up, along = np.gradient(height, 2 * FACE / texels)
    red = 0.6 * noise(7, 6) + 0.25 * noise(1.3, 1.3)
    return np.stack([along, up, np.clip(red, -1.5, 1.5) / 1.5])
