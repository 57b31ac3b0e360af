"""A painted iris in a scene: coats of paint in place of tissue, from the uppermost down  [L03
Section 3.3].
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.ocularist import composite
from irisjax.ocularist.coats import Coat, Painting
from irisjax.ocularist.cones import Cones
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import fluxes_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales

NEAR = 0.03
"""Difference in height (mm) up to which coats are lit alike but for what they take from each other:
light moves aside by less than a texel of a shadow between them.
"""


class Painted(AbstractIntegrator):
    """Integrator: coats of paint; a scene with it has no tissue.

    - `painting`: its coats. `as_printed`: shadows by the paper's Eq. 2 as it is printed.
    """

    painting: Painting
    as_printed: bool = eqx.field(static=True, default=False)
    process: None = None

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris | None,
        maps: IrisMaps | None,
        tables: Illumination | None,
    ) -> Float[Array, "3 pixels"]:
        """Radiance of each pixel in white light; see `AbstractIntegrator`."""
        base = self.base(pixels, lights, eye, tables)
        state = base.state
        for layer in self.layers(base):
            state = layer.state
        return state.radiance

    def base(
        self, pixels: IrisPixels, lights: Lights, eye: Eye, tables: Illumination | None
    ) -> "PaintBase":
        """Compute everything that does not depend on the coats."""
        profile, reach = self.painting.profile, eye.iris_radius
        flux = fluxes_of(lights, eye, tables)
        seen = composite.ground(pixels, profile, eye, flux)
        shape = len(lights), composite.SHADOW, composite.SHADOW, composite.CHANNELS
        return PaintBase(
            seen=seen,
            rays=composite.rays(flux, profile, reach),
            light=composite.full_light(flux, shape),
            state=composite.nothing(seen),
            tint=lights.tint,
            rim=(profile, reach, eye.pupil_margin),
        )

    def layers(
        self, base: "PaintBase", before: Sequence["PaintedLayer"] = ()
    ) -> Iterator["PaintedLayer"]:
        """Paint the groups of coats, from the uppermost down.

        Args:
            base: Result of `base`.
            before: Layers of a painting on the same base. A layer whose coats, and those above it,
                are the same objects is not painted again; a coat's opacity is looked up again only
                where it has changed.
        """
        known = {part.coat.name: part for layer in before for part in layer.parts}
        groups, state, light, same = _groups(self.painting), base.state, base.light, True
        for nth, group in enumerate(groups):
            last = group is groups[-1]
            same = same and nth < len(before) and _same(group, before[nth])
            if same and (last or before[nth].light is not None):
                layer = before[nth]
            else:
                parts = tuple(
                    _painted_coat(coat, base, known.get(coat.name), last) for coat in group
                )
                layer = self._painted(base, state, light, parts, last)
            yield layer
            state, light = layer.state, layer.light

    def _painted(
        self, base: "PaintBase", state, light, parts: "tuple[PaintedCoat, ...]", last: bool
    ):
        height, colours = parts[0].coat.height, tuple(part.coat.colour for part in parts)
        covered = state, tuple(part.covered for part in parts), base.seen
        reach = base.rim[1]
        state = composite.paint_over(
            covered, light, colours, height, base.tint, reach, self.as_printed
        )
        crossed = tuple(part.crossed for part in parts)
        below = None if last else composite.light_under(light, crossed, colours, self.as_printed)
        return PaintedLayer(parts, state, below)

    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "PaintedResponse":
        """Of a picture in linear sRGB: colours of paints are no spectra.

        **Raises:** `ValueError` for a picture of other channels.
        """
        if bands.channels != ("R", "G", "B"):
            raise ValueError("a painted iris has colours, not spectra: leave out the wavelengths")
        return PaintedResponse(white=bands.white)


class PaintBase(NamedTuple):
    """What all coats are painted on.

    Attributes:
        seen: Where pixels see the base.
        rays: Directions of the lights at its texels.
        light: Maps of light above all coats.
        state: Radiance before any coat.
        tint: Tint of each light.
        rim: Profile of the base, its radius and the width over which coats fade into the pupil, mm.
    """

    seen: composite.Ground
    rays: Array
    light: Array
    state: composite.State
    tint: Array | None
    rim: tuple[Cones, Array, Array]


class PaintedCoat(NamedTuple):
    """A coat, its opacity at the pixels and where rays cross it (`None` of the lowest group)."""

    coat: Coat
    covered: Array
    crossed: Array | None


class PaintedLayer(NamedTuple):
    """A group of coats, what they and those above send back, and the light below them."""

    parts: tuple[PaintedCoat, ...]
    state: composite.State
    light: Array | None


class PaintedResponse(AbstractResponse):
    """`white`: what a white sheet shows behind the cornea, in the picture's channels."""

    white: Float[Array, "3"]
    error: None = None
    status: None = None

    def shade(
        self, pixels: IrisPixels, texels: None, light: Float[Array, "3 pixels"]
    ) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        return self.white[:, None] * light


def _painted_coat(
    coat: Coat, base: PaintBase, before: PaintedCoat | None, last: bool
) -> PaintedCoat:
    """A coat where pixels and rays meet it; what was looked up of the same opacity is kept."""
    where = coat.opacity, coat.height, *base.rim
    covered, crossed = None, None
    pairs = (
        ()
        if before is None
        else ((before.coat.opacity, coat.opacity), (before.coat.height, coat.height))
    )
    if before is not None and all(a is b for a, b in pairs):
        covered, crossed = before.covered, before.crossed
    if covered is None:
        covered = composite.opacity_at(base.seen, *where)
    if crossed is None and not last:
        crossed = composite.crossed(base.rays, *where)
    return PaintedCoat(coat, covered, crossed)


def _same(group: list[Coat], layer: PaintedLayer) -> bool:
    before = [part.coat for part in layer.parts]
    leaves = [jax.tree.leaves(coats) for coats in (group, before)]
    return len(group) == len(before) and all(a is b for a, b in zip(*leaves, strict=True))


def _groups(painting: Painting) -> list[list[Coat]]:
    """Coats from the uppermost down, those within `NEAR` of the first of a group together."""
    groups: list[list[Coat]] = []
    for coat in reversed(painting.coats):
        first = groups[-1][0].height if groups else None
        traced = isinstance(coat.height, Tracer) or isinstance(first, Tracer)
        if first is None or traced or float(first) - float(coat.height) > NEAR:
            groups.append([coat])
        else:
            groups[-1].append(coat)
    return groups
