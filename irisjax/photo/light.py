"""Light of a photograph: lamps, windows and soft boxes from their images on the cornea."""

from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float
from scipy import ndimage, spatial
from skimage import measure

from irisjax.anatomy.eye import Eye, cornea_of
from irisjax.photo.photograph import Colours, Ellipse, Mask
from irisjax.photo.pose import Pose
from irisjax.photo.texture import Unrefracted, sampled
from irisjax.render.environment import LUMINANCE, Environment, panorama_geometry
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.project import View, scatter_to_picture
from irisjax.render.refraction import LARGEST_POLAR
from irisjax.render.scene import ENVIRONMENT_LIGHTS
from irisjax.render.shading import incident_flux

_LEAST_AREA = 5  # pixels of a highlight
_MOST_LAMPS = 6  # lamps
_WIDEST_LAMP = 0.2  # angular radius of a lamp; wider ones are drawn as they are seen
_WIDE_LIGHTS = 4  # lamps that stand for all wide lights
_BRIGHT_IRIS, _RINGS = 0.98, 24  # quantile of the iris beside an image; its rings of one colour
_PANORAMA_ROWS = 256  # most rows of the panorama of wide lights
_CORNEA_RADIUS = 0.85  # of the limbus, where highlights are those of the cornea
_CLIPPED = 0.97  # brightness above which it may be
_CORNEAL_GAIN = 1.131**2  # gain of light from all round by the cornea: the pupil's magnification²
_PUPIL_CORE = 0.8  # relative radius of the pupil within which nothing of its edge is seen
SHADED = 0.7  # light below which a place of the iris counts as shade, relative to the usual light


class Lighting(NamedTuple):
    """The light of a photograph.

    Attributes:
        lamps: Lamps as in a scene; `None` if there is only an environment.
        environment: Surroundings as in a scene; with a `room`, the wide lights in it.
        room: Whether there may be light from all round beside them, whose radiance is fitted with
            the pigments.
        found: Number of lamps and wide lights inferred from highlights; `None` for a given light.
        environment_lights: Number of lamps that stand for the environment.
        exposure: Exposure of the photograph as wide lights tell it: the light of their images over
            what the tear film mirrors of them; `None` without wide lights.
        burnt_out: Whether these images are cut off, so that the exposure is at least this.
    """

    lamps: Lights | None
    environment: Environment | None = None
    room: bool = False
    found: int | None = None
    environment_lights: int = ENVIRONMENT_LIGHTS
    exposure: float | None = None
    burnt_out: bool = False

    def lights(self) -> Lights:
        """Return all of it but the room, as the lights of a scene."""
        if self.environment is None:
            assert self.lamps is not None
            return self.lamps
        count = _WIDE_LIGHTS if self.room else self.environment_lights
        around = self.environment.to_lights(count)
        return around if self.lamps is None else self.lamps + around

    def surroundings(self, room: float) -> Environment | None:
        """Return the environment of a scene with a room of this radiance."""
        if not self.room:
            return self.environment
        if self.environment is None:
            return Environment.uniform(room)
        return Environment(self.environment.radiance + room)


def find_lighting(
    part: Colours, limbus: Ellipse, pupil: Ellipse, reflected: Mask, pose: Pose, view: View
) -> Lighting:
    """Infer the light, in a room, from the directions that highlights of the camera's picture
    mirror: lamps at infinity from compact ones, and windows or soft boxes from wide ones.

    A highlight is cut off somewhere, and reaches to half of that brightness: rounding and JPEG
    break up what is cut off alone. Where none is, mirror images that are not cut off count, by the
    light that they add to the iris. A wide light reaches as far as the mirror image that it is part
    of, and becomes a panorama of what the photograph shows there [Nishino & Nayar 2004]; where that
    is cut off it is brighter. Lamps and wide lights share an irradiance of π, on surfaces that face
    them, in proportion to the light of their images. Without a highlight, uniform light from all
    round is assumed.

    Args:
        part: Linear pixels of the camera's picture.
        limbus: Outline of the limbus on them: a white that is cut off lies beyond it.
        pupil: Outline of the pupil as it appears.
        reflected: Pixels in which a mirror image hides the iris.
        pose: Camera and eye.
        view: What the camera sees of the eye.
    """
    film, shape = view.mirror, pose.camera.shape
    if film is None:
        return Lighting(None, Environment.uniform(), found=0)
    directions = scatter_to_picture(film, np.stack([np.asarray(c) for c in film.mirror], -1), shape)
    brightness, middle = part.max(-1), limbus.radii(shape) < _CORNEA_RADIUS
    median = np.median(brightness[middle])
    clipped = middle & (brightness > max(_CLIPPED, 4 * median))
    glow = middle & (brightness > 0.5 * (_CLIPPED + median))
    burnt_out = bool(clipped.any())
    if not burnt_out:
        clipped = glow = middle & reflected
    spots = measure.regionprops(measure.label(glow), clipped.astype(float))
    spots = [s for s in spots if s.area >= _LEAST_AREA and s.intensity_max > 0]
    # The image of a lamp appears at a distance of half the cornea's radius.
    scale = 2 * float(pose.camera.width) / pose.camera.size[0]
    scale /= float(cornea_of(pose.eye).anterior.radius)
    # The pupil is black: what shines there is mirrored.
    image = glow | reflected | (brightness > median) & (pupil.radii(shape) < _PUPIL_CORE)
    # The white beyond mirrors the same directions again; what is behind the eye does not light it.
    before = middle & (-directions[..., 2] > np.cos(LARGEST_POLAR))
    images = np.asarray(measure.label(image & before))
    lamps, wide = list[tuple[Any, Any, float]](), set[int]()
    for spot in sorted(spots, key=lambda s: -s.area)[:_MOST_LAMPS]:
        at = tuple(spot.coords.T)
        lit, radius = before[at], scale * np.sqrt(spot.area / np.pi)
        numbers = images[at][lit & clipped[at]]
        if lit.mean() < 0.5 or not numbers.size or (number := int(numbers[0])) in wide:
            continue
        if radius > _WIDEST_LAMP:
            wide.add(number)
        else:
            lamps.append((directions[at][lit].mean(0), at, max(radius, 0.005)))
    if not lamps and not wide:
        return Lighting(None, Environment.uniform(), found=0)
    seen, sure = np.isin(images, list(wide)), glow | reflected
    over_iris = _image_over_iris(part, image, sure, limbus, pupil)
    shown = np.where(seen[..., None], over_iris, 0)
    power = float((shown @ LUMINANCE).sum())
    # Pixels that are cut off count as 1: they are at least as bright.
    bright = np.where(burnt_out, 1.0, over_iris @ LUMINANCE)
    powers = np.array([bright[at].sum() for _, at, _ in lamps])
    total = power + powers.sum()
    if total == 0:  # no more light than the iris has beside it
        return Lighting(None, Environment.uniform(), found=0)
    environment, lights, exposure = None, None, None
    if wide:
        reflectance = scatter_to_picture(film, np.asarray(film.reflectance), shape)[..., None]
        irradiance = np.pi * power / total
        panorama, light = _panorama(shown / np.maximum(reflectance, 1e-6), directions, seen)
        environment, exposure = Environment(irradiance * panorama), light / irradiance
    if lamps:
        directed, _, radius = zip(*lamps, strict=True)
        x, y, z = np.transpose(directed)
        polar, azimuth = np.arctan2(np.hypot(x, y), -z), np.arctan2(y, x)
        parts: list[Any] = [polar, azimuth, np.pi * powers / total]
        lights = Lights.distant(*parts, radius=cast(Any, np.array(radius)))
    known: dict[str, Any] = {"exposure": exposure, "burnt_out": burnt_out}
    return Lighting(lights, environment, room=True, found=len(lamps) + len(wide), **known)


def _image_over_iris(
    part: Colours, image: Mask, sure: Mask, limbus: Ellipse, pupil: Ellipse
) -> np.ndarray:
    """Estimate what a mirror image adds to the light of the iris, whose usual colour at each
    distance from the middle is taken off; nothing where the iris itself may be as bright.
    """
    radius = limbus.radii(image.shape)
    ring = np.minimum(radius * _RINGS, _RINGS - 1).astype(int)
    inside = (radius < 1) & (pupil.radii(image.shape) > 1)
    bare = inside & ~image & (radius < _CORNEA_RADIUS)  # all darker than the glow
    if not bare.any():
        return part
    bare_ring, channels = ring[bare], np.moveaxis(part[bare], -1, 0)
    known = np.unique(bare_ring)
    medians = [ndimage.median(channel, bare_ring, known) for channel in channels]
    usual = np.stack([np.interp(np.arange(_RINGS), known, m) for m in medians], -1)[ring]
    usual[~inside] = 0
    brightest = np.quantile(part[bare].max(-1), _BRIGHT_IRIS)
    certain = np.clip(2 * (part.max(-1) / brightest - 1), 0, 1) if brightest > 0 else 1.0
    certain = np.where(inside & ~sure, certain, 1.0)
    # No single fibres.
    wide = sure | np.asarray(ndimage.binary_opening(certain > 0, np.ones((3, 3))))
    return np.maximum(part - usual, 0) * (certain * wide)[..., None]


def _panorama(
    radiance: Float[np.ndarray, "rows columns 3"],
    mirrored: Float[np.ndarray, "rows columns 3"],
    seen: Mask,
) -> tuple[Float[np.ndarray, "polar azimuth 3"], float]:
    """Lay what pixels mirror into a panorama whose irradiance, on surfaces that face it, is one;
    return also what it was before.
    """
    near = np.asarray(ndimage.binary_dilation(seen, iterations=2), bool) & mirrored.any(-1)
    tree = spatial.KDTree(mirrored[near])
    pitch = np.median(tree.query(mirrored[near], 2)[0][:, 1])
    rows = int(np.clip(np.pi / pitch, 32, _PANORAMA_ROWS))
    direction, solid_angle = panorama_geometry(rows)
    distance, pixel = tree.query(direction, distance_upper_bound=2 * max(pitch, np.pi / rows))
    values = np.concatenate([radiance[near], np.zeros((1, 3))])  # the last is for none
    panorama = np.where(np.isfinite(distance)[..., None], values[pixel], 0.0)
    irradiance = float((panorama @ LUMINANCE * solid_angle).sum())
    return panorama / irradiance, irradiance


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
    x: np.ndarray, y: np.ndarray, lights: Lights, room: float, eye: Eye, tables: Illumination | None
) -> np.ndarray:
    """Return the irradiance of the iris at places of its plane (mm), in the chamber, by lamps and a
    room of some radiance all round.
    """
    flux = np.asarray(incident_flux(lights, eye, tables))[:, 2].sum(0)
    middle, reach = (len(flux) - 1) / 2, float(eye.iris_radius)
    # Rows of the grid run up, as y does.
    of_lamps = sampled(flux.astype(np.float32), *((c / reach + 1) * middle for c in (y, x)))
    return of_lamps + np.float32(np.pi * _CORNEAL_GAIN * room)


def find_shade(
    texture: Unrefracted, lights: Lights, room: float, eye: Eye, tables: Illumination | None
) -> Mask:
    """Return the texels that get less than `SHADED` of the median light: the shadow of the limbus.

    Beside the lights there may be a `room` of some radiance all round.
    """
    radius, angle = texture.radius(), texture.angle()
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    irradiance = irradiance_of_iris(x, y, lights, room, eye, tables)
    return in_shade(irradiance, texture.valid)


def in_shade(irradiance: np.ndarray, usual: Mask) -> Mask:
    """Return the places that get less than `SHADED` of the median light of the usual ones."""
    median = np.median(irradiance[usual]) if usual.any() else 0.0
    return irradiance < SHADED * median
