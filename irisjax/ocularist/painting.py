"""A painting and its scene from a recipe: opacity maps are drawn and paints mixed."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.grow.vessels import veins
from irisjax.numerics.checks import check_known, is_known
from irisjax.numerics.streams import key_of
from irisjax.ocularist.coats import Coat, Painting, profile_of
from irisjax.ocularist.components import component, scan
from irisjax.ocularist.integrator import Painted
from irisjax.ocularist.mixing import AbstractMixer
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights
from irisjax.render.scene import Scene

SCAN = "scan"
"""Component of a coat whose opacity is the user's picture, `parameters["file"]`."""
OPACITY_SIZE = 512
"""Texels along a side of opacity maps."""

_FILE = "file"  # the only parameter of a scan
# Lamps that represent an environment; each has shadows of every coat. For a blue eye of 50 coats
# 16 differ from 64 by 0.6 levels of 255 in the mean in the studio, and by 1.1 under the sky.
_ENVIRONMENT_LIGHTS = 16


def painted(
    recipes: Sequence[CoatRecipe],
    mixer: AbstractMixer,
    eye: Eye,
    *,
    size: int = OPACITY_SIZE,
    scans: Mapping[str, np.ndarray] | None = None,
) -> Painting:
    """Paint the coats of a recipe on an eye's plane or cone, sorted by height.

    Args:
        recipes: The coats; those of equal height in their order, the bottom one first.
        mixer: Mixer of their paints.
        eye: Eye whose iris is painted.
        size: Texels along a side of opacity maps.
        scans: Pictures by the name of their file, for coats of the component `SCAN`.

    Raises:
        ValueError: naming the coat, for what cannot be painted.
    """
    coats, dtype = [], jnp.result_type(float)
    for number, recipe in enumerate(recipes, 1):
        name = f"{number:02d} {recipe.component}"
        try:
            opacity = _opacity(recipe, eye, size, scans or {})
            colour = mixer.mix(recipe.first, recipe.second, recipe.share)
            values = recipe.opacity * opacity, colour, recipe.height
            coats.append(Coat(name, *(jnp.asarray(v, dtype) for v in values)))
        except ValueError as error:
            raise ValueError(f"coat {number} ({recipe.component}): {error}") from None
    coats.sort(key=lambda coat: float(coat.height))  # stable: equal heights keep their order
    return Painting(tuple(coats), profile_of(eye))


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
    return made.opacity(size, pupil, key=key_of(recipe.seed))


def studio(painting: Painting, eye: Eye, *, seed: int = 0, **parts: Any) -> Scene:
    """A scene of a painted eye in the light of two lamps, with vessels on its white.

    Args:
        painting: Painting of the eye's iris.
        eye: The eye.
        seed: Seed of the vessels.
        parts: Fields of the `Scene` in place of the defaults; an environment is represented by 16
            lamps.

    Raises:
        ValueError: For a painting that was made for another pupil or root than the eye's.
    """
    made, asked = painting.profile.radius, profile_of(eye).radius
    ends = np.array([0, -1])
    if is_known(made, asked) and not np.allclose(made[ends], asked, rtol=0, atol=1e-4):
        raise ValueError(
            f"the painting is for an iris of {float(made[0]):g} to {float(made[-1]):g} mm and the "
            f"eye's is of {float(asked[0]):g} to {float(asked[-1]):g} mm; paint it for this eye"
        )
    usual: dict[str, Any] = {
        "lights": Lights.distant(0.6, 2.2, 2.4) + Lights.distant(0.5, -0.6, 0.9),
        "camera": Camera(width=jnp.asarray(16.5), size=(800, 600)),
        "integrator": Painted(painting=painting),
        "environment_lights": _ENVIRONMENT_LIGHTS,
    }
    if eye.sclera is not None:
        usual["veins"] = veins(eye, key=key_of(seed))
    return Scene(None, eye=eye, **(usual | parts))
