"""What a scene requires of an integrator: how the iris sends back the light that reaches it."""

import abc
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, Front
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import RESULTS, raise_failure


class AbstractResponse(eqx.Module):
    """An iris of given pigments, ready to shade pixels.

    Attributes:
        error: Error of a table, relative to the brightest texel; `None` where nothing is
            tabulated.
        status: Status of the solver; `None` where nothing can fail.
    """

    error: eqx.AbstractVar[Float[Array, ""] | None]
    status: eqx.AbstractVar[RESULTS | None]

    @abc.abstractmethod
    def shade(self, pixels: IrisPixels, texels: Any, light: Any) -> Float[Array, "channels pixels"]:
        """Radiance of pixels in the channels of the picture, from `AbstractIntegrator.texels` and
        `AbstractIntegrator.illuminate`.
        """


class AbstractIntegrator(eqx.Module):
    """An integrator is an immutable value: a method and its settings."""

    @property
    @abc.abstractmethod
    def process(self) -> AbstractProcess | None:
        """Process of light in tissue; `None` where there is no tissue, but paint."""

    def prepare(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "AbstractIntegrator":
        """Fix everything that must be known before tracing."""
        del iris, aqueous_index, bands, ranges
        return self

    def texels(self, pixels: IrisPixels, front: Front, ranges: Scales) -> Any:
        """Look up what the iris is made of at each pixel; nothing of it depends on light or on
        pigments. `ranges` are those of the response.
        """
        del pixels, front, ranges

    @abc.abstractmethod
    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        front: Front,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> Any:
        """Compute the light that the response needs at each pixel; nothing of it depends on
        pigments. `tables` are `None` for a bare iris, `facing` is that of `Front`.
        """

    @abc.abstractmethod
    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> AbstractResponse:
        """Compute how the iris behind a chamber sends light back, for the channels of `bands` and
        texels within `ranges` (`Scales.ranges`).
        """


def checked_response(integrator: AbstractIntegrator, *parts: Any) -> AbstractResponse:
    """Compute `AbstractIntegrator.response` of its arguments in one compiled program.

    Raises:
        ValueError: The integrator's solver does not hold the layers of a texel.
    """
    found = _response(integrator, *parts)
    return found if found.status is None else raise_failure(found, found.status)


@eqx.filter_jit
def _response(integrator: AbstractIntegrator, *parts: Any) -> AbstractResponse:
    return integrator.response(*parts)
