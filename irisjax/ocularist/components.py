"""Components of painted coats: what draws an opacity map  [L03 Section 2.3, Fig. 3].

The paper scans what an ocularist has painted. Here components are drawn from a key, and `scan`
takes a picture. Extents along a radius are in relative radii, from 0, the pupil's edge, to 1, the
root; those across are in outer radii of the iris.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from irisjax._types import PRNGKey
from irisjax.numerics.checks import Range, check_known, check_range, check_whole
from irisjax.numerics.streams import words_of
from irisjax.ocularist.strokes import (
    Annulus,
    Dots,
    Opacity,
    Strokes,
    angles_round,
    log_normal,
    smooth_noise,
    smooth_step,
)
from irisjax.render.environment import LUMINANCE
from irisjax.tissue.maps import texels

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

_Shapes = tuple[Strokes | Dots, ...]
_PUPIL = Range(0.02, 0.95, meaning="radius of the pupil over the outer one of the iris")
_SIZES = (2, 8192)  # texels along a map's side
_GREY = Range(0.0, 1.0)
_FADE = 0.08  # relative radius: strokes fade in before and out behind what they cover


def component(name: str, parameters: Mapping[str, Any] | None = None) -> "Component":
    """The component of a name, with its defaults where `parameters` say nothing else.

    Raises:
        ValueError: naming the known ones for an unknown component or parameter, and for a value
            out of range.
    """
    check_known("component", name, COMPONENTS)
    kind, parameters = COMPONENTS[name], parameters or {}
    for given, value in parameters.items():
        check_known(f"parameter of {name}", given, kind.parameters())
        where = f"{name}: {given}"
        if given == "count":
            check_whole(where, value, 0, MOST_STROKES)
        elif isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise ValueError(f"{where} = {value!r} is not a number")
        else:
            check_range(where, value, PARAMETER_RANGES[given])
    made = dataclasses.replace(kind, **parameters)
    if made.inner is not None and made.outer is not None and not made.inner < made.outer:
        raise ValueError(f"{name}: inner = {made.inner:g} is not below outer = {made.outer:g}")
    return made


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
    if given.ndim not in (2, 3) or given.shape[2:] not in [(), (1,), (2,), (3,), (4,)]:
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
    colour = np.atleast_3d(values)
    alpha = 1.0
    if colour.shape[2] in (2, 4):
        colour, alpha = colour[..., :-1], colour[..., -1]
    weights = LUMINANCE if colour.shape[2] == 3 else [1]
    opacity = alpha * (1 - colour @ np.asarray(weights, np.float32))
    if rows != size:
        resized = Image.fromarray(opacity).resize((size, size), Image.Resampling.BICUBIC)
        opacity = np.asarray(resized)
    return np.clip(opacity, 0, 1).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Component:
    """A component of a coat: how it is drawn, and its parameters, plain numbers.

    Parameters that a component does not have are `None`; `PARAMETER_RANGES` says what they mean.

    Attributes:
        paint: Draws strokes and dots.
        wash: Draws the smooth opacity at texels of given relative radii, beneath the strokes.
        count: Number of strokes or dots.
    """

    paint: Callable[["Component", np.random.Generator, Annulus], _Shapes] | None = None
    wash: Callable[["Component", np.random.Generator, Opacity], Opacity] | None = None
    count: int | None = None
    width: float | None = None
    length: float | None = None
    inner: float | None = None
    outer: float | None = None
    reach: float | None = None
    waviness: float | None = None
    irregularity: float | None = None
    softness: float | None = None

    def parameters(self) -> dict[str, float]:
        """Its parameters by name."""
        return {n: v for n, v in vars(self).items() if v is not None and not callable(v)}

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
        rng = np.random.default_rng(words_of(key))
        ring, radius = Annulus(float(pupil)), np.hypot(*texels(size, np.float32))
        drawn: Any = 0.0
        if self.paint is not None:
            soft = self.parameters()["softness"]
            shapes = self.paint(self, rng, ring)
            paint = functools.reduce(operator.or_, (s.paint(rng, ring, soft) for s in shapes))
            drawn = paint.opacity(size, soft)
        if self.wash is not None:
            drawn = 1 - (1 - self.wash(self, rng, ring.relative(radius))) * (1 - drawn)
        margin = 4 / size
        on = (radius <= 1 + margin) & (radius >= ring.pupil - margin)
        return np.where(on, np.clip(drawn, 0, 1), 0).astype(np.float32)


def _stroma_smeared_dots(of, rng, ring):
    """Dots drawn out along the radius, each with a tail of its paint."""
    return _smeared(of, rng, _scattered(of, rng, ring), 0.012 * of.waviness, 0.3)


def _stroma_smears(of, rng, _):
    """Radial smears or fibres over nearly all of the iris, in bundles."""
    angle = angles_round(rng, of.count, of.irregularity)
    room = of.outer - of.inner + 2 * _FADE
    length = np.minimum(of.length * log_normal(rng, of.count, 0.7 * of.irregularity), room)
    start = of.inner - _FADE + (room - length) * rng.uniform(0, 1, of.count)
    return _fibres(of, rng, (angle, start, length), 0.9, 0.014, (0.6, 1.6), head=0.4)


def _collarette_spokes(of, rng, _):
    """Spokes from the pupil to a ragged collarette, widest towards it."""
    n, irregularity, room = of.count, of.irregularity, of.outer - of.inner
    angle = angles_round(rng, n, irregularity)
    start = of.inner - _FADE + 0.45 * room * irregularity * rng.uniform(0, 1, n) ** 2
    # The collarette is a zigzag: neighbouring spokes end at similar radii.
    ragged = 0.06 * smooth_noise(rng, 5)(angle) + 0.09 * smooth_noise(rng, 26)(angle)
    ragged += 0.06 * rng.normal(size=n)
    end = of.outer - room * np.clip(-irregularity * ragged, -0.25, 0.6)
    return _fibres(of, rng, (angle, start, end - start), 0.8, 0.02, (0.8, 1.2), head=0.65)


def _collarette_dots(of, rng, ring):
    """Dots on the inner half, crowded towards the collarette; with a `length` they are smeared."""
    dots = _scattered(of, rng, ring)
    ragged = 0.65 + 0.12 * of.irregularity * smooth_noise(rng, 24)(dots.angle)
    spread = (0.1 + 0.2 * rng.uniform(0, 1, of.count)) * rng.normal(size=of.count)
    crowded = of.inner + (of.outer - of.inner) * np.clip(ragged + spread, 0, 1)
    dots = dots._replace(relative=crowded)
    return (dots,) if of.length == 0 else _smeared(of, rng, dots, 0.004, 0.6)


def _sphincter_dabs(of, rng, ring):
    """A soft ring close to the pupil: fine radial dabs on a thin wash."""
    girth = 2 * np.pi * ring.place(of.reach / 2)
    return _dabs(of, rng, (of.reach, 0.5), girth, 0.004, 0.7, head=0.35)


def _sphincter_wash(of, rng, radius):
    ragged = _ragged(rng, len(radius), 14, 0.25 * of.irregularity)
    return 0.55 * (1 - smooth_step(radius / (1.3 * of.reach) + ragged))


def _limbus_dabs(of, rng, _):
    """A soft border: clear inwards, opaque at the outer edge, frayed between."""
    return _dabs(of, rng, (0.8 * of.reach, 0.4), 2 * np.pi, 0.006, 0.9, head=0.75, end=1.05)


def _edge(of, rng, away, harmonics: int, height: float):
    """Opaque at an edge of the iris, clear beyond a ragged `reach` from it."""
    ragged = np.exp(_ragged(rng, len(away), harmonics, height * of.irregularity))
    return 1 - smooth_step(np.maximum(away, 0) / of.reach * ragged)


def _fibres(of, rng, where, widths, wave, depth, head: float) -> _Shapes:
    """Strokes of `widths`' spread, median and spread of `depth`; neighbours' depths are alike."""
    (angle, start, length), n, irregularity = where, of.count, of.irregularity
    width = of.width * log_normal(rng, n, widths * irregularity)
    sway = wave * of.waviness * rng.uniform(0.4, 1.6, n)
    paint = depth[0] * log_normal(rng, n, depth[1] * irregularity)
    paint *= np.exp(0.5 * irregularity * smooth_noise(rng, 40)(angle))
    return (Strokes(angle, start, length, width, sway, paint, head),)


def _dabs(of, rng, length, girth: float, wave: float, depth: float, head, end=None) -> _Shapes:
    """Fine radial strokes side by side round a circle; `length` is the median and the spread."""
    n, irregularity = of.count, of.irregularity
    angle = angles_round(rng, n, irregularity)
    long = length[0] * log_normal(rng, n, length[1] * irregularity)
    start = np.full(n, -0.02) if end is None else end - long
    width = girth / max(n, 1) * log_normal(rng, n, 0.5)
    paint = depth * log_normal(rng, n, 0.6 * irregularity)
    return (Strokes(angle, start, long, width, np.full(n, wave), paint, head),)


def _scattered(of, rng, ring) -> Dots:
    """Dots of even density over the area."""
    n, irregularity = of.count, of.irregularity
    angle = angles_round(rng, n, irregularity)
    # Golden sections keep neighbours apart, as far as they are regular.
    even = rng.uniform() + np.arange(n) * (np.sqrt(5) - 1) / 2
    share = (even + irregularity * rng.uniform(-0.5, 0.5, n)) % 1
    inner, outer = ring.place(of.inner), ring.place(of.outer)
    relative = ring.relative(np.sqrt(inner**2 + share * (outer**2 - inner**2)))
    width = of.width * log_normal(rng, n, 0.6 * irregularity)
    return Dots(angle, relative, width, 2.5 * log_normal(rng, n, 0.8 * irregularity))


def _smeared(of, rng, dots: Dots, wave: float, head: float) -> _Shapes:
    """Dots with tails, a share `head` of whose length lies within the dot."""
    length = of.length * log_normal(rng, of.count, 0.7 * of.irregularity)
    start, sway = dots.relative - head * length, wave * rng.uniform(0.4, 1.6, of.count)
    tails = Strokes(dots.angle, start, length, 0.8 * dots.width, sway, 0.7 * dots.depth, head)
    return tails, dots._replace(width=0.7 * dots.width, depth=0.6 * dots.depth)


def _ragged(rng, size: int, harmonics: int, height: float) -> Opacity:
    """A smooth random function of the angle at each texel, of standard deviation `height`."""
    steps = 8192
    table = height * smooth_noise(rng, harmonics)(2 * np.pi * np.arange(steps) / steps)
    x, y = texels(size, np.float32)
    step = np.rint(np.arctan2(y, x) * (steps / (2 * np.pi))).astype(np.int32)
    return table.astype(np.float32)[step % steps]


COMPONENTS: Mapping[str, Component] = {
    "base": Component(wash=lambda of, rng, radius: np.ones_like(radius)),
    "stroma-dots": Component(
        lambda *given: (_scattered(*given),),
        count=320, width=0.016, inner=0.06, outer=0.97, irregularity=0.7, softness=0.0035,
    ),
    "stroma-smeared-dots": Component(
        _stroma_smeared_dots,
        count=220, width=0.016, length=0.16, inner=0.05, outer=0.97,
        waviness=0.3, irregularity=0.7, softness=0.0045,
    ),
    "stroma-smears": Component(
        _stroma_smears,
        count=420, width=0.013, length=0.5, inner=0.05, outer=1.0,
        waviness=0.5, irregularity=0.6, softness=0.004,
    ),
    "collarette-spokes": Component(
        _collarette_spokes,
        count=120, width=0.02, inner=0.0, outer=0.4,
        waviness=0.3, irregularity=0.6, softness=0.004,
    ),
    "collarette-dots": Component(
        _collarette_dots,
        count=170, width=0.014, length=0.0, inner=0.05, outer=0.5,
        irregularity=0.7, softness=0.0035,
    ),
    "sphincter": Component(
        _sphincter_dabs, _sphincter_wash, count=150, reach=0.2, irregularity=0.5, softness=0.008
    ),
    "limbus": Component(
        _limbus_dabs,
        lambda of, rng, radius: _edge(of, rng, 1 - radius, 14, 0.2),
        count=260, reach=0.22, irregularity=0.5, softness=0.012,
    ),
    # At the pupil's margin; the pupil itself is the hole in the cones.
    "pupil": Component(
        wash=lambda of, rng, radius: _edge(of, rng, radius, 24, 0.4), reach=0.06, irregularity=0.3
    ),
}  # fmt: skip
"""Components by the names that recipes have for them, with their default parameters."""
