"""Two paints mixed at a share: what a mixer is, and the paper's way, in HSL  [L03 Section 3.2].

Hue, saturation and lightness are those of paint programs, of sRGB's encoded values
[Joblove & Greenberg 1978; CSS Color 3, Section 4.2.4].
"""

import abc
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax._types import as_float
from irisjax.measure.colour import srgb_decode, srgb_encode
from irisjax.numerics.checks import Range, check_range
from irisjax.ocularist.palette import Paints, Palette, places

SHARE = Range(0.0, 1.0, meaning="share of the second paint in a mixture")
_ROUNDING = 1e-6  # of encoded values and of hues in single precision


class AbstractMixer(eqx.Module):
    """A way to mix two paints of those it knows by name."""

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """The known paints."""

    @abc.abstractmethod
    def with_paints(self, colours: Mapping[str, Any]) -> "AbstractMixer":
        """The same with paints added or replaced; colours as for `Palette.of`."""

    @abc.abstractmethod
    def blend(
        self,
        first: Int[Array, "*coats"],
        second: Int[Array, "*coats"],
        share: Float[Array, "*coats"],
    ) -> Float[Array, "*coats 3"]:
        """`mix` of paints by their places among `names`; pure and traced."""

    def mix(self, first: Paints, second: Paints, share) -> Float[Array, "*coats 3"]:
        """Linear sRGB reflectances of mixtures, in [0, 1]; differentiable in `share` and in what
        the mixer holds.

        **Arguments:**

        - `first`, `second`: a name, or one a coat.
        - `share`: of the second paint, 0 to 1; a number, one a coat, or of any shape where both
          paints are one name.

        **Raises:** `ValueError` for an unknown paint, a share out of range, and shapes that do not
        go together.
        """
        check_range("share", share, SHARE)
        i, j, share = places(first, self.names), places(second, self.names), as_float(share)
        try:
            shape = np.broadcast_shapes(i.shape, j.shape, share.shape)
        except ValueError:
            raise ValueError(
                f"paints of shapes {i.shape} and {j.shape} and shares of {share.shape} do not go "
                f"together"
            ) from None
        i, j = jnp.asarray(np.broadcast_to(i, shape)), jnp.asarray(np.broadcast_to(j, shape))
        return _blended(self, i, j, jnp.broadcast_to(share, shape))


@eqx.filter_jit
def _blended(mixer: AbstractMixer, first, second, share):
    return mixer.blend(first, second, share)


class HslMixer(AbstractMixer):
    """The paper's: hue, saturation and lightness each at the share; see `mixed_in_hsl`.

    Ultramarine and cadmium yellow make a pink in it: between their hues the short way lies red.
    """

    palette: Palette = eqx.field(default_factory=Palette.default)

    @property
    def names(self):
        """See `AbstractMixer`."""
        return self.palette.names

    def with_paints(self, colours):
        """See `AbstractMixer`."""
        return HslMixer(self.palette.with_paints(colours))

    def blend(self, first, second, share):
        """See `AbstractMixer`."""
        colours = self.palette.colours
        return mixed_in_hsl(colours[first], colours[second], share.astype(colours.dtype))


def mixed_in_hsl(
    first: Float[Array, "*s 3"], second: Float[Array, "*s 3"], share: Float[Array, "*s"]
) -> Float[Array, "*s 3"]:
    """Linear sRGB of mixtures of two linear colours, `share` of the second  [L03 Section 3.2].

    Hue goes the short way round; between opposite hues it goes the way that does not pass red
    (hue 0), whichever is first. A grey has no hue and takes the other's; two greys make a grey.
    """
    hue, saturation, lightness = hsl_of(srgb_encode(first))
    other_hue, other_saturation, other_lightness = hsl_of(srgb_encode(second))
    hue, other_hue = (
        jnp.where(saturation > 0, hue, other_hue),
        jnp.where(other_saturation > 0, other_hue, hue),
    )
    gap = other_hue - hue
    # Opposite hues are no more than half a turn apart though rounding may say so.
    half = 0.5 + _ROUNDING
    gap = gap - jnp.where(gap > half, 1.0, 0.0) + jnp.where(gap < -half, 1.0, 0.0)
    return srgb_decode(
        srgb_of(
            hue + share * gap,
            saturation + share * (other_saturation - saturation),
            lightness + share * (other_lightness - lightness),
        )
    )


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
    sextant = jnp.where(
        high == red,
        (green - blue) / by,
        jnp.where(high == green, 2 + (blue - red) / by, 4 + (red - green) / by),
    )
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
