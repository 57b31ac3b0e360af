"""Virtual instruments with a polariser before the lamp and an analyser before the eye.

Angles of polarisation are those of a filter before a camera that looks at the iris: 0 lies in the
plane of incidence. A lens collects oblique directions: it turns the field along the polar angle
into one along the radius in its plane.
"""

from typing import Any, Literal, Unpack, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Numbers, Scalar, Spectrum
from irisjax.measure.instrument import AbstractInstrument, InstrumentSettings
from irisjax.measure.measurement import HEMISPHERE, Reading, check_cosine
from irisjax.numerics.angle import arctan2
from irisjax.numerics.checks import Range, check_known, check_number
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.mueller import polarised_at, rotation
from irisjax.transport.light import Directions
from irisjax.transport.solution import Polarisation, Solution

_ANGLE = Range(-2 * np.pi, 2 * np.pi, "rad")
AnalyserSetting = Literal["crossed", "parallel"]


class PolarisedInstrument(AbstractInstrument):
    """An instrument that sees polarisation, of a process that has it; the cornea is left out.

    Light mirrored by the first surface counts only with a hemisphere of exits.

    Attributes:
        polariser: Angle (radians) of the light's polarisation, or `None` for unpolarised light.
        cos_exit: Cosine of the exit angle, or `None` for all exits, given as `"hemisphere"`.
        azimuth: Azimuth of the exit from the plane of incidence, radians; 0 is where a mirror would
            send the light.
    """

    polarised = True

    polariser: Scalar | None
    cos_exit: Scalar | None
    azimuth: Scalar

    def __init__(
        self,
        wavelengths: Numbers,
        *,
        polariser: Numbers = None,
        cos_exit: Numbers = 1.0,
        azimuth: Numbers = 0.0,
        **settings: Unpack[InstrumentSettings],
    ):
        if isinstance(settings.get("cos_incidence"), str):
            message = "cos_incidence must be a number in [0, 1]"
            raise ValueError(f"polarised light comes from one direction: {message}")
        super().__init__(wavelengths, **settings)
        if self.cornea != "none":
            raise ValueError(f"polarised light is that on the bare iris: cornea = {self.cornea!r}")
        everywhere = isinstance(cos_exit, str)
        if everywhere and cos_exit != HEMISPHERE:
            raise ValueError(f"cos_exit must be a number in [0, 1] or {HEMISPHERE!r}")
        if not everywhere:
            check_cosine("cos_exit", cos_exit)
        for name, angle in (("polariser", polariser), ("azimuth", azimuth)):
            check_number(name, angle, _ANGLE)
        dtype = self.wavelengths.dtype
        self.polariser = None if polariser is None else jnp.asarray(polariser, dtype)
        self.cos_exit = None if everywhere else jnp.asarray(cos_exit, dtype)
        self.azimuth = jnp.asarray(azimuth, dtype)

    @property
    def exits(self) -> Directions | None:
        return None if self.cos_exit is None else Directions(self.cos_exit, self.azimuth)

    def light(self) -> Float[Array, "4"]:
        """Stokes vector of the light on the iris, of intensity 1."""
        if self.polariser is None:
            return jnp.asarray([1.0, 0, 0, 0], self.wavelengths.dtype)
        # The polar angle's axis of light on its way down points back at the lamp's side.
        return polarised_at(-self.polariser)

    def filtered(self, angle: Scalar) -> Float[Array, "4"]:
        """Weights of a Stokes vector whose sum an analyser at `angle` passes."""
        turned = angle if self.cos_exit is None else angle - self.azimuth
        return 0.5 * polarised_at(turned)

    def matrix(self, solution: Solution) -> Float[Array, "n 4 4"]:
        """Mueller matrix of reflectance factors at n wavelengths."""
        result = solution.polarisation
        assert isinstance(result, Polarisation)
        if self.cos_exit is None:
            return result.reflected + result.mirrored if self.first_surface else result.reflected
        assert result.brdf is not None
        return jnp.pi * result.brdf[:, 0]


class Analyser(PolarisedInstrument):
    """An instrument that reads the share of linearly polarised light that passes an analyser.

    Into one direction the reading is a reflectance factor, π L/E: 1 for a white diffuser that keeps
    the polarisation, ½ through either analyser for one that does not. The readings of both settings
    add up to the reflectance.

    Attributes:
        setting: Whether the analyser is `"crossed"` with the polariser or `"parallel"` to it.
    """

    setting: AnalyserSetting = eqx.field(static=True)

    def __init__(
        self,
        wavelengths: Numbers,
        setting: AnalyserSetting = "crossed",
        *,
        polariser: Numbers = 0.0,
        **settings: Any,
    ):
        check_known("setting", setting, get_args(AnalyserSetting))
        if polariser is None:
            raise ValueError("an analyser needs a polariser: give its angle")
        super().__init__(wavelengths, polariser=polariser, **settings)
        self.setting = setting

    def reading(self, solution: Solution, factor: Scalar) -> Reading:
        assert self.polariser is not None
        crossed = self.setting == "crossed"
        passed = self.filtered(self.polariser + (jnp.pi / 2 if crossed else 0.0))
        values = factor * self.gain * (self.matrix(solution) @ self.light() @ passed)
        name = f"{'cross' if crossed else 'co'}-polarised reflectance"
        name = name if self.cos_exit is None else f"{name} factor"
        return self.result(solution, factor, values, None, quantity=name, unit="")


class PolarisedReading(Reading):
    """A `Reading` of the degree of linear polarisation, from 0 to 1.

    Attributes:
        angle: Angle of the polarisation, radians in (−π/2, π/2], shape (wavelengths,).
        stokes: Reflectance factors I, Q, U, V, shape (wavelengths, 4); Q is the intensity at 0°
            less that at 90°, U that at 45° less that at 135°.
    """

    angle: Spectrum
    stokes: Float[Array, "wavelengths 4"]


class Polarimeter(PolarisedInstrument):
    """An instrument that reads the degree and the angle of linear polarisation.

    The incident light is unpolarised or, with a `polariser`, linearly polarised.
    """

    def __init__(self, wavelengths: Numbers, **settings: Any):
        super().__init__(wavelengths, **settings)

    def reading(self, solution: Solution, factor: Scalar) -> PolarisedReading:
        turn = rotation(jnp.zeros_like(self.azimuth) if self.cos_exit is None else -self.azimuth)
        stokes = self.matrix(solution) @ self.light() @ turn.T
        intensity = jnp.where(stokes[:, 0] <= 0, 1.0, stokes[:, 0])
        linear = safe_sqrt(stokes[:, 1] ** 2 + stokes[:, 2] ** 2)
        return self.result(
            solution, factor, linear / intensity, None, PolarisedReading,
            quantity="degree of linear polarisation", unit="",
            angle=0.5 * arctan2(stokes[:, 2], stokes[:, 1]), stokes=factor * self.gain * stokes,
        )  # fmt: skip
