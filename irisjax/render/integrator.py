"""The interface of integrators: how the iris sends back the light that reaches it."""

import abc
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, IrisModel
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import RESULTS, raise_failure


class AbstractResponse(eqx.Module):
    """How an iris of given pigments sends light back.

    Attributes:
        error: Error of a tabulated response, relative to the brightest texel; `None` of others.
        status: Status of the solver; `None` where nothing can fail.
    """

    error: eqx.AbstractVar[Float[Array, ""] | None]
    status: eqx.AbstractVar[RESULTS | None]

    @abc.abstractmethod
    def shade(self, pixels: IrisPixels, texels: Any, light: Any) -> Float[Array, "channels pixels"]:
        """Compute the radiance of pixels in the channels of the picture from the results of
        `AbstractIntegrator.texels` and `AbstractIntegrator.illuminate`.
        """


class AbstractIntegrator(eqx.Module):
    """A method of computing the iris's radiance, with its settings; an immutable value.

    Attributes:
        pixels_apart: Whether `illuminate` treats each pixel by itself, so that shares of them can
            be drawn apart from one another.
    """

    pixels_apart: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def process(self) -> AbstractProcess | None:
        """Process of light in tissue; `None` for a painted iris."""

    def prepare(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "AbstractIntegrator":
        """Fix the settings that depend on concrete numbers, before the integrator is traced."""
        del iris, aqueous_index, bands, ranges
        return self

    def texels(self, pixels: IrisPixels, model: IrisModel, ranges: Scales) -> Any:
        """Look up the iris's maps at each pixel, which depends neither on light nor on pigments.
        `ranges` are those of the response.
        """
        del pixels, model, ranges

    def lit(self, model: IrisModel, lights: Lights, tables: Illumination | None) -> IrisModel:
        """Compute once for many views what `illuminate` needs of the lights whatever the pixels."""
        del lights, tables
        return model

    @abc.abstractmethod
    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        model: IrisModel,
        tables: Illumination | None,
        facing: Facing | None,
    ) -> Any:
        """Compute the light at each pixel in the form that the response needs, whatever the
        pigments. `tables` is `None` for an iris without a cornea; `facing` is
        `IrisModel.facing`.
        """

    @abc.abstractmethod
    def response(
        self, iris: Iris | None, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> AbstractResponse:
        """Compute the response of the iris behind a chamber in the channels of `bands`, for texels
        within `ranges` (`Scales.ranges`).
        """


def solve_response(integrator: AbstractIntegrator, *parts: Any) -> AbstractResponse:
    """Compute `AbstractIntegrator.response` in one compiled program.

    Raises:
        ValueError: The layers of a texel are outside the range of the integrator's solver.
    """
    response = _compiled_response(integrator, *parts)
    return response if response.status is None else raise_failure(response, response.status)


@eqx.filter_jit
def _compiled_response(integrator: AbstractIntegrator, *parts: Any) -> AbstractResponse:
    return integrator.response(*parts)
