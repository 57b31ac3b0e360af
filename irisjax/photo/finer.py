"""Thickness once more, by what the model of the fitted pigments makes of it."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from irisjax.photo.cloned import Clone, Settings, needed
from irisjax.photo.concentrations import iris_of
from irisjax.photo.doubts import misfits
from irisjax.photo.lamps import shade_on, tangent_of
from irisjax.photo.morphology import Darkness, maps_of
from irisjax.photo.pigments import NAMES, values_of
from irisjax.photo.polar import to_polar
from irisjax.photo.thickness import generic_thickness
from irisjax.tissue.iris import Iris


def with_finer_thickness(found: Clone, settings: Settings) -> Clone:
    """With the thickness that the model tells from the texture."""
    pose, texture = needed(found.pose), needed(found.texture)
    response = needed(found.windows).thickness_response(_iris(found))
    freckles, share = needed(found.morphology).freckles, settings.relief
    slopes: Any = (0.0, 0.0)
    lights, shade = needed(found.lighting).lights(), None
    if found.second is None:  # whose light is not known
        room = needed(found.fit).values["room"] if needed(found.lighting).room else 0.0
        shade = shade_on(texture, lights, room, pose.eye, found.tables)
    if share > 0:
        tangent = tangent_of(lights, pose.eye, found.tables)
        slopes = tuple(float(-share * t) for t in tangent)
    told: dict[str, Any] = {"response": response, "slopes": slopes, "shade": shade}
    if freckles.any():
        shares = np.linspace(0, 1, 21) ** 2
        iris = found.iris()
        told["darkness"] = Darkness(shares, needed(found.windows).freckle_response(iris, shares))
    finer = maps_of(texture, freckles, sigma_mm=0.0, **told)
    if share > 0:
        height = share * (finer.thickness - generic_thickness(texture.radius()))
        relief = to_polar(height, texture.pupil_radius, texture.iris_radius)
        relief = jnp.clip(jnp.asarray(relief), -1, 1)
        finer = finer._replace(maps=finer.maps.replace(relief=relief))
    return found._replace(morphology=finer, response=response)


def _iris(found: Clone) -> Iris:
    """That tells thickness: the clone's own, or a usual one where the model does not follow the
    photograph.
    """
    if not misfits(found):
        return found.iris()
    return iris_of(values_of(np.zeros(len(NAMES))), needed(found.base))
