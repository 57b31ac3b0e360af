"""`Clone`: what was found of a photographed eye, and what it was asked with."""

from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from irisjax.photo.boundaries import Boundaries
from irisjax.photo.concentrations import iris_of
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.lamps import Lighting
from irisjax.photo.morphology import Morphology
from irisjax.photo.photograph import Photograph
from irisjax.photo.pigments import Fit
from irisjax.photo.pose import Pose
from irisjax.photo.posterior import PigmentPosterior
from irisjax.photo.refraction import Refraction
from irisjax.photo.register import Registration
from irisjax.photo.unrefracted import Unrefracted
from irisjax.photo.windows import Windows
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import View
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps


class Settings(NamedTuple):
    """What a clone is made with.

    - `media`: `"f09"` gives cornea and chamber one index, 1.376 [F09 Section 4.1.1].
    - `iris_depth`: behind the corneal apex, mm. `focal_px`: in place of the photograph's own.
    - `azimuth`: of the camera (radians), where it is known to which side the eye is tilted.
    - `sigma`: of the deconvolution, mm, `None` takes the one with which the rendering is nearest to
        the photograph; `beta`: of Eq. 7 (mm), `None` asks the model instead how
        much brighter a thicker stroma is.
    - `relief`: share of the stroma's unevenness that stands out towards the cornea, 0 to 1: its
        shading is taken off the picture before the model tells thickness, and the clone has it.
    - `method`: least squares, or the paper's simplex. `integrator`: of light in the iris.
    - `steps`: most steps of the posterior's chain. `seed`: of all random numbers.
    """

    media: str = "cornea-aqueous"
    iris_depth: float = 3.6
    focal_px: float | None = None
    azimuth: float | None = None
    sigma: float | None = 0.5
    beta: float | None = None
    relief: float = 0.0
    method: str = "least-squares"
    integrator: Separable | RadiativeIntegrator = Separable()
    steps: int = 8000
    seed: int = 0


class Given(NamedTuple):
    """What the user gives in place of what a stage would find; `None` leaves it to the stage.

    - `freckles`: mask of texels; `visible`: of texels that show the iris, in place of what finds
        lids, lashes and highlights.
    - `maps`: with the stroma's thickness, which is then kept.
    - `second`: a photograph of the same eye, for example through crossed polarisers, whose texture
        tells the thickness in place of the first's; pigments and light are told from the first.
    """

    limbus: Ellipse | None = None
    pupil: Ellipse | None = None
    lights: Lights | None = None
    environment: Environment | None = None
    freckles: Bool[np.ndarray, "size size"] | None = None
    visible: Bool[np.ndarray, "size size"] | None = None
    maps: IrisMaps | None = None
    second: Photograph | None = None


class Second(NamedTuple):
    """A second photograph on the pixels of the first's part: `part` and `clear` as of `Clone`."""

    registration: Registration
    part: Float[np.ndarray, "rows columns 3"]
    clear: Bool[np.ndarray, "rows columns"]


NOTHING = Given()
"""Every stage finds what it finds."""


class Clone(NamedTuple):
    """All that was found; stages that did not run leave `None`.

    - `boundaries`: outlines in pixels of the photograph, with confidences.
    - `pose`: in pixels of the part that is used, `part`, (rows, columns, 3) linear; one of its
        pixels is `reduction` of the photograph's along each side, and `corner` the first of these.
    - `clear`: pixels of the part that show the iris and nothing else; `lids`: whether lids hide
        some of it. `second`: a second photograph.
    - `refraction`: where the texels of `texture` appear in the part.
    - `response`: d ln luminance / d ln thickness by which the thickness was told; `None` where
        Eq. 7 did.
    - `view`: what the camera sees of the eye, and `tables` of light on its iris.
    - `exposure`: of the three channels, with which a picture of the clone is as bright as the
        photograph. The posterior's is that of an iris with an average relief.
    """

    photograph: Photograph
    boundaries: Boundaries
    pose: Pose | None = None
    part: Float[np.ndarray, "rows columns 3"] | None = None
    clear: Bool[np.ndarray, "rows columns"] | None = None
    lids: bool = False
    second: Second | None = None
    reduction: int = 1
    corner: tuple[int, int] = (0, 0)
    refraction: Refraction | None = None
    texture: Unrefracted | None = None
    morphology: Morphology | None = None
    view: View | None = None
    lighting: Lighting | None = None
    tables: Illumination | None = None
    windows: Windows | None = None
    base: Iris | None = None
    integrator: Separable | RadiativeIntegrator = Separable()
    response: float | None = None
    fit: Fit | None = None
    exposure: Float[np.ndarray, "3"] | None = None
    posterior: PigmentPosterior | None = None

    def iris(self) -> Iris:
        """The iris of the fitted pigments. **Raises:** `ValueError` before they are known."""
        values = needed(self.fit).values
        return iris_of({k: jnp.asarray(v) for k, v in values.items()}, needed(self.base))

    def scene(self) -> Scene:
        """The eye as it was photographed: the same camera, light and pigments.

        **Raises:** `ValueError` before the pigments are known.
        """
        iris, pose, light = self.iris(), needed(self.pose), needed(self.lighting)
        around = light.environment
        if light.room:
            around = Environment.uniform(needed(self.fit).values["room"])
        return Scene(
            iris,
            needed(self.morphology).maps,
            eye=pose.eye,
            lights=light.lamps,
            environment=around,
            camera=pose.camera,
            integrator=self.integrator,
        )


T = TypeVar("T")


def needed(part: T | None) -> T:
    """What an earlier stage found."""
    if part is None:
        raise ValueError("an earlier stage has not run")
    return part
