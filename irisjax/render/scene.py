"""`Scene`: an eye, its lights and a camera."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.measure.colour import OBSERVER
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
"""Lamps that stand for an environment."""


class Scene(eqx.Module):
    """Everything a picture shows. Parts that are `None` are not computed.

    - `iris`: its tissue, `None` for a painted one, whose integrator has all there is. `maps`: of
        the iris, or `None` for a uniform one. `veins`: of the sclera
        (`grow.vessels.veins`).
    - `lights`: lamps, mirrored as discs. `environment`: lights iris and white as
        `environment_lights` lamps each (those of the white from all round), and is mirrored itself.
        `illuminant`: the spectrum of all of them.
    - `integrator`: how the iris sends light back; `Separable()` is ILIT and `RadiativeIntegrator()`
        radiative transfer, with all orders of scattering; `SingleScattering()` marches through the
        maps and holds the first.
    """

    iris: Iris | None
    maps: IrisMaps | None = None
    eye: Eye = eqx.field(default_factory=Eye)
    lights: Lights | None = eqx.field(default_factory=lambda: Lights.distant(0.6, 2.2))
    environment: Environment | None = None
    camera: Camera = eqx.field(default_factory=Camera)
    veins: VeinMap | None = None
    integrator: AbstractIntegrator = eqx.field(default_factory=Separable)
    environment_lights: int = eqx.field(static=True, default=ENVIRONMENT_LIGHTS)
    illuminant: str = eqx.field(static=True, default="D65")
    observer: str = eqx.field(static=True, default=OBSERVER)

    def __check_init__(self):
        if self.lights is None and self.environment is None:
            raise ValueError("a scene needs lights or an environment")
        if self.iris is None:
            if self.integrator.process is not None or self.maps is not None:
                raise ValueError("a scene without an iris has no maps, and an integrator of paint")
        else:
            check_pictured(self.iris)
            if self.maps is not None:
                self.maps.check(self.iris)
        if self.lights is not None and self.lights.illuminant != self.illuminant:
            raise ValueError(
                f"the lights are {self.lights.illuminant}, the scene is {self.illuminant}"
            )
        if self.lights is not None and not isinstance(self.lights.radius, Tracer):
            widest = float(np.max(np.asarray(self.lights.radius)))
            # Wider ones stand for regions of an environment, which is mirrored itself.
            if widest > np.pi / 2 + 1e-6:
                raise ValueError(
                    f"a lamp's radius = {widest:g} is above pi/2 radians; give an environment "
                    f"instead"
                )

    @property
    def tissue(self) -> Iris:
        """The iris, where it is of tissue.

        **Raises:** `ValueError` where it is painted.
        """
        if self.iris is None:
            raise ValueError("the iris is painted: it has no tissue and no pigments")
        return self.iris

    def replace(self, **parts: Any) -> "Scene":
        """A copy with some parts changed."""
        return dataclasses.replace(self, **parts)

    def render(
        self, tables: Illumination | None = None, *, caustics: bool | None = None
    ) -> Float[Array, "height width 3"]:
        """See `compose.render`."""
        from irisjax.render.compose import render

        return render(self, tables, caustics=caustics)

    def tables(self, caustics: bool | None = None) -> Illumination | None:
        """Illumination tables of this eye, `None` without a cornea.

        `caustics`: whether light may stand so low that the cornea folds it (beyond 80°); by default
        as the lights stand, and with caustics where they are traced.
        """
        if self.eye.cornea is None:
            return None
        caustics = self.grazing() if caustics is None else caustics
        return Illumination.build(self.eye, caustics=caustics)

    def grazing(self) -> bool:
        """Whether a light stands, or for all that is known may stand, so low that the cornea folds
        it into caustics.
        """
        if any(isinstance(x, Tracer) for x in jax.tree.leaves((self.lights, self.environment))):
            return True
        return bool((np.asarray(self.all_lights().polar()) > UNIQUE_POLAR).any())

    def all_lights(self, largest_polar: float | None = LARGEST_POLAR) -> Lights:
        """Lamps and what stands for the environment, up to a polar angle (radians), `None` for all
        round.
        """
        return all_lights(
            self.lights, self.environment, self.environment_lights, self.illuminant, largest_polar
        )


def all_lights(
    lights: Lights | None,
    environment: Environment | None,
    count: int,
    illuminant: str,
    largest_polar: float | None = LARGEST_POLAR,
) -> Lights:
    """Lamps and at most `count` that stand for an environment."""
    if environment is None:
        assert lights is not None
        return lights
    around = dataclasses.replace(
        environment.to_lights(count, largest_polar=largest_polar), illuminant=illuminant
    )
    return around if lights is None else lights + around
