"""What a scene asks of an integrator: how the iris sends back the light that reaches it."""

import abc
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.steps import Once, simply
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import RESULTS


class AbstractResponse(eqx.Module):
    """An iris of given pigments, ready to shade pixels.

    - `error`: of a table, relative to the brightest texel; `None` where nothing is tabulated.
    - `status`: of the solver, `None` where nothing can fail.
    """

    error: eqx.AbstractVar[Float[Array, ""] | None]
    status: eqx.AbstractVar[RESULTS | None]

    @abc.abstractmethod
    def shade(self, texels: Any, ground: Any) -> Float[Array, "channels pixels"]:
        """Radiance of pixels in the channels of the picture; `texels` and `ground` from
        `AbstractIntegrator.place`.
        """


class AbstractIntegrator(eqx.Module):
    """An integrator is an immutable value: a method and its settings, the `process` of light in
    tissue among them; `None` where there is no tissue, but paint.
    """

    process: eqx.AbstractVar[AbstractProcess | None]

    def prepare(
        self, iris: Any, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "AbstractIntegrator":
        """The integrator with all fixed that must be known before tracing."""
        del iris, aqueous_index, bands, ranges
        return self

    @abc.abstractmethod
    def place(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        tables: Illumination | None,
        ranges: Scales,
        once: Once = simply,
    ) -> tuple[Any, Any]:
        """Everything that a change of pigments leaves alone: of each pixel, and what all of them
        share.

        The first is a module of arrays whose last axis is that of the pixels, `index` among them:
        it is shaded a chunk of pixels at a time. `tables` are `None` for a bare iris; `ranges` are
        those of the response; `once` does the steps (`steps.simply`).
        """

    @abc.abstractmethod
    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> AbstractResponse:
        """The iris behind a chamber for the channels of `bands`; `ranges` of its texels from
        `Scales.ranges`.
        """
