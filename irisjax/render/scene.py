"""`Scene`: an eye, its lights and a camera."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.lids import SEEN_FROM
from irisjax.anatomy.sclera import VeinMap
from irisjax.measure.colour import OBSERVER
from irisjax.measure.measurement import check_wavelengths
from irisjax.numerics.checks import is_known
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import UNIQUE_POLAR, Illumination
from irisjax.render.integrator import AbstractIntegrator
from irisjax.render.lights import Lights
from irisjax.render.refraction import LARGEST_POLAR
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, check_pictured

ENVIRONMENT_LIGHTS = 25
"""Number of lamps that approximate an environment."""
LAMP = 0.6, 2.2
"""Polar angle and azimuth, radians, of the lamp of a scene that has no other light."""


def _as_wavelengths(wavelengths: Iterable[Any] | None) -> tuple[float, ...] | None:
    """Return wavelengths as numbers that a static field can hold."""
    if wavelengths is None:
        return None
    numbers = tuple(float(w) for w in wavelengths)
    check_wavelengths(np.asarray(numbers))
    return numbers


class Scene(eqx.Module):
    """Everything that a picture shows. Parts that are `None` are not computed.

    Attributes:
        iris: Tissue of the iris; `None` for a painted one, whose integrator holds its paint.
        maps: Maps of the iris; `None` for a uniform one.
        eye: The eye.
        lights: Lamps, mirrored as discs.
        environment: Light from all directions. `environment_lights` lamps approximate it on the
            iris, and as many on the sclera; the tear film mirrors the environment itself.
        camera: The camera.
        veins: Vessels of the sclera (`grow.vessels.veins`).
        integrator: Method for the radiance of the iris. `Separable()` is ILIT,
            `RadiativeIntegrator()` radiative transfer, both with all orders of scattering;
            `SingleScattering()` marches rays through the maps, with the first order alone.
        environment_lights: Largest number of lamps that approximate the environment.
        illuminant: Spectrum of all lights.
        observer: Standard observer of the colours.
        wavelengths: Wavelengths, nm, each a channel of the picture in place of linear sRGB: its
            radiance, 1/sr times π, under the illuminant scaled to 1 at 560 nm.

    Raises:
        ValueError: No light at all; maps without tissue, or tissue without a process; lights of
            two spectra; a lamp wider than a half space; lids seen from too far aside; wavelengths
            and a light that has a colour but no spectrum.
    """

    iris: Iris | None
    maps: IrisMaps | None = None
    eye: Eye = eqx.field(default_factory=Eye)
    lights: Lights | None = eqx.field(default_factory=lambda: Lights.distant(*LAMP))
    environment: Environment | None = None
    camera: Camera = eqx.field(default_factory=Camera)
    veins: VeinMap | None = None
    integrator: AbstractIntegrator = eqx.field(default_factory=Separable)
    environment_lights: int = eqx.field(static=True, default=ENVIRONMENT_LIGHTS)
    illuminant: str = eqx.field(static=True, default="D65")
    observer: str = eqx.field(static=True, default=OBSERVER)
    wavelengths: tuple[float, ...] | None = eqx.field(
        static=True, default=None, converter=_as_wavelengths
    )

    def __check_init__(self) -> None:
        if not (self.lights or self.environment is not None):
            raise ValueError("a scene needs lights or an environment")
        if self.iris is None:
            if self.integrator.process is not None or self.maps is not None:
                raise ValueError("a scene without an iris has no maps, and an integrator of paint")
        else:
            check_pictured(self.iris)
            if self.maps is not None:
                self.maps.check(self.iris)
        lights = self.lights
        if lights is not None and lights.illuminant != self.illuminant:
            raise ValueError(f"the lights are {lights.illuminant}, the scene is {self.illuminant}")
        polar = self.camera.polar
        if self.eye.lids is not None and is_known(polar) and float(polar) > SEEN_FROM + 1e-6:
            raise ValueError(
                f"the camera is {np.degrees(float(polar)):.3g}° off the axis; lids are drawn up to "
                f"{np.degrees(SEEN_FROM):.0f}°: move it, or leave the lids out"
            )
        if self.wavelengths is not None:
            if self.maps is not None and self.maps.residual is not None:
                raise ValueError(
                    "spectral pictures need maps without a residual, which has colours and no "
                    "spectrum (--no-residual)"
                )
            if self.environment is not None or (lights is not None and lights.tint is not None):
                raise ValueError(
                    "spectral pictures need plain lamps: environments and tints have colours, not "
                    "spectra"
                )
        if lights and is_known(lights.radius):
            widest = float(np.max(np.asarray(lights.radius)))
            # Wider lights approximate regions of an environment, which is mirrored itself.
            if widest > np.pi / 2 + 1e-6:
                raise ValueError(
                    f"a lamp's radius = {widest:g} is above pi/2 radians; give an environment "
                    f"instead"
                )

    @property
    def tissue(self) -> Iris:
        """The iris, where it is of tissue.

        Raises:
            ValueError: The iris is painted.
        """
        if self.iris is None:
            raise ValueError("the iris is painted: it has no tissue and no pigments")
        return self.iris

    def replace(self, **parts: object) -> "Scene":
        """Return a copy with some fields changed."""
        return dataclasses.replace(self, **parts)

    def with_pupil(self, radius: float) -> "Scene":
        """Return the scene with a pupil of another radius, mm, whose tissue has moved
        (`IrisMaps.moved`).
        """
        eye = self.eye.replace(pupil_radius=radius)
        maps = None if self.maps is None else self.maps.moved(self.eye, eye)
        return self.replace(eye=eye, maps=maps)

    def tables(self, caustics: bool | None = None) -> Illumination | None:
        """Compute the illumination tables of this eye; `None` without a cornea.

        Args:
            caustics: Whether to include grazing light (beyond 80°), which the cornea folds into
                caustics; `None` for `grazing()`.
        """
        if self.eye.cornea is None:
            return None
        caustics = self.grazing() if caustics is None else caustics
        return Illumination.build(self.eye, caustics=caustics)

    def grazing(self) -> bool:
        """Return whether a light is so oblique that the cornea folds it into caustics; true where
        JAX traces the lights.
        """
        if not is_known(self.lights, self.environment):
            return True
        with jax.ensure_compile_time_eval():  # a scene may be drawn inside a program
            return bool((np.asarray(self.all_lights().polar()) > UNIQUE_POLAR).any())

    def all_lights(self, largest_polar: float | None = LARGEST_POLAR) -> Lights:
        """Return the lamps, and those that approximate the environment up to a polar angle
        (radians; `None` for all directions).
        """
        if self.environment is None:
            assert self.lights is not None
            return self.lights
        settings = {"largest_polar": largest_polar, "illuminant": self.illuminant}
        around = self.environment.to_lights(self.environment_lights, **settings)
        return around if self.lights is None else self.lights + around
