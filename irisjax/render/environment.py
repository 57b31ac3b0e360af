"""Environments: light from all directions in a latitude-longitude map, and the lights that
approximate it.
"""

import heapq
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax._types import as_float
from irisjax.numerics.checks import check_whole, is_known
from irisjax.numerics.fusion import materialise
from irisjax.numerics.interpolation import multilinear
from irisjax.render.lights import Lights
from irisjax.render.refraction import LARGEST_POLAR

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Share of linear sRGB's components in luminance [IEC 61966-2-1]."""


class Environment(eqx.Module):
    """Light at infinity from every direction, as a panorama taken at the eye's place.

    Rows run from straight up (+y) down, in equal polar angles. The middle of the columns lies
    straight ahead of the eye (−z); as in any panorama, columns to the right of it are what somebody
    who looks out of the eye sees on the right: the side of −x, since +x is the right of a viewer
    who faces the eye.

    Attributes:
        radiance: Linear sRGB (D65 is white) at the centre of each texel, in units in which a white
            sheet lit by irradiance π has radiance 1.

    Raises:
        ValueError: The shape is another, or a value is negative or not finite.
    """

    radiance: Float[Array, "rows columns 3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        if self.radiance.ndim != 3 or self.radiance.shape[2] != 3 or 0 in self.radiance.shape:
            raise ValueError(
                f"an environment has the shape (rows, columns, 3), got {self.radiance.shape}"
            )
        if is_known(self.radiance):
            values = np.asarray(self.radiance)
            if (bad := ~np.isfinite(values)).any() or (bad := values < 0).any():
                raise ValueError(
                    f"radiance is negative or not finite in {int(bad.any(-1).sum())} texels"
                )

    def is_uniform(self) -> bool:
        """Whether all texels are of one grey."""
        return float(np.ptp(np.asarray(self.radiance))) == 0

    @classmethod
    def studio(cls, rows: int = 128) -> "Environment":
        """Make an invented portrait studio: a grey room with a key softbox up on the left, which is
        4 % rosier than D65, a dim fill light on the right and a strip light behind.

        Left and right are the viewer's. A white sheet that faces out has a radiance of about 1.
        """
        d, _ = panorama_geometry(rows)
        soft = max(np.pi / rows, 0.06)
        room = 0.055 + 0.03 * d[..., 1:2]
        key = 22.5 * _panel(d, (-0.62, 0.78, -1.0), (0.17, 0.28), soft)
        fill = 1.3 * _panel(d, (1.0, 0.2, -0.8), (0.35, 0.6), 4 * soft)
        strip = 2.6 * _panel(d, (0.7, 0.9, 0.8), (0.12, 0.7), soft)
        rosy, cold = np.array([1.0, 0.957, 0.98]), np.array([0.98, 0.97, 1.0])
        return cls(room + key[..., None] * rosy + fill[..., None] * cold + strip[..., None])

    @classmethod
    def window(cls, rows: int = 256) -> "Environment":
        """Make an invented dim room with a window of four panes up on the left, which shows a
        cloudy sky over trees.

        Left is the viewer's. A white sheet that faces out has a radiance of about 1. The window is
        narrower and brighter than the studio's softbox, so that its image in the tear film is white
        beside an iris.
        """
        d, _ = panorama_geometry(rows)
        right, up, shown = _plane(d, (-0.5, 0.62, -1.0))
        soft = 2 * np.pi / rows  # as a camera that is focused on the iris sees it
        panes = shown * _within(right, 0.17, soft) * _within(up, 0.2, soft)
        bars = np.maximum(_within(right, 0.012, soft), _within(up - 0.05, 0.012, soft))
        # Waves from branches to leaves, none a multiple of another.
        leaves = np.zeros_like(up)
        for k, turn in (17, 0.4), (31, 2.0), (57, 1.1), (97, 2.7), (171, 0.1), (293, 1.7):
            leaves += np.sin(k * (np.cos(turn) * right + np.sin(turn) * up) + turn) / k**0.7
        trees = np.clip(0.5 + (0.35 * leaves - 0.11 - up) / 0.08, 0, 1)[..., None]
        cloud = 1 + 0.3 * np.sin(9 * right + 4 * up) * np.sin(13 * up)
        sky = 42.0 * (cloud * (1 - up))[..., None] * np.array([0.95, 1.0, 1.06])
        green = (4 + 9 * leaves**2)[..., None] * np.array([0.9, 1.1, 0.55])
        outside = (1 - trees) * sky + trees * green
        room = (0.03 + 0.015 * d[..., 1:2]) * np.array([1.05, 1.0, 0.92])
        window_share = (panes * (1 - bars))[..., None]
        return cls((1 - window_share) * room + window_share * outside)

    @classmethod
    def sky(
        cls, sun_polar: float = 1.0, sun_azimuth: float = 2.0, *, sun: float = 4.0, rows: int = 128
    ) -> "Environment":
        """Make an invented clear day: a blue gradient, a white horizon, a grey-green floor and a
        blurred sun. It is a picture of a sky, no model of the atmosphere.

        Args:
            sun_polar: Polar angle of the sun from −z, radians; below the horizon nothing hides it.
            sun_azimuth: Azimuth of the sun from +x to +y, radians.
            sun: Irradiance by the sun of a surface that faces it; its glare spans about two texels.
            rows: Number of rows of the map.
        """
        d, solid_angle = panorama_geometry(rows)
        up = d[..., 1:2]
        horizon, zenith = np.array([0.75, 0.82, 0.9]), np.array([0.16, 0.32, 0.7])
        above = zenith + (horizon - zenith) * (1 - np.clip(up, 0, 1)) ** 3
        gradient = np.where(up > 0, above, np.array([0.1, 0.1, 0.08]))
        sin, cos = np.sin(sun_polar), np.cos(sun_polar)
        towards = np.array([sin * np.cos(sun_azimuth), sin * np.sin(sun_azimuth), -cos])
        glare = np.exp(-((d - towards) ** 2).sum(-1) / 2 / (np.pi / rows) ** 2)
        glare = glare / (glare * solid_angle).sum()
        warm = np.array([1.05, 0.99, 0.9])
        return cls(gradient + sun * glare[..., None] * (warm / (warm @ LUMINANCE)))

    @classmethod
    def uniform(cls, radiance: ArrayLike = 1.0, *, rows: int = 32) -> "Environment":
        """Make white light of one radiance from everywhere, which a white sheet in it also has."""
        return cls(jnp.full((rows, 2 * rows, 3), radiance, jnp.result_type(float)))

    def lookup(self, direction: ArrayLike) -> Float[Array, "*s 3"]:
        """Interpolate the radiance (..., 3) from directions (..., 3) out of the eye, of any length.

        It is continuous everywhere: at the poles it is the mean of the outermost row.
        """
        rows, columns = self.radiance.shape[:2]
        direction = as_float(direction)
        x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
        square = x * x + z * z
        aside = square > 0  # azimuths of the poles have no derivative
        azimuth = jnp.arctan2(jnp.where(aside, -x, 0.0), jnp.where(aside, -z, 1.0))
        across = jnp.where(aside, jnp.sqrt(jnp.where(aside, square, 1.0)), 0.0)
        v = jnp.arctan2(across, y) * (rows / jnp.pi)
        r = jnp.where(v < 0.5, 2 * v, jnp.where(v > rows - 0.5, 2 * v - rows + 1, v + 0.5))
        c = azimuth * (columns / (2 * jnp.pi)) + (columns + 1) / 2
        # One row for each pole, one column more on either side.
        top, bottom = (jnp.broadcast_to(self.radiance[i].mean(0), (1, columns, 3)) for i in (0, -1))
        table = jnp.concatenate([top, self.radiance, bottom])
        table = jnp.concatenate([table[:, -1:], table, table[:, :1]], axis=1)
        # Materialised: XLA may round an azimuth differently for an index and for its weight, which
        # would then belong to different texels.
        r, c = materialise((r, c))
        return multilinear(table, (r, c))

    def to_lights(
        self, n: int = 64, *, largest_polar: float | None = LARGEST_POLAR, illuminant: str = "D65"
    ) -> Lights:
        """Approximate the map by at most `n` distant lights, by median cut  [Debevec 2005].

        The region with most luminous power × extent is cut next, across its longer side, where its
        power halves. Each region gives one light, with its whole power (`irradiance` × `tint` in
        linear sRGB, `tint` of luminance 1) and from the power's centre. Its `radius` is that of a
        disc of the solid angle (∫L dω)² / ∫L² dω, the region's own where it is evenly bright, and a
        lamp's where there is one in the dark. Fewer lights come back when fewer texels are lit.
        Texels whose centre is farther than `largest_polar` (radians) from −z are left out, as no
        light from there reaches the iris; `None` keeps all. Not to be traced by JAX.

        Raises:
            ValueError: `n` is not positive, or no light reaches the cornea.
        """
        if not is_known(self.radiance):
            raise ValueError("to_lights needs concrete radiances; call it outside jit and grad")
        if n < 1:
            raise ValueError(f"a map gives at least one light, got n = {n}")
        rgb = np.asarray(self.radiance, np.float64)
        direction, solid_angle = panorama_geometry(*rgb.shape[:2])
        if largest_polar is not None:
            rgb = np.where((-direction[..., 2:] >= np.cos(largest_polar)), rgb, 0.0)
        luminance = rgb @ np.asarray(LUMINANCE)
        power = luminance * solid_angle
        if not power.any():
            raise ValueError("no light of this environment reaches the cornea")
        lights = []
        for box in _median_cut(power, n):
            energy = power[box].sum()
            centre = np.einsum("rc,rck->k", power[box], direction[box])
            if np.linalg.norm(centre) < 1e-6 * energy:  # all round the eye: no side is the middle
                centre = direction[box].reshape(-1, 3)[power[box].argmax()]
            effective = min(energy**2 / (power[box] * luminance[box]).sum(), 4 * np.pi)
            tint = np.einsum("rck,rc->k", rgb[box], solid_angle[box]) / energy
            radius = np.arccos(1 - effective / (2 * np.pi))
            lights.append((centre / np.linalg.norm(centre), energy, tint, radius))
        towards, irradiance, tint, radius = (
            np.asarray(x, self.radiance.dtype) for x in zip(*lights, strict=True)
        )
        return Lights(towards, irradiance, tint, radius=radius, illuminant=illuminant)


def panorama_geometry(
    rows: int, columns: int | None = None
) -> tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns"]]:
    """Return unit vectors to the centres of a map's texels, and their solid angles; by default
    there are twice as many columns as rows.
    """
    check_whole("rows", rows, 1)
    columns = 2 * rows if columns is None else columns
    polar = (np.arange(rows) + 0.5)[:, None] * np.pi / rows
    azimuth = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * np.pi
    y = np.broadcast_to(np.cos(polar), (rows, columns))
    x, z = -np.sin(polar) * np.sin(azimuth), -np.sin(polar) * np.cos(azimuth)
    edges = np.cos(np.arange(rows + 1) * np.pi / rows)
    solid_angle = np.broadcast_to((-np.diff(edges))[:, None] * 2 * np.pi / columns, y.shape)
    return np.stack([x, y, z], axis=-1), solid_angle


def _median_cut(power: np.ndarray, n: int) -> list[tuple[slice, slice]]:
    """Divide the map into at most n boxes of texels that hold all the power, none of them empty."""
    # Shares of the power are rounded, so that of regions equal but for rounding the first is cut,
    # whatever the unit of power.
    power = power / power.sum()
    rows, columns = power.shape
    # The count breaks ties in the order of insertion.
    heap: list[tuple[float, int, tuple[slice, slice]]] = []

    def sides(r: slice, c: slice) -> tuple[float, float]:
        sine = np.sin((r.start + r.stop) / 2 * np.pi / rows)
        return (r.stop - r.start) * np.pi / rows, (c.stop - c.start) * 2 * np.pi / columns * sine

    def push(r: slice, c: slice) -> None:
        lit = power[r, c] > 0
        i, j = np.flatnonzero(lit.any(1)), np.flatnonzero(lit.any(0))
        r, c = (slice(s.start + k[0], s.start + k[-1] + 1) for s, k in ((r, i), (c, j)))
        # A box of one texel is never cut: it goes to the end of the queue.
        extent = 0.0 if r.stop - r.start == c.stop - c.start == 1 else max(sides(r, c))
        heapq.heappush(heap, (-round(power[r, c].sum() * extent, 12), next(count), (r, c)))

    count = iter(range(2 * n))
    push(slice(0, rows), slice(0, columns))
    while len(heap) < n and heap[0][0] < 0:
        r, c = heapq.heappop(heap)[2]
        height, width = sides(r, c)
        higher = height > (1 - 1e-9) * width
        across = r.stop - r.start > 1 and (higher or c.stop - c.start == 1)
        running = power[r, c].sum(1 if across else 0).cumsum()
        # Cut nearest to half the power; the box is tight, so that both sides hold some.
        cut = 1 + int(np.abs(running[:-1] / running[-1] - 0.5).round(9).argmin())
        s = r if across else c
        for half in (slice(s.start, s.start + cut), slice(s.start + cut, s.stop)):
            push(*((half, c) if across else (r, half)))
    return [box for _, _, box in sorted(heap, key=lambda entry: entry[1])]


def _plane(direction: np.ndarray, centre) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where directions meet a plane that faces the eye: tangents to the right (+x) and up
    from its middle, and whether they meet it at all.
    """
    forward = np.asarray(centre) / np.linalg.norm(centre)
    right = np.cross((0.0, 1.0, 0.0), -forward)
    right /= np.linalg.norm(right)
    along = direction @ forward
    depth = np.maximum(along, 1e-3)
    right, up = direction @ right / depth, direction @ np.cross(-forward, right) / depth
    return right, up, along > 0


def _within(place: np.ndarray, half: float, soft: float) -> np.ndarray:
    """Return 1 between -half and half and 0 beyond, with a soft edge."""
    inside = np.clip(0.5 + (half - np.abs(place)) / soft, 0, 1)
    return inside * inside * (3 - 2 * inside)


def _panel(direction: np.ndarray, centre, half, soft: float) -> np.ndarray:
    """Draw a softbox that faces the eye, 1 in its middle; `half` sides and `soft` edge are
    tangents.
    """
    right, up, shown = _plane(direction, centre)
    across, along = half
    off = (right / across) ** 2 + (up / along) ** 2
    shown = shown * _within(right, across, soft) * _within(up, along, soft)
    return shown * (1 - np.minimum(off, 2.0) / 6)


ENVIRONMENTS: dict[str, Callable[..., Environment]] = {
    "studio": Environment.studio,
    "sky": Environment.sky,
    "window": Environment.window,
    "uniform": Environment.uniform,
}
"""Environments that need no file."""
