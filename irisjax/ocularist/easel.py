"""From a recipe to a painting: maps drawn, paints mixed, the scene to look at it."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.grow.vessels import veins
from irisjax.numerics.checks import check_known
from irisjax.ocularist.coats import Coat, Painting, profile_of
from irisjax.ocularist.components import component
from irisjax.ocularist.cones import Cones
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.mixing import AbstractMixer
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.ocularist.scans import scan
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.scene import Scene

SCAN = "scan"
"""Component of a coat whose opacity is a picture of the user's, `parameters["file"]`."""
_FILE = "file"  # its only parameter
SIZE = 512
"""Texels along a side of opacity maps."""

ENVIRONMENT_LIGHTS = 16
"""Lamps that stand for an environment: each has shadows of every coat. Of a blue eye of 50 coats
they leave 0.6 levels of 255 in the mean to 64 lamps in the studio, and 1.1 under the sky.
"""


def painted(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    *,
    size: int = SIZE,
    scans: Mapping[str, np.ndarray] | None = None,
    profile: Cones | None = None,
) -> Painting:
    """Paint the coats of a recipe; those that lie higher come later, whatever their order.

    Args:
        recipes: The coats; those of equal height in their order, the bottom one first.
        mixer: Of their paints.
        eye: Whose iris is painted.
        size: Texels along a side of opacity maps.
        scans: Pictures by the name of their file, for coats of the component `SCAN`.
        profile: Cross-section of the base; by default the eye's plane or cone.

    Raises:
        ValueError: naming the coat, for what cannot be painted.
    """
    coats = []
    for number, recipe in enumerate(recipes, 1):
        name = f"{number:02d} {recipe.component}"
        try:
            opacity = _opacity(recipe, eye, size, scans or {})
            colour = mixer.mix(recipe.first, recipe.second, recipe.share)
            coats.append(_coat(name, recipe.opacity * opacity, colour, recipe.height))
        except ValueError as error:
            raise ValueError(f"coat {number} ({recipe.component}): {error}") from None
    coats.sort(key=lambda coat: float(coat.height))  # stable: equal heights keep their order
    return Painting(tuple(coats), profile_of(eye) if profile is None else profile)


def _coat(name: str, opacity, colour, height) -> Coat:
    dtype = jnp.result_type(float)
    return Coat(name, *(jnp.asarray(v, dtype) for v in (opacity, colour, height)))


def _opacity(recipe: CoatRecipe, eye: Eye, size: int, scans: Mapping[str, np.ndarray]):
    if recipe.component == SCAN:
        for given in recipe.parameters:
            check_known(f"parameter of {SCAN}", given, (_FILE,))
        file = recipe.parameters.get(_FILE)
        if not isinstance(file, str) or not file:
            got = "" if file is None else f", got {file!r}"
            raise ValueError(f'a scan needs its picture, parameters = {{ file = "coat.png" }}{got}')
        if file not in scans:
            raise ValueError(f"no picture of {file!r} among the scans")
        return scan(scans[file], size)
    pupil = float(eye.pupil_radius / eye.iris_radius)
    made = component(recipe.component, recipe.parameters)
    return made.opacity(size, pupil, key=jax.random.key(recipe.seed))


def studio(painting: Painting, eye: Eye, *, seed: int = 0, **parts: Any) -> Scene:
    """A scene of a painted eye in the light of two lamps, vessels on its white.

    `seed`: of the vessels. `parts`: of the `Scene`, in place of these; an environment is
    `ENVIRONMENT_LIGHTS` lamps.
    """
    usual: dict[str, Any] = {
        "lights": Lights.distant(0.6, 2.2, 2.4) + Lights.distant(0.5, -0.6, 0.9),
        "camera": Camera(width=jnp.asarray(16.5), size=(800, 600)),
        "integrator": Painted(painting=painting),
        "environment_lights": ENVIRONMENT_LIGHTS,
    }
    if eye.sclera is not None:
        usual["veins"] = veins(eye, key=jax.random.key(seed))
    return Scene(None, eye=eye, **(usual | parts))
