"""`Scene`: an eye, its lights and a camera; `render` makes its picture."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.anatomy.sclera import VeinMap
from irisjax.measure.colour import OBSERVER
from irisjax.numerics.portions import pixelwise
from irisjax.render import shading
from irisjax.render import surface as surfaces
from irisjax.render.bands import Bands, all_bands, colour_bands, spectral_bands
from irisjax.render.camera import Camera, View, look, mirror_points
from irisjax.render.environment import Environment
from irisjax.render.illumination import UNIQUE_POLAR, Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.memory import Memory
from irisjax.render.refraction import LARGEST_POLAR
from irisjax.render.sclera import ColourTable, colour_table
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales


class Scene(eqx.Module):
    """Everything a picture shows. Parts that are `None` are not computed.

    - `maps`: of the iris, or `None` for a uniform one. `veins`: of the sclera
        (`grow.vessels.veins`).
    - `lights`: lamps, mirrored as discs. `environment`: lights iris and white as
        `environment_lights` lamps each (those of the white from all round), and is mirrored itself.
        `illuminant`: the spectrum of all of them.
    - `integrator`: how the iris sends light back; `Separable()` holds all orders of scattering,
        `SingleScattering()` marches through the maps and holds the first.
    """

    iris: Iris
    maps: IrisMaps | None = None
    eye: Eye = eqx.field(default_factory=Eye)
    lights: Lights | None = eqx.field(default_factory=lambda: Lights.distant(0.6, 2.2))
    environment: Environment | None = None
    camera: Camera = eqx.field(default_factory=Camera)
    veins: VeinMap | None = None
    integrator: AbstractIntegrator = eqx.field(default_factory=Separable)
    environment_lights: int = eqx.field(static=True, default=25)
    illuminant: str = eqx.field(static=True, default="D65")
    observer: str = eqx.field(static=True, default=OBSERVER)

    def __check_init__(self):
        if self.lights is None and self.environment is None:
            raise ValueError("a scene needs lights or an environment")
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

    def replace(self, **parts: Any) -> "Scene":
        """A copy with some parts changed."""
        return dataclasses.replace(self, **parts)

    def render(
        self, tables: Illumination | None = None, memory: Memory | None = None
    ) -> Float[Array, "height width 3"]:
        """See `render`."""
        return render(self, tables, memory)

    def tables(self) -> Illumination | None:
        """Illumination tables of this eye: no caustics without a grazing light, none at all without
        a cornea.
        """
        return (
            None
            if self.eye.cornea is None
            else Illumination.build(self.eye, caustics=self.grazing())
        )

    def grazing(self) -> bool:
        """Whether a light stands so low that the cornea folds it into caustics.
        Runs on the host.
        """
        return bool((np.asarray(self.all_lights().polar()) > UNIQUE_POLAR).any())

    def all_lights(self) -> Lights:
        """Lamps and what stands for the environment. Runs on the host."""
        return _all_lights(self.lights, self.environment, self.environment_lights, self.illuminant)


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

    def __call__(self, iris: Iris) -> Float[Array, "height width channels"]:
        """The picture with the pigments of `iris`, in the channels of `bands` (linear sRGB)."""
        return self.shown(self.response(iris))

    def response(self, iris: Iris) -> AbstractResponse:
        """What the integrator makes of the pigments; the `error` of a table says how good it is."""
        return _response(self.integrator, iris, self.aqueous_index, self.bands, self.ranges)

    def shown(self, response: AbstractResponse) -> Float[Array, "height width channels"]:
        """The picture with a response."""
        if self.texels is None:
            return _picture(self.base, self.size)
        return _picture(
            _add(self.base, self.texels.index, _shaded(self.texels, self.ground, response)),
            self.size,
        )


def render(
    scene: Scene, tables: Illumination | None = None, memory: Memory | None = None
) -> Float[Array, "height width 3"]:
    """Linear sRGB of a scene, unbounded: 1 is a white sheet facing an irradiance of π.

    `tables` from `scene.tables()` save their making when only lights, camera or pigments change.
    With the `memory` of an earlier call only what has changed since is done.
    """
    memory = Memory() if memory is None else memory
    stage = prepare(scene, tables, memory=memory)
    return stage.shown(
        memory.once(
            "response",
            _response,
            stage.integrator,
            scene.iris,
            stage.aqueous_index,
            stage.bands,
            stage.ranges,
        )
    )


def prepare(
    scene: Scene,
    tables: Illumination | None = None,
    view: View | None = None,
    wavelengths=None,
    memory: Memory | None = None,
) -> Stage:
    """Do everything that a change of pigments leaves alone; `view` from `look` if eye and camera
    are the same.

    With the `memory` of an earlier call only what has changed since is done: maps, say, where a
    lamp has moved. With `wavelengths` (nm) the picture has a channel for each in place of linear
    sRGB: radiance, 1/sr times π, under the illuminant scaled to 1 at 560 nm. **Raises:**
    `ValueError` where light has a colour but no spectrum.
    """
    eye, memory = scene.eye, Memory() if memory is None else memory
    lights = memory.once(
        "lights",
        _all_lights,
        scene.lights,
        scene.environment,
        scene.environment_lights,
        scene.illuminant,
    )
    if wavelengths is None:
        bands = memory.once("bands", colour_bands, lights.illuminant, scene.observer, eye.cornea)
        clear = memory.once("bands outside", all_bands, lights.illuminant, scene.observer)
        lamp = memory.once("lamp", lambda b: jnp.ones_like(b.weights[:, 0]), clear)
    else:
        if scene.environment is not None or lights.tint is not None:
            raise ValueError(
                "spectral pictures need plain lamps: environments and tints have colours, not "
                "spectra"
            )
        bands, clear = (
            spectral_bands(wavelengths, lights.illuminant, c) for c in (eye.cornea, None)
        )
        lamp = clear.weights.sum(axis=1)
    view = memory.once("view", look, eye, scene.camera) if view is None else view
    height, width = scene.camera.shape

    def surface(view, lights, lamps, environment, eye, veins, camera, clear, lamp):
        base = jnp.zeros((lamp.size, width * height), lamp.dtype)
        if view.sclera is not None and eye.sclera is not None:
            table = memory.once("sclera's colours", _sclera_colours, eye.sclera, clear)
            colour = memory.once("white", surfaces.white_colour, view.sclera, eye, table, veins)
            base = _add(base, view.sclera.index, surfaces.white((view.sclera, colour), lights))
        if view.mirror is not None:
            room, point = None, None
            if lamps is not None and lamps.distance is not None:
                point = memory.once("mirror points", mirror_points, view.mirror, eye, camera)
            if environment is not None:
                room = memory.once("room", surfaces.room_at, view.mirror, environment)
            base = _add(
                base, view.mirror.index, surfaces.mirrored((view.mirror, point, room), lamps, lamp)
            )
        return base

    all_round = memory.once(
        "lights all round",
        _all_lights,
        scene.lights,
        scene.environment,
        scene.environment_lights,
        scene.illuminant,
        None,
    )
    outside = (
        all_round,
        scene.lights,
        scene.environment,
        eye,
        scene.veins,
        scene.camera,
        clear,
        lamp,
    )
    base = memory.once("surface", surface, view, *outside)
    texels, ground = None, None
    ranges = shading.ranges_of(scene.iris, scene.maps, memory)
    if view.iris is not None:
        if tables is None:
            tables = scene.tables()
        parts = lights, eye, scene.iris, scene.maps, tables, ranges
        texels, ground = scene.integrator.place(view.iris, *parts, memory)
    return Stage(
        base, texels, ground, bands, scene.integrator, ranges, eye.aqueous_index, (width, height)
    )


def _all_lights(
    lights: Lights | None,
    environment: Environment | None,
    count: int,
    illuminant: str,
    largest_polar: float | None = LARGEST_POLAR,
) -> Lights:
    if environment is None:
        assert lights is not None
        return lights
    around = dataclasses.replace(
        environment.to_lights(count, largest_polar=largest_polar), illuminant=illuminant
    )
    return around if lights is None else lights + around


def _sclera_colours(sclera: Sclera, clear: Bands) -> ColourTable:
    return colour_table(sclera, np.asarray(clear.wavelengths), clear.weights)


@eqx.filter_jit
def _response(
    integrator: AbstractIntegrator, iris: Iris, aqueous_index, bands: Bands, ranges: Scales
) -> AbstractResponse:
    return integrator.response(iris, aqueous_index, bands, ranges)


@jax.jit
def _add(base, index, colour):
    # Channel by channel: twice as fast as pixels of three numbers.
    return (
        base + colour
        if index is None
        else base.at[:, index].add(colour, mode="drop", wrap_negative_indices=False)
    )


@functools.partial(jax.jit, static_argnums=1)
def _picture(channels, size: tuple[int, int]):
    return channels.T.reshape(size[1], size[0], -1)


@pixelwise
def _shaded(texels, ground, response: AbstractResponse):
    # Channels apart within a portion: three numbers a pixel leave the processor's vectors half
    # empty.
    return response.shade(texels, ground)
