"""An ocularist's palette: names of paints and their colours.

The paper paints with fewer than ten  [L03 Section 3.2]; it prints them as a picture, without
numbers. The colours here are of artists' oil paints as they come from the tube (masstones), by
spectrophotometer, in sRGB: Sensual Logic, Artist Color Data (sensuallogic.com/artistcolordata),
taken to 8 bits from the copy with three decimals in the LYGIA shader library (`color/palette`).
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.numerics.checks import Range, check_known, check_range

Paints = str | Sequence[str]
"""The name of a paint, or one name a coat."""


class Published(NamedTuple):
    """A paint's colour, `#rrggbb` in sRGB, and whose paint it is."""

    srgb: str
    source: str


_REMBRANDT = "Rembrandt (Royal Talens)"
PAINTS = {
    # In HSL the faint tint of a black or a white would count as its hue: both are made neutral.
    "ivory black": Published("#101010", "Winsor & Newton; (16, 15, 17) made neutral"),
    "titanium white": Published("#fdfdfd", f"{_REMBRANDT}; (253, 254, 249) made neutral"),
    "yellow ochre": Published("#ac7726", _REMBRANDT),
    "burnt sienna": Published("#65382f", _REMBRANDT),
    "burnt umber": Published("#3c2823", _REMBRANDT),
    "ultramarine": Published("#1e1da0", f"{_REMBRANDT}, ultramarine deep"),
    "phthalo blue": Published("#072b73", f"{_REMBRANDT}, phthalo blue red"),
    "cadmium yellow": Published("#ffc000", f"{_REMBRANDT}, cadmium yellow medium"),
    "cadmium red": Published("#cd261e", f"{_REMBRANDT}, cadmium red medium"),
}
"""The default paints."""
FURTHER_PAINTS = {
    "raw sienna": Published("#8b5f2f", _REMBRANDT),
    "raw umber": Published("#322b26", _REMBRANDT),
}
"""Paints that can be added by name."""

_REFLECTANCE = Range(0.0, 1.0)
_STEP = Range(0.0, 255.0)


class Palette(eqx.Module):
    """Paints by name; immutable, and differentiable in the colours.

    **Fields:** `names`, and `colours`, linear sRGB reflectances in [0, 1], shape (paints, 3).

    **Raises:** `ValueError` for names that are not one a colour and for reflectances out of range.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    colours: Float[Array, "paints 3"]

    def __post_init__(self):
        if len(set(self.names)) != len(self.names) or len(self.names) != self.colours.shape[0]:
            raise ValueError(
                f"a palette needs one name a colour, each once; got {len(self.names)} names for "
                f"{self.colours.shape[0]} colours: {', '.join(self.names)}"
            )
        for name, colour in zip(self.names, self.colours, strict=True):
            check_range(f"reflectance of paint {name!r}", colour, _REFLECTANCE)

    @classmethod
    def default(cls) -> "Palette":
        """The paints of `PAINTS`."""
        return cls.of({name: paint.srgb for name, paint in PAINTS.items()})

    @classmethod
    def of(cls, colours: Mapping[str, Any]) -> "Palette":
        """Paints of a mapping from names to `#rrggbb` or to three numbers from 0 to 255 (sRGB).

        **Raises:** `ValueError` for what is no colour, and for no paint at all.
        """
        if not colours:
            raise ValueError("a palette needs at least one paint")
        linear = [linear_colour(name, colour) for name, colour in colours.items()]
        return cls(tuple(colours), jnp.asarray(np.stack(linear), jnp.result_type(float)))

    def with_paints(self, colours: Mapping[str, Any]) -> "Palette":
        """The same with paints added, or replaced where the name is known; colours as for `of`."""
        paints = dict(zip(self.names, self.colours, strict=True))
        dtype = self.colours.dtype
        paints |= {n: jnp.asarray(linear_colour(n, c), dtype) for n, c in colours.items()}
        return Palette(tuple(paints), jnp.stack(list(paints.values())))

    def colour(self, paints: Paints) -> Float[Array, "*coats 3"]:
        """Linear colour of a paint, shape (3,), or of one a coat, (coats, 3).

        **Raises:** `ValueError` naming the known paints for an unknown one.
        """
        return self.colours[places(paints, self.names)]

    def srgb(self) -> dict[str, str]:
        """The paints as `of` takes them, each `#rrggbb`."""
        steps = np.rint(255 * np.asarray(srgb_encode(self.colours))).astype(int)
        return {
            name: "#" + "".join(f"{step:02x}" for step in colour)
            for name, colour in zip(self.names, steps.tolist(), strict=True)
        }


def linear_colour(name: str, colour: Any) -> np.ndarray:
    """Linear sRGB, shape (3,), of `#rrggbb` or three numbers from 0 to 255.

    **Raises:** `ValueError` naming the paint for anything else.
    """
    if isinstance(colour, str) and re.fullmatch("#[0-9a-fA-F]{6}", colour):
        steps = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    elif isinstance(colour, Sequence | np.ndarray) and _three_steps(colour):
        steps = list(colour)
    else:
        raise ValueError(
            f"paint {name!r}: {colour!r} is no colour; need '#rrggbb' or three numbers in {_STEP}"
        )
    return np.asarray(srgb_decode(np.asarray(steps, np.float64) / 255), np.float64)


def _three_steps(colour) -> bool:
    return len(colour) == 3 and all(
        isinstance(s, int | float | np.number) and not isinstance(s, bool) and _STEP.holds(s)
        for s in colour
    )


def places(paints: Paints, known: tuple[str, ...]) -> np.ndarray:
    """Places of paints among the known names: shape () for one name, (coats,) for one a coat.

    **Raises:** `ValueError` naming the known paints, and the nearest, for an unknown one.
    """
    if isinstance(paints, str):
        return np.asarray(_place(paints, known))
    return np.asarray([_place(paint, known) for paint in paints], int)


def _place(paint: str, known: tuple[str, ...]) -> int:
    check_known("paint", paint, known)
    return known.index(paint)
