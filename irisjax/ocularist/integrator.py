"""A painted iris in a scene: coats of paint in place of tissue, from the uppermost down  [L03
Section 3.3].
"""

import equinox as eqx
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.ocularist import composite
from irisjax.ocularist.coats import Coat, Painting
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import fluxes_of
from irisjax.render.steps import Once, simply
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

    def place(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris | None,
        maps: IrisMaps | None,
        tables: Illumination | None,
        ranges: Scales,
        once: Once = simply,
    ) -> tuple["Texels", None]:
        """See `AbstractIntegrator`. With a memory for `once`, a coat that changes is done anew with
        those below it, whose light it tints, and no other.
        """
        profile, reach = self.painting.profile, eye.iris_radius
        flux = once("fluxes", fluxes_of, lights, eye, tables)
        seen = once("painted ground", composite.ground, pixels, profile, eye, flux)
        rays = once("rays to paint", composite.rays, flux, profile, reach)
        shape = len(lights), composite.SHADOW, composite.SHADOW, composite.CHANNELS
        light = once("light on paint", composite.full_light, flux, shape)
        state = once("bare ground", composite.nothing, seen)
        groups = _groups(self.painting)
        for nth, group in enumerate(groups):
            height, colours = group[0].height, tuple(coat.colour for coat in group)
            rim = profile, reach, eye.pupil_margin
            wheres = [(coat.opacity, coat.height, *rim) for coat in group]
            names = [coat.name for coat in group]
            covered = tuple(
                once(f"opacity of {name}", composite.opacity_at, seen, *where)
                for name, where in zip(names, wheres, strict=True)
            )
            known = state, covered, seen
            more = colours, height, lights.tint, reach, self.as_printed
            state = once(f"paint of group {nth}", composite.paint_over, known, light, *more)
            if group is groups[-1]:
                break
            crossed = tuple(
                once(f"shadow of {name}", composite.crossed, rays, *where)
                for name, where in zip(names, wheres, strict=True)
            )
            known = crossed, colours, self.as_printed
            light = once(f"light under group {nth}", composite.light_under, light, *known)
        return Texels(pixels.index, state.radiance), None

    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "PaintedResponse":
        """Of a picture in linear sRGB: colours of paints are no spectra.

        **Raises:** `ValueError` for a picture of other channels.
        """
        if bands.channels != ("R", "G", "B"):
            raise ValueError("a painted iris has colours, not spectra: ask for no wavelengths")
        return PaintedResponse(white=bands.white)


class Texels(eqx.Module):
    """Of each pixel the radiance in white light, (channels, pixels)."""

    index: Int[Array, " pixels"] | None
    radiance: Float[Array, "3 pixels"]


class PaintedResponse(AbstractResponse):
    """`white`: what a white sheet shows behind the cornea, in the picture's channels."""

    white: Float[Array, "3"]
    error: None = None
    status: None = None

    def shade(self, texels: Texels, ground: None) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        del ground
        return self.white[:, None] * texels.radiance


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
