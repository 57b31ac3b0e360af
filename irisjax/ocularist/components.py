"""Components of painted coats: what draws an opacity map  [L03 Section 2.3, Fig. 3].

The paper scans what an ocularist has painted. Here components are drawn from a key, and `scan`
takes a picture. Extents along a radius are in relative radii, from 0, the pupil's edge, to 1, the
root; those across are in outer radii of the iris.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float32

from irisjax._types import PRNGKey
from irisjax.numerics.checks import Range, check_known, check_range, check_whole
from irisjax.ocularist.strokes import (
    Annulus,
    Dots,
    Opacity,
    Paint,
    Strokes,
    angles_round,
    log_normal,
    smooth_noise,
    smooth_step,
)
from irisjax.render.environment import LUMINANCE

PARAMETER_RANGES = {
    "inner": Range(0, 1, meaning="relative radius from which strokes or dots cover the iris"),
    "outer": Range(0, 1, meaning="relative radius up to which they do"),
    "length": Range(0, 1, meaning="median length, relative radii"),
    "width": Range(0.001, 0.3, meaning="median width, outer radii"),
    "reach": Range(0.01, 1, meaning="extent of a ring, relative radii"),
    "softness": Range(0.002, 0.2, meaning="standard deviation of the brush's edge, outer radii"),
    "waviness": Range(0, 1, meaning="how far strokes sway"),
    "irregularity": Range(0, 1, meaning="how unlike strokes, dots and their distances are"),
}
"""Allowed range of each parameter but `count`, the number of strokes or dots."""
MOST_STROKES = 1500
"""Largest number of strokes or dots of a component."""

_PUPIL = Range(0.02, 0.95, meaning="radius of the pupil over the outer one of the iris")
_SIZES = (2, 8192)  # texels along a map's side
_GREY = Range(0.0, 1.0)
_FADE = 0.08  # relative radius: strokes fade in before and out behind what they cover


def component(name: str, parameters: Mapping[str, Any] | None = None) -> "AbstractComponent":
    """The component of a name, with its defaults where `parameters` say nothing else.

    Raises:
        ValueError: naming the known ones for an unknown component or parameter, and for a value
            out of range.
    """
    check_known("component", name, COMPONENTS)
    kind, parameters = COMPONENTS[name], parameters or {}
    for given in parameters:
        check_known(f"parameter of {name}", given, kind.__dataclass_fields__)
    try:
        # Before the types of fields are checked, where they are: a file may hold anything.
        for given, value in parameters.items():
            _check_parameter(given, value)
        return kind(**parameters)
    except ValueError as wrong:
        raise ValueError(f"{name}: {wrong}") from None


def scan(picture: np.ndarray, size: int) -> Opacity:
    """Opacity = 1 − grey value of a scan: black paint on white paper, row 0 at the top
    [L03 Section 3.2].

    Args:
        picture: Encoded values as a file has them, 8 or 16 bits or floats in [0, 1], of shape
            (n, n) or (n, n, channels): grey, grey and alpha, RGB, or RGB and alpha. The outer edge
            of the iris touches its four sides. Grey is the luminance of the values as they are,
            not decoded; where alpha is 0 there is paper.
        size: Texels along a side of the map; others are averaged, or interpolated (bicubic).

    Raises:
        ValueError: for a picture that is not square, of other numbers, not finite or out of range,
            and for a size out of range.
    """
    from PIL import Image

    check_whole("size", size, *_SIZES)
    given = np.asarray(picture)
    if given.ndim not in (2, 3) or (given.ndim == 3 and given.shape[2] not in (1, 2, 3, 4)):
        raise ValueError(f"a scan has shape {given.shape}; need (n, n), or (n, n, 1 to 4 channels)")
    rows, columns = given.shape[:2]
    if rows != columns or rows < 2:
        raise ValueError(
            f"a scan is {columns} × {rows} pixels; it must be square, the outer edge of the iris "
            f"touching its four sides"
        )
    if given.dtype in (np.uint8, np.uint16):
        values = given.astype(np.float32) / np.iinfo(given.dtype).max
    elif np.issubdtype(given.dtype, np.floating):
        check_range("grey value of a scan", given, _GREY)
        values = given.astype(np.float32)
    else:
        raise ValueError(f"a scan of {given.dtype} values; need 8 or 16 bits, or floats in {_GREY}")
    opacity = 1 - _grey(values)
    if rows != size:
        resized = Image.fromarray(opacity).resize((size, size), Image.Resampling.BICUBIC)
        opacity = np.asarray(resized)
    return np.clip(opacity, 0, 1).astype(np.float32)


def _setting(default: float) -> Any:
    """A parameter with this default."""
    return eqx.field(static=True, default=default)


class AbstractComponent(eqx.Module):
    """A component of a coat: an immutable value whose fields are its parameters, plain numbers.

    Raises:
        ValueError: naming a parameter, its value and its range.
    """

    def __post_init__(self):
        for name, value in vars(self).items():
            _check_parameter(name, value)
        inner, outer = getattr(self, "inner", 0), getattr(self, "outer", 1)
        if not inner < outer:
            raise ValueError(f"inner = {inner:g} is not below outer = {outer:g}")

    def opacity(self, size: int, pupil: float, *, key: PRNGKey) -> Opacity:
        """Draw an opacity map, float32 of shape (size, size), 0 (clear) to 1 (opaque).

        Texel (i, j) lies at x = (2(j + ½)/size − 1)R, y = (1 − 2(i + ½)/size)R, with R the outer
        radius of the iris; `pupil` is that of the pupil over R. Equal keys give equal maps, and
        another size samples the same painting. Beyond the iris all is clear, but for two texels
        that interpolation at its edges needs.

        Raises:
            ValueError: for a size or a pupil out of range.
        """
        check_whole("size", size, *_SIZES)
        check_range("pupil", pupil, _PUPIL)
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
        ring, radius = Annulus(float(pupil)), np.hypot(*_texels(size))
        paint = self._paint(rng, ring)
        drawn = 0.0 if paint is None else paint.opacity(size, vars(self)["softness"])
        wash = self._wash(rng, ring.relative(radius))
        if wash is not None:
            drawn = 1 - (1 - wash) * (1 - drawn)
        margin = 4 / size
        on = (radius <= 1 + margin) & (radius >= ring.pupil - margin)
        return np.where(on, np.clip(drawn, 0, 1), 0).astype(np.float32)

    def _paint(self, rng: np.random.Generator, ring: Annulus) -> Paint | None:
        """Strokes and dots, of the component's `softness`."""
        return None

    def _wash(self, rng: np.random.Generator, radius: Opacity) -> Opacity | None:
        """Smooth opacity at texels of these relative radii, beneath the strokes."""
        return None


class Base(AbstractComponent):
    """Opaque all over the iris."""

    def _wash(self, rng, radius):
        return np.ones_like(radius)


class StromaDots(AbstractComponent):
    """Well-defined dots, evenly distributed over the area."""

    count: int = _setting(320)
    width: float = _setting(0.016)
    inner: float = _setting(0.06)
    outer: float = _setting(0.97)
    irregularity: float = _setting(0.7)
    softness: float = _setting(0.0035)

    def _paint(self, rng, ring):
        return _scattered(rng, ring, self).paint(rng, ring, self.softness)


class StromaSmearedDots(AbstractComponent):
    """Dots drawn out along the radius, each with a tail of its paint."""

    count: int = _setting(220)
    width: float = _setting(0.016)
    length: float = _setting(0.16)
    inner: float = _setting(0.05)
    outer: float = _setting(0.97)
    waviness: float = _setting(0.3)
    irregularity: float = _setting(0.7)
    softness: float = _setting(0.0045)

    def _paint(self, rng, ring):
        dots = _scattered(rng, ring, self)
        return _smeared(rng, ring, self, dots, 0.012 * self.waviness, 0.3)


class StromaSmears(AbstractComponent):
    """Radial smears or fibres over nearly all of the iris, in bundles."""

    count: int = _setting(420)
    width: float = _setting(0.013)
    length: float = _setting(0.5)
    inner: float = _setting(0.05)
    outer: float = _setting(1.0)
    waviness: float = _setting(0.5)
    irregularity: float = _setting(0.6)
    softness: float = _setting(0.004)

    def _paint(self, rng, ring):
        n, irregularity = self.count, self.irregularity
        angle = angles_round(rng, n, irregularity)
        room = self.outer - self.inner + 2 * _FADE
        length = np.minimum(self.length * log_normal(rng, n, 0.7 * irregularity), room)
        strokes = Strokes(
            angle,
            self.inner - _FADE + (room - length) * rng.uniform(0, 1, n),
            length,
            self.width * log_normal(rng, n, 0.9 * irregularity),
            0.014 * self.waviness * rng.uniform(0.4, 1.6, n),
            0.6 * log_normal(rng, n, 1.6 * irregularity) * _bundled(rng, angle, irregularity),
        )
        return strokes.paint(rng, ring, self.softness, head=0.4)


class CollaretteSpokes(AbstractComponent):
    """Spokes from the pupil to a ragged collarette, widest towards it."""

    count: int = _setting(120)
    width: float = _setting(0.02)
    inner: float = _setting(0.0)
    outer: float = _setting(0.4)
    waviness: float = _setting(0.3)
    irregularity: float = _setting(0.6)
    softness: float = _setting(0.004)

    def _paint(self, rng, ring):
        n, irregularity = self.count, self.irregularity
        angle = angles_round(rng, n, irregularity)
        room = self.outer - self.inner
        start = self.inner - _FADE + 0.45 * room * irregularity * rng.uniform(0, 1, n) ** 2
        # The collarette is a zigzag: neighbouring spokes end at similar radii.
        ragged = 0.06 * smooth_noise(rng, 5)(angle) + 0.09 * smooth_noise(rng, 26)(angle)
        ragged += 0.06 * rng.normal(size=n)
        end = self.outer - room * np.clip(-irregularity * ragged, -0.25, 0.6)
        strokes = Strokes(
            angle,
            start,
            end - start,
            self.width * log_normal(rng, n, 0.8 * irregularity),
            0.02 * self.waviness * rng.uniform(0.4, 1.6, n),
            0.8 * log_normal(rng, n, 1.2 * irregularity) * _bundled(rng, angle, irregularity),
        )
        return strokes.paint(rng, ring, self.softness, head=0.65)


class CollaretteDots(AbstractComponent):
    """Dots on the inner half, crowded towards the collarette; with a `length` they are smeared."""

    count: int = _setting(170)
    width: float = _setting(0.014)
    length: float = _setting(0.0)
    inner: float = _setting(0.05)
    outer: float = _setting(0.5)
    irregularity: float = _setting(0.7)
    softness: float = _setting(0.0035)

    def _paint(self, rng, ring):
        dots = _scattered(rng, ring, self)
        ragged = 0.65 + 0.12 * self.irregularity * smooth_noise(rng, 24)(dots.angle)
        spread = (0.1 + 0.2 * rng.uniform(0, 1, self.count)) * rng.normal(size=self.count)
        crowded = self.inner + (self.outer - self.inner) * np.clip(ragged + spread, 0, 1)
        dots = dots._replace(relative=crowded)
        if self.length == 0:
            return dots.paint(rng, ring, self.softness)
        return _smeared(rng, ring, self, dots, 0.004, 0.6)


class Sphincter(AbstractComponent):
    """A soft ring close to the pupil: fine radial dabs on a thin wash."""

    count: int = _setting(150)
    reach: float = _setting(0.2)
    irregularity: float = _setting(0.5)
    softness: float = _setting(0.008)

    def _paint(self, rng, ring):
        n, irregularity = self.count, self.irregularity
        girth = 2 * np.pi * ring.place(self.reach / 2)
        strokes = Strokes(
            angles_round(rng, n, irregularity),
            np.full(n, -0.02),
            self.reach * log_normal(rng, n, 0.5 * irregularity),
            girth / max(n, 1) * log_normal(rng, n, 0.5),
            np.full(n, 0.004),
            0.7 * log_normal(rng, n, 0.6 * irregularity),
        )
        return strokes.paint(rng, ring, self.softness, head=0.35)

    def _wash(self, rng, radius):
        ragged = _ragged(rng, len(radius), 14, 0.25 * self.irregularity)
        return 0.55 * (1 - smooth_step(radius / (1.3 * self.reach) + ragged))


class Limbus(AbstractComponent):
    """A soft border: clear inwards, opaque at the outer edge, frayed between."""

    count: int = _setting(260)
    reach: float = _setting(0.22)
    irregularity: float = _setting(0.5)
    softness: float = _setting(0.012)

    def _paint(self, rng, ring):
        n, irregularity = self.count, self.irregularity
        angle = angles_round(rng, n, irregularity)
        length = 0.8 * self.reach * log_normal(rng, n, 0.4 * irregularity)
        strokes = Strokes(
            angle,
            1.05 - length,
            length,
            2 * np.pi / max(n, 1) * log_normal(rng, n, 0.5),
            np.full(n, 0.006),
            0.9 * log_normal(rng, n, 0.6 * irregularity),
        )
        return strokes.paint(rng, ring, self.softness, head=0.75)

    def _wash(self, rng, radius):
        inwards = np.maximum(1 - radius, 0) / self.reach
        ragged = np.exp(_ragged(rng, len(radius), 14, 0.2 * self.irregularity))
        return 1 - smooth_step(inwards * ragged)


class PupilRing(AbstractComponent):
    """A soft ring at the pupil's margin; the pupil itself is the hole in the cones."""

    reach: float = _setting(0.06)
    irregularity: float = _setting(0.3)

    def _wash(self, rng, radius):
        outwards = np.maximum(radius, 0) / self.reach
        ragged = np.exp(_ragged(rng, len(radius), 24, 0.4 * self.irregularity))
        return 1 - smooth_step(outwards * ragged)


COMPONENTS: Mapping[str, type[AbstractComponent]] = {
    "base": Base,
    "stroma-dots": StromaDots,
    "stroma-smeared-dots": StromaSmearedDots,
    "stroma-smears": StromaSmears,
    "collarette-spokes": CollaretteSpokes,
    "collarette-dots": CollaretteDots,
    "sphincter": Sphincter,
    "limbus": Limbus,
    "pupil": PupilRing,
}
"""Components by the names that recipes have for them."""


def _check_parameter(name: str, value: Any) -> None:
    """Raise `ValueError` unless a component's parameter is a number in its range."""
    if name == "count":
        check_whole(name, value, 0, MOST_STROKES)
    elif isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{name} = {value!r} is not a number")
    else:
        check_range(name, value, PARAMETER_RANGES[name])


def _texels(size: int) -> tuple[Float32[np.ndarray, "1 size"], Float32[np.ndarray, "size 1"]]:
    """x and y of texels, in outer radii of the iris."""
    x = ((2 * np.arange(size) + 1) / size - 1).astype(np.float32)
    return x[None], -x[:, None]


def _bundled(rng, angle, irregularity: float):
    """Factors on the paint of strokes, alike for neighbours: fibres come in bundles."""
    return np.exp(0.5 * irregularity * smooth_noise(rng, 40)(angle))


def _scattered(rng, ring: Annulus, of) -> Dots:
    """Dots of even density over the area."""
    n, irregularity = of.count, of.irregularity
    angle = angles_round(rng, n, irregularity)
    # Golden sections keep neighbours apart, as far as they are regular.
    even = rng.uniform() + np.arange(n) * (np.sqrt(5) - 1) / 2
    share = (even + irregularity * rng.uniform(-0.5, 0.5, n)) % 1
    inner, outer = ring.place(of.inner), ring.place(of.outer)
    return Dots(
        angle,
        ring.relative(np.sqrt(inner**2 + share * (outer**2 - inner**2))),
        of.width * log_normal(rng, n, 0.6 * irregularity),
        2.5 * log_normal(rng, n, 0.8 * irregularity),
    )


def _smeared(rng, ring: Annulus, of, dots: Dots, wave: float, head: float) -> Paint:
    """Dots with tails, a share `head` of whose length lies within the dot."""
    n = of.count
    length = of.length * log_normal(rng, n, 0.7 * of.irregularity)
    tails = Strokes(
        dots.angle,
        dots.relative - head * length,
        length,
        0.8 * dots.width,
        wave * rng.uniform(0.4, 1.6, n),
        0.7 * dots.depth,
    )
    heads = dots._replace(width=0.7 * dots.width, depth=0.6 * dots.depth)
    return tails.paint(rng, ring, of.softness, head) | heads.paint(rng, ring, of.softness)


def _ragged(rng, size: int, harmonics: int, height: float) -> Opacity:
    """A smooth random function of the angle at each texel, of standard deviation `height`."""
    steps = 8192
    table = height * smooth_noise(rng, harmonics)(2 * np.pi * np.arange(steps) / steps)
    x, y = _texels(size)
    step = np.rint(np.arctan2(y, x) * (steps / (2 * np.pi))).astype(np.int32)
    return table.astype(np.float32)[step % steps]


def _grey(values: np.ndarray) -> np.ndarray:
    """Grey values over white paper, which shows where alpha is 0."""
    if values.ndim == 2:
        return values
    colour, alpha = (
        (values[..., :-1], values[..., -1]) if values.shape[2] in (2, 4) else (values, 1)
    )
    grey = colour @ np.asarray(LUMINANCE, np.float32) if colour.shape[2] == 3 else colour[..., 0]
    return 1 - alpha * (1 - grey)
