"""Light of a photograph: lamps from their images on the cornea."""

from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float
from skimage import measure

from irisjax.anatomy.eye import Eye
from irisjax.photo.photograph import Colours, Ellipse, Mask
from irisjax.photo.pose import Pose
from irisjax.photo.texture import Unrefracted, sampled
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import View, scatter_to_picture
from irisjax.render.scene import ENVIRONMENT_LIGHTS
from irisjax.render.shading import incident_flux

_LEAST_AREA = 5  # pixels of a highlight
_MOST_LAMPS = 6  # lamps
_CORNEA_RADIUS = 0.85  # of the limbus, where highlights are those of the cornea
_CLIPPED = 0.97  # brightness above which it may be
_CORNEAL_GAIN = 1.131**2  # gain of light from all round by the cornea: the pupil's magnification²
_PUPIL_CORE = 0.8  # relative radius of the pupil within which nothing of its edge is seen
SHADED = 0.7  # light below which a place of the iris counts as shade, relative to the usual light


class Lighting(NamedTuple):
    """The light of a photograph.

    Attributes:
        lamps: Lamps as in a scene; `None` if there is only an environment.
        environment: Surroundings as in a scene.
        room: Whether there may be light from all round beside them, whose radiance is fitted with
            the pigments.
        found: Number of lamps inferred from highlights; `None` for a given light.
        environment_lights: Number of lamps that stand for the environment.
    """

    lamps: Lights | None
    environment: Environment | None = None
    room: bool = False
    found: int | None = None
    environment_lights: int = ENVIRONMENT_LIGHTS

    def lights(self) -> Lights:
        """Return all of it but the room, as the lights of a scene."""
        if self.environment is None:
            assert self.lamps is not None
            return self.lamps
        surroundings = self.environment.to_lights(self.environment_lights)
        return surroundings if self.lamps is None else self.lamps + surroundings


def find_lighting(part: Colours, limbus: Ellipse, pose: Pose, view: View) -> Lighting:
    """Infer lamps at infinity, in a room, from the directions that highlights of the camera's
    picture mirror.

    A highlight is cut off somewhere, and reaches to half of that brightness: rounding and JPEG
    break up what is cut off alone. The lamps share an irradiance of π in proportion to the areas of
    their highlights. Without a highlight, uniform light from all round is assumed.

    Args:
        part: Linear pixels of the camera's picture.
        limbus: Outline of the limbus on them: a white that is cut off lies beyond it.
        pose: Camera and eye.
        view: What the camera sees of the eye.
    """
    film, shape, lamps_found = view.mirror, pose.camera.shape, list[tuple[Any, float]]()
    if film is not None:
        directions = scatter_to_picture(
            film, np.stack([np.asarray(c) for c in film.mirror], -1), shape
        )
        brightness = part.max(-1)
        middle = limbus.radii(shape) < _CORNEA_RADIUS
        median = np.median(brightness[middle])
        clipped = middle & (brightness > max(_CLIPPED, 4 * median))
        glow = np.asarray(measure.label(middle & (brightness > 0.5 * (_CLIPPED + median))))
        spots = measure.regionprops(glow, clipped.astype(float))
        spots = [s for s in spots if s.area >= _LEAST_AREA and s.intensity_max > 0]
        for spot in sorted(spots, key=lambda s: -s.area)[:_MOST_LAMPS]:
            mirrored = directions[tuple(spot.coords.T)]
            on_cornea = mirrored.any(-1)
            if on_cornea.mean() >= 0.5:
                lamps_found.append((mirrored[on_cornea].mean(0), spot.area))
    if not lamps_found:
        return Lighting(None, Environment.uniform(), found=0)
    (x, y, z), area = (
        np.transpose([t for t, _ in lamps_found]),
        np.array([a for _, a in lamps_found], float),
    )
    polar, azimuth = np.arctan2(np.hypot(x, y), -z), np.arctan2(y, x)
    # The image of a lamp appears at a distance of half the cornea's radius.
    size = np.sqrt(area / np.pi) * float(pose.camera.width) / pose.camera.size[0]
    assert pose.eye.cornea is not None
    radius = np.clip(2 * size / float(pose.eye.cornea.anterior.radius), 0.005, 0.5)
    numbers: list[Any] = [polar, azimuth, np.pi * area / area.sum()]
    lamps = Lights.distant(*numbers, radius=cast(Any, radius))
    return Lighting(lamps, room=True, found=len(lamps_found))


def find_veil(
    pixels: Colours, clear: Mask, pupil: Ellipse, view: View
) -> Float[np.ndarray, "3"] | None:
    """Return the radiance of the surroundings, in the photograph's exposure, that the tear film
    mirrors over pupil and iris; `None` where it cannot be told.

    The pupil is black: its darker quarter shows the veil alone, and the darkest of the iris bounds
    it. It is less than what an iris lit from all round would have where the room is dark before the
    eye, and where a polariser or the tone curve has taken it off.
    """
    film, inside = view.mirror, pupil.radii(clear.shape) < _PUPIL_CORE
    if film is None or not inside.any():
        return None
    reflectance = scatter_to_picture(film, np.asarray(film.reflectance), clear.shape)[..., None]
    mirrored = pixels / np.maximum(reflectance, 1e-6)
    veil = np.quantile(mirrored[inside], 0.25, axis=0)
    if clear.any():
        veil = np.minimum(veil, 0.9 * np.quantile(mirrored[clear], 0.02, axis=0))
    return np.maximum(veil, 0)


def irradiance_of_iris(
    x: np.ndarray, y: np.ndarray, lights: Lights, eye: Eye, tables: Illumination | None
) -> np.ndarray:
    """Return the irradiance of the iris at places of its plane (mm), in the chamber."""
    flux = np.asarray(incident_flux(lights, eye, tables))[:, 2].sum(0)
    middle, reach = (len(flux) - 1) / 2, float(eye.iris_radius)
    # Rows of the grid run up, as y does.
    return sampled(flux.astype(np.float32), *((c / reach + 1) * middle for c in (y, x)))


def find_shade(
    texture: Unrefracted, lights: Lights, room: float, eye: Eye, tables: Illumination | None
) -> Mask:
    """Return the texels that get less than `SHADED` of the median light: the shadow of the limbus.

    Beside the lights there may be a `room` of some radiance all round.
    """
    radius, angle = texture.radius(), texture.angle()
    irradiance = irradiance_of_iris(
        radius * np.cos(angle), radius * np.sin(angle), lights, eye, tables
    )
    irradiance += np.float32(np.pi * _CORNEAL_GAIN * room)
    median = np.median(irradiance[texture.valid]) if texture.valid.any() else 0.0
    return irradiance < SHADED * median
