"""Paints and mixtures of two of them: the interface of mixers, and the paper's own in HSL
[L03 Section 3.2].

The paper paints with fewer than ten paints; it prints them as a picture, without numbers. The
colours here are of artists' oil paints as they come from the tube (masstones), by
spectrophotometer, in sRGB: Sensual Logic, Artist Color Data (sensuallogic.com/artistcolordata),
taken to 8 bits from the copy with three decimals in the LYGIA shader library (`color/palette`).

Hue, saturation and lightness are those of paint programs, of sRGB's encoded values
[Joblove & Greenberg 1978; CSS Color 3, Section 4.2.4].
"""

import abc
import re
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax._types import as_float
from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.numerics.checks import Range, check_known, check_range, is_known

PaintNames = str | Sequence[str]
"""The name of a paint, or one name per coat."""
CoatIndices = Int[Array, "*coats"]
CoatShares = Float[Array, "*coats"]
CoatColours = Float[Array, "*coats 3"]

# By Rembrandt (Royal Talens), but for the black, which is by Winsor & Newton. In HSL the faint tint
# of a black or a white would count as its hue: (16, 15, 17) and (253, 254, 249) were made neutral.
PAINTS = {
    "ivory black": "#101010",
    "titanium white": "#fdfdfd",
    "yellow ochre": "#ac7726",
    "burnt sienna": "#65382f",
    "burnt umber": "#3c2823",
    "ultramarine": "#1e1da0",  # ultramarine deep
    "phthalo blue": "#072b73",  # phthalo blue red
    "cadmium yellow": "#ffc000",  # cadmium yellow medium
    "cadmium red": "#cd261e",  # cadmium red medium
}
"""The default paints and their published colours, sRGB."""
FURTHER_PAINTS = {"raw sienna": "#8b5f2f", "raw umber": "#322b26"}
"""Paints that can be added by name."""

_SHARE = Range(0.0, 1.0, meaning="share of the second paint in a mixture")
_REFLECTANCE = Range(0.0, 1.0)
_STEP = Range(0.0, 255.0)
NO_COLOUR = f"is no colour; need '#rrggbb' or three numbers in {_STEP}"
"""Message about what `linear_colour` cannot take."""
_ROUNDING = 1e-6  # of encoded values and of hues in single precision


class AbstractMixer(eqx.Module):
    """A rule that mixes any two of a set of named paints.

    Attributes:
        paints: Their names, each once.
    """

    paints: eqx.AbstractVar[tuple[str, ...]]

    @abc.abstractmethod
    def with_paints(self, colours: Mapping[str, object]) -> "AbstractMixer":
        """The mixer with paints added or replaced; colours as for `linear_colour`."""

    @abc.abstractmethod
    def blend(self, first: CoatIndices, second: CoatIndices, share: CoatShares) -> CoatColours:
        """`mix` of paints by their indices in `paints`; pure, for traced arrays."""

    def indices(self, names: PaintNames) -> Int[np.ndarray, "*coats"]:
        """Indices of paints in `paints`: shape () for one name, (coats,) for one per coat.

        Raises:
            ValueError: naming the known paints, and the nearest, for an unknown one.
        """
        for name in [names] if isinstance(names, str) else names:
            check_known("paint", name, self.paints)
        where = self.paints.index
        return np.asarray(where(names) if isinstance(names, str) else [*map(where, names)], int)

    def mix(
        self, first: PaintNames, second: PaintNames, share: Float[Array, "..."] | np.ndarray | float
    ) -> Float[Array, "*coats 3"]:
        """Linear sRGB reflectances of mixtures, in [0, 1]; differentiable in `share` and in the
        mixer's arrays.

        Args:
            first: Name of the first paint, or one name per coat.
            second: Name of the second paint, or one name per coat.
            share: Share of the second paint, 0 to 1: a number, one per coat, or an array of any
                shape if both paints are one name.

        Raises:
            ValueError: for an unknown paint, a share out of range, and shapes that do not go
                together.
        """
        check_range("share", share, _SHARE)
        i, j, share = self.indices(first), self.indices(second), as_float(share)
        try:
            return _blended(self, *jnp.broadcast_arrays(i, j, share))
        except ValueError:
            shapes = f"paints of shapes {i.shape} and {j.shape} and shares of {share.shape}"
            raise ValueError(f"{shapes} do not go together") from None


@eqx.filter_jit
def _blended(mixer: AbstractMixer, first, second, share):
    return mixer.blend(first, second, share)


class HslMixer(AbstractMixer):
    """The paper's mixtures: hue, saturation and lightness are interpolated; see `mixed_in_hsl`.

    Ultramarine and cadmium yellow make a pink: the short way between their hues passes red.

    Attributes:
        paints: Their names, each once.
        colours: Linear sRGB reflectances in [0, 1], shape (paints, 3).

    Raises:
        ValueError: unless there is one name per colour, and for reflectances out of range.
    """

    paints: tuple[str, ...] = eqx.field(static=True)
    colours: Float[Array, "paints 3"]

    def __post_init__(self) -> None:
        if len(set(self.paints)) != len(self.paints) or len(self.paints) != self.colours.shape[0]:
            raise ValueError(
                f"a palette needs one name a colour, each once; got {len(self.paints)} names for "
                f"{self.colours.shape[0]} colours: {', '.join(self.paints)}"
            )
        for name, colour in zip(self.paints, rows(self.colours), strict=True):
            check_range(f"reflectance of paint {name!r}", colour, _REFLECTANCE)

    @classmethod
    def default(cls) -> "HslMixer":
        """A mixer of `PAINTS`."""
        return cls.of(PAINTS)

    @classmethod
    def of(cls, colours: Mapping[str, object]) -> "HslMixer":
        """A mixer of paints given by name; colours as for `linear_colour`.

        Raises:
            ValueError: for a value that is no colour, and for an empty mapping.
        """
        if not colours:
            raise ValueError("a palette needs at least one paint")
        linear = np.stack([linear_colour(*paint) for paint in colours.items()])
        return cls(tuple(colours), jnp.asarray(linear, jnp.result_type(float)))

    def with_paints(self, colours: Mapping[str, object]) -> "HslMixer":
        """See `AbstractMixer`."""
        paints = dict(zip(self.paints, rows(self.colours), strict=True))
        dtype = self.colours.dtype
        paints |= {n: jnp.asarray(linear_colour(n, c), dtype) for n, c in colours.items()}
        return HslMixer(tuple(paints), jnp.stack(list(paints.values())))

    def blend(self, first: CoatIndices, second: CoatIndices, share: CoatShares) -> CoatColours:
        """See `AbstractMixer`."""
        share = share.astype(self.colours.dtype)
        return mixed_in_hsl(self.colours[first], self.colours[second], share)


def rows(table: Array | np.ndarray) -> Array | np.ndarray:
    """The rows of a table, by NumPy where it can be: JAX compiles for each number of rows."""
    return np.asarray(table) if is_known(table) else table


def linear_colour(name: str, colour: object) -> np.ndarray:
    """Linear sRGB, shape (3,), of `#rrggbb` or three numbers from 0 to 255.

    Raises:
        ValueError: naming the paint for anything else.
    """
    steps: Any = colour
    if isinstance(colour, str) and re.fullmatch("#[0-9a-fA-F]{6}", colour):
        steps = [*bytes.fromhex(colour[1:])]
    three = isinstance(steps, Sequence | np.ndarray) and len(steps) == 3
    numbers = three and all(isinstance(s, int | float | np.number) for s in steps)
    if not numbers or any(isinstance(s, bool) or not _STEP.holds(s) for s in steps):
        raise ValueError(f"paint {name!r}: {colour!r} {NO_COLOUR}")
    return np.asarray(srgb_decode(np.asarray(steps, np.float64) / 255), np.float64)


def mixed_in_hsl(
    first: Float[Array, "*s 3"], second: Float[Array, "*s 3"], share: Float[Array, "*s"]
) -> Float[Array, "*s 3"]:
    """Linear sRGB of mixtures of two linear colours, `share` of the second  [L03 Section 3.2].

    Hue goes the short way round; between opposite hues it goes the way that does not pass red
    (hue 0), whichever is first. A grey has no hue and takes the other's; two greys make a grey.
    """
    one, other = hsl_of(srgb_encode(first)), hsl_of(srgb_encode(second))
    hue = jnp.where(one[1] > 0, one[0], other[0])
    gap = jnp.where(other[1] > 0, other[0], hue) - hue
    # Rounding may put opposite hues more than half a turn apart.
    half = 0.5 + _ROUNDING
    gap = gap - jnp.where(gap > half, 1.0, 0.0) + jnp.where(gap < -half, 1.0, 0.0)
    rest = (a + share * (b - a) for a, b in zip(one[1:], other[1:], strict=True))
    return srgb_decode(srgb_of(hue + share * gap, *rest))


def hsl_of(
    encoded: Float[Array, "*s 3"],
) -> tuple[Float[Array, "*s"], Float[Array, "*s"], Float[Array, "*s"]]:
    """Hue (turns, 0 for a grey), saturation and lightness of encoded sRGB in [0, 1].

    The derivatives at a grey are those of its lightness alone.
    """
    red, green, blue = encoded[..., 0], encoded[..., 1], encoded[..., 2]
    high, low = encoded.max(-1), encoded.min(-1)
    chroma = high - low
    grey = chroma <= _ROUNDING
    by = jnp.where(grey, 1.0, chroma)
    # Not by equality with `high`: XLA may round a value differently each time it recomputes it.
    largest = jnp.argmax(encoded, -1)
    sextants = (green - blue) / by, 2 + (blue - red) / by, 4 + (red - green) / by
    sextant = jnp.select([largest == 0, largest == 1], sextants[:2], sextants[2])
    hue = jnp.where(grey, 0.0, sextant / 6)
    room = jnp.where(grey, 1.0, 1 - jnp.abs(high + low - 1))
    return hue - jnp.floor(hue), jnp.where(grey, 0.0, chroma / room), (high + low) / 2


def srgb_of(
    hue: Float[Array, "*s"], saturation: Float[Array, "*s"], lightness: Float[Array, "*s"]
) -> Float[Array, "*s 3"]:
    """Encoded sRGB of hue (turns, any whole number of them more or less), saturation and lightness
    [CSS Color 4, Section 7.1].
    """
    reach = saturation * jnp.minimum(lightness, 1 - lightness)

    def channel(offset):
        place = (offset + 12 * hue) % 12
        wave = jnp.clip(jnp.minimum(place - 3, 9 - place), -1.0, 1.0)
        return lightness - reach * wave

    return jnp.stack([channel(0.0), channel(8.0), channel(4.0)], -1)
