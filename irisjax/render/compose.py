"""A picture composed: `project`, `illuminate`, `respond` and `shade`, one after the other.

Pure: everything here works under `jit`, `vmap` and `grad`, and keeps nothing. Whoever draws many
pictures of one scene keeps what does not change with `stages.Memory`.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Sclera
from irisjax.numerics.portions import pixelwise
from irisjax.render import outside, shading
from irisjax.render.bands import Bands, all_bands, colour_bands, spectral_bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.project import MirrorPixels, View, mirror_points, project
from irisjax.render.scene import Scene, all_lights
from irisjax.render.sclera import ColourTable, colour_table
from irisjax.render.steps import Once, simply
from irisjax.tissue.maps import Scales
from irisjax.transport.solution import raise_failure


def render(
    scene: Scene, tables: Illumination | None = None, *, caustics: bool | None = None
) -> Float[Array, "height width 3"]:
    """Linear sRGB of a scene, unbounded: 1 is a white sheet facing an irradiance of π.

    `tables` from `scene.tables()` save their making; without them they are made with `caustics`,
    see `Scene.tables`. To be traced by JAX as it stands: by pigments, maps, lights, eye and camera.
    An environment's lights are chosen from concrete radiances.
    """
    tables = scene.tables(caustics) if tables is None else tables
    return prepare(scene, tables)(scene.iris)


class Stage(eqx.Module):
    """A scene with all done that a change of pigments leaves alone. Make one with `prepare`.

    - `base`: sclera and mirror images, (channels, pixels); `texels`: what the integrator needs of
        each of the iris's pixels; `ground`: what it needs for all of them.
    """

    base: Float[Array, "channels pixels"]
    texels: Any
    ground: Any
    bands: Bands
    integrator: AbstractIntegrator
    ranges: Scales
    aqueous_index: Scalar
    size: tuple[int, int] = eqx.field(static=True)

    def __call__(self, iris: Any) -> Float[Array, "height width channels"]:
        """The picture with the pigments of `iris`, in the channels of `bands` (linear sRGB)."""
        return self.shown(self.response(iris))

    def response(self, iris: Any) -> AbstractResponse:
        """What the integrator makes of the pigments; the `error` of a table says how good it is."""
        return respond(self.integrator, iris, self.aqueous_index, self.bands, self.ranges)

    def shown(
        self, response: AbstractResponse, once: Once = simply
    ) -> Float[Array, "height width channels"]:
        """The picture with a response."""
        if self.texels is None:
            return _picture(self.base, self.size)
        colour = once("iris", shade, self.texels, self.ground, response)
        return _picture(_add(self.base, self.texels.index, colour), self.size)


def prepare(
    scene: Scene,
    tables: Illumination | None = None,
    view: View | None = None,
    wavelengths=None,
    once: Once = simply,
) -> Stage:
    """Do everything that a change of pigments leaves alone.

    `view`: of `project` or `stages.look`, by default the former's. With `wavelengths` (nm) the
    picture has a channel for each in place of linear sRGB: radiance, 1/sr times π, under the
    illuminant scaled to 1 at 560 nm. `once` does the steps. **Raises:** `ValueError` where light
    has a colour but no spectrum.
    """
    eye = scene.eye
    tables = scene.tables() if tables is None else tables
    seen: View = once("view", project, eye, scene.camera) if view is None else view
    known = scene.lights, scene.environment, scene.environment_lights, scene.illuminant
    lights = once("lights", all_lights, *known)
    bands, clear, lamp = _channels(scene, lights, wavelengths, once)
    base = _surroundings(scene, seen, clear, lamp, once)
    texels, ground = None, None
    iris: Any = scene.iris  # None for an integrator of paint, which asks for none
    ranges = shading.ranges_of(iris, scene.maps, once)
    known = scene.integrator, iris, eye.aqueous_index, bands, ranges
    integrator = once("integrator", _prepared, *known)
    if seen.iris is not None:
        parts = lights, eye, iris, scene.maps, tables, ranges
        texels, ground = integrator.place(seen.iris, *parts, once)
    return Stage(base, texels, ground, bands, integrator, ranges, eye.aqueous_index, seen.size)


def respond(
    integrator: AbstractIntegrator, iris: Any, aqueous_index, bands: Bands, ranges: Scales
) -> AbstractResponse:
    """How the iris of given pigments sends light back, in the channels of `bands`.

    **Raises:** `ValueError` where the integrator's solver does not hold the layers of a texel.
    """
    found = _respond(integrator, iris, aqueous_index, bands, ranges)
    if found.status is not None:
        raise_failure(found.status)
    return found


@pixelwise
def shade(texels, ground, response: AbstractResponse) -> Float[Array, "channels pixels"]:
    """Radiance of the iris's pixels, from `AbstractIntegrator.place` and `respond`."""
    # Channels apart within a portion: three numbers a pixel leave the processor's vectors half
    # empty.
    return response.shade(texels, ground)


def _channels(scene: Scene, lights: Lights, wavelengths, once: Once):
    """Bands of the iris, those of what lies outside the cornea, and a lamp of radiance 1 in the
    picture's channels.
    """
    cornea = scene.eye.cornea
    if wavelengths is None:
        bands = once("bands", colour_bands, lights.illuminant, scene.observer, cornea)
        clear = once("bands outside", all_bands, lights.illuminant, scene.observer)
        return bands, clear, once("lamp", _ones, clear)
    if scene.environment is not None or lights.tint is not None:
        raise ValueError(
            "spectral pictures need plain lamps: environments and tints have colours, not spectra"
        )
    bands, clear = (spectral_bands(wavelengths, lights.illuminant, c) for c in (cornea, None))
    return bands, clear, clear.weights.sum(axis=1)


def _surroundings(scene: Scene, view: View, clear: Bands, lamp, once: Once):
    """Channels of all that is no iris: the white, and images in the tear film."""
    eye, lamps, environment = scene.eye, scene.lights, scene.environment
    base = once("black", _black, lamp, view.size[0] * view.size[1])
    if view.sclera is not None and eye.sclera is not None:
        table = once("sclera's colours", _sclera_colours, eye.sclera, clear)
        colour = outside.white_colour(view.sclera, eye, table, scene.veins, once)
        known = lamps, environment, scene.environment_lights, scene.illuminant, None
        all_round = once("lights all round", all_lights, *known)
        lit = once("lit white", outside.white, (view.sclera, colour), all_round)
        base = once("white and black", _add, base, view.sclera.index, lit)
    if view.mirror is not None:
        point, room = None, None
        if lamps is not None and lamps.distance is not None:
            index = once("mirror's pixels", _numbers, view.mirror)
            point = once("mirror points", mirror_points, index, eye, scene.camera)
        if environment is not None:
            room = once("room", outside.room_at, view.mirror, environment)
        images = once("images", outside.mirrored, (view.mirror, point, room), lamps, lamp)
        base = once("surroundings", _add, base, view.mirror.index, images)
    return base


def _numbers(pixels: MirrorPixels):
    count = pixels.reflectance.size
    every = jnp.arange(count, dtype=jnp.int32)
    return every if pixels.index is None else jnp.maximum(pixels.index, 0)


def _prepared(integrator: AbstractIntegrator, iris: Any, aqueous_index, bands, ranges: Scales):
    return integrator.prepare(iris, aqueous_index, bands, ranges)


@eqx.filter_jit
def _respond(integrator: AbstractIntegrator, iris: Any, aqueous_index, bands, ranges: Scales):
    return integrator.response(iris, aqueous_index, bands, ranges)


@eqx.filter_jit
def _sclera_colours(sclera: Sclera, clear: Bands) -> ColourTable:
    return colour_table(sclera, np.asarray(clear.wavelengths), clear.weights)


def _ones(clear: Bands):
    return jnp.ones(len(clear.weights), clear.weights.dtype)


def _black(lamp, pixels: int):
    return jnp.zeros((lamp.size, pixels), lamp.dtype)


@eqx.filter_jit
def _add(base, index, colour):
    # Channel by channel: twice as fast as pixels of three numbers.
    return (
        base + colour
        if index is None
        else base.at[:, index].add(colour, mode="drop", wrap_negative_indices=False)
    )


@eqx.filter_jit
def _picture(channels, size: tuple[int, int]):
    return channels.T.reshape(size[1], size[0], -1)
