"""A picture is a composition of five functions of a scene.

`project` finds the point of each surface that a pixel sees, `texture` what these surfaces are made
of there, `illuminate` the light that arrives, `respond` how the iris sends light back, and `shade`
makes the picture of them. Each is pure and works under `jit`, `vmap` and `grad`. Whoever draws
many pictures of one scene keeps the values that a change leaves alone: another camera changes
`view`, `texels` and `light`, a moved lamp only `light`, other pigments only `response`.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Cornea, Eye, Sclera
from irisjax.anatomy.lids import Lids
from irisjax.numerics.chunks import pixelwise
from irisjax.render import outside
from irisjax.render.bands import Bands, colour_bands, spectral_bands
from irisjax.render.environment import LUMINANCE
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractResponse, solve_response
from irisjax.render.lids import LASH, frontal_irradiance, lid_base_colour, lid_colours, lid_radiance
from irisjax.render.outside import ColourTable, colour_table
from irisjax.render.project import IrisPixels, View, look, onto_picture, project
from irisjax.render.scene import Scene
from irisjax.render.shading import Facing, IrisModel, sample_textures, scale_ranges
from irisjax.tissue.maps import Scales

# Bytes for the pixels of a band; the programs and tables beside them take three times that.
_MEMORY = 1 << 28
_WHITE, _GLANCE = 0.6, 160  # luminance of the white, and pixels across to find it
_LEAST = 0.01  # of the brightest channel
_PIXEL, _CHANNEL = 1200, 24  # bytes for each of a band's, measured
_Spectrum = tuple[str, str, tuple[float, ...] | None]


class Texels(eqx.Module):
    """What the surfaces are made of where pixels see them; absent parts are `None`.

    Attributes:
        iris: What the integrator needs, see `AbstractIntegrator.texels`.
        facing: How the relief of the iris turns it towards light.
        white: Radiance of the sclera under an irradiance of one, (channels, pixels).
        room: Radiance of the environment that the tear film mirrors, (channels, pixels).
        residual: Factors on the radiance of the iris, (channels, pixels).
        lids: Colour of the lids, (channels, pixels).
    """

    iris: Any
    facing: Facing | None
    white: Float[Array, "channels white_pixels"] | None
    room: Float[Array, "channels mirror_pixels"] | None
    residual: Float[Array, "channels iris_pixels"] | None = None
    lids: Float[Array, "channels lid_pixels"] | None = None


class LitView(eqx.Module):
    """Light of a scene where pixels see its surfaces.

    Attributes:
        surroundings: Radiance of everything but the iris: the sclera and the images in the tear
            film, (channels, pixels of the picture).
        iris: Light on the iris, see `AbstractIntegrator.illuminate`.
    """

    surroundings: Float[Array, "channels pixels"]
    iris: Any


class Band(NamedTuple):
    """Rows of a picture.

    Attributes:
        pixels: Their channels, (rows, width, channels).
        error: Error of a response that is a table; `None` of another.
    """

    pixels: np.ndarray
    error: float | None


def draw(
    scene: Scene, tables: Illumination | None = None, *, caustics: bool | None = None
) -> Float[Array, "height width channels"]:
    """Draw a scene.

    The channels are linear sRGB, unbounded: 1 is a white sheet facing an irradiance of π. Pure: may
    be traced by JAX for pigments, maps, lights, eye and camera; only the lights that stand for an
    environment are chosen from concrete radiances.

    Args:
        scene: The scene; its `wavelengths` decide the channels.
        tables: `scene.tables()`, which are computed where they are not given.
        caustics: Whether the computed tables hold caustics, see `Scene.tables`.

    Returns:
        The picture.
    """
    tables = scene.tables(caustics) if tables is None else tables
    view = project(scene.eye, scene.camera)
    texels = texture(view, scene)
    return shade(view, texels, illuminate(view, texels, scene, tables), respond(scene))


def texture(view: View, scene: Scene) -> Texels:
    """Look up what the surfaces are made of where pixels see them, before any lamp.

    Args:
        view: Result of `project` or `look` for the eye and the camera of the scene.
        scene: The scene; its lamps and pigments make no difference.
    """
    white, room, lids, eye = None, None, None, scene.eye
    if view.sclera is not None and eye.sclera is not None:
        table = _sclera_colours(eye.sclera, _spectrum(scene))
        white = outside.sclera_base_colour(view.sclera, eye, table, scene.veins)
    if view.mirror is not None and scene.environment is not None:
        room = outside.mirrored_environment(view.mirror, scene.environment)
    if view.lids is not None and eye.lids is not None:
        lids = lid_base_colour(view.lids, _lid_colours(eye.lids, _spectrum(scene)))
    return Texels(*iris_texels(view, scene), white, room, _residual(view, scene), lids)


def iris_texels(view: View, scene: Scene) -> tuple[Any, Facing | None]:
    """Look up what the iris is made of where pixels see it, and how it faces the light there: the
    part of `texture` that depends on maps.
    """
    if view.iris is None:
        return None, None
    model = IrisModel(scene.eye, scene.iris, scene.maps)
    texels = scene.integrator.texels(view.iris, model, scale_ranges(scene.iris, scene.maps))
    return texels, model.facing(view.iris)


def illuminate(
    view: View, texels: Texels, scene: Scene, tables: Illumination | None = None
) -> LitView:
    """Compute the light that arrives where pixels see the surfaces.

    Args:
        view: Result of `project` or `look` for the eye and the camera of the scene.
        texels: Result of `texture`.
        scene: The scene; its pigments make no difference.
        tables: `scene.tables()`, which are computed where they are not given.
    """
    tables = scene.tables() if tables is None else tables
    light = None
    if view.iris is not None:
        model = IrisModel(scene.eye, scene.iris, scene.maps)
        arguments = view.iris, scene.all_lights(), model, tables, texels.facing
        light = scene.integrator.illuminate(*arguments)
    return LitView(surroundings(view, texels, scene), light)


def surroundings(view: View, texels: Texels, scene: Scene) -> Float[Array, "channels pixels"]:
    """Radiance of everything but the iris: the sclera and the images in the tear film."""
    lamp, parts, eye = _lamp(scene), [], scene.eye
    skin, dim, every = None, None, None
    if eye.lids is not None or view.sclera is not None:
        every = scene.all_lights(largest_polar=None)
    if eye.lids is not None and every is not None:
        front = frontal_irradiance(every, lamp) / jnp.pi
        skin = _lid_colours(eye.lids, _spectrum(scene))[0]
        dim = 0.3 * skin * front
        if view.lids is not None and texels.lids is not None:
            parts += [(view.lids.index, lid_radiance((view.lids, texels.lids), every, lamp))]
        if view.lashes is not None:
            parts += [(None, LASH * front[:, None] * view.lashes)]
        skin = skin / lamp
    if view.sclera is not None and texels.white is not None and every is not None:
        white = outside.sclera_radiance((view.sclera, texels.white), every, eye, skin)
        parts += [(view.sclera.index, white)]
    if view.mirror is not None:
        images = outside.tear_film_radiance(
            (view.mirror, texels.room), scene.lights, lamp, eye, dim
        )
        parts += [(view.mirror.index, scene.camera.images * images)]
    dark = jnp.zeros((lamp.size, view.size[0] * view.size[1]), lamp.dtype)
    return _added(dark, parts)


def exposure_of_white(scene: Scene) -> float:
    """Compute the factor on radiances that shows the lit white of the eye at a luminance of 0.6, as
    photographs do: the fifth of its pixels that is brightest begins there. Not to be traced.

    Raises:
        ValueError: The camera sees no white, or no light falls on it.
    """
    width, height = scene.camera.size
    size = min(width, _GLANCE), max(round(height * min(1.0, _GLANCE / width)), 1)
    view = look(scene.eye, dataclasses.replace(scene.camera, size=size))
    if view.sclera is None:
        raise ValueError("exposure by the white: the camera sees no white of the eye")
    light = np.asarray(surroundings(view, texture(view, scene), scene), np.float64)
    share = onto_picture(view.sclera, np.asarray(view.sclera.share), (size[1], size[0])).ravel()
    luminance = np.asarray(LUMINANCE) @ light[:, share > 0.8 * share.max()]
    shown = float(np.quantile(luminance, 0.8))
    if not shown > 0:
        raise ValueError("exposure by the white: no light falls on the white of the eye")
    return _WHITE / shown


def respond(scene: Scene, ranges: Scales | None = None) -> AbstractResponse:
    """Compute how the iris of a scene sends light back, in the channels of the picture.

    Args:
        scene: The scene.
        ranges: Ranges of the texels, in place of those of its maps.

    Raises:
        ValueError: The integrator's solver does not hold the layers of a texel.
    """
    iris, index, bands, of_maps = _asked(scene)
    asked = iris, index, bands, of_maps if ranges is None else ranges
    return solve_response(scene.integrator.prepare(*asked), *asked)


def prepared_scene(scene: Scene) -> Scene:
    """Fix everything of the integrator that must be known before tracing, for many pictures."""
    return scene.replace(integrator=scene.integrator.prepare(*_asked(scene)))


def shade(
    view: View, texels: Texels, light: LitView, response: AbstractResponse
) -> Float[Array, "height width channels"]:
    """Make the picture from the results of the other functions."""
    iris = []
    if view.iris is not None:
        radiance = response.shade(view.iris, texels.iris, light.iris)
        if texels.residual is not None:
            radiance = within_gamut(radiance) * texels.residual
        iris = [(view.iris.index, radiance)]
    return _added(light.surroundings, iris, view.size)


def within_gamut(radiance: Float[Array, "channels pixels"]) -> Float[Array, "channels pixels"]:
    """Return radiance with at least 1 % of the brightest channel in each: a saturated colour may
    lie outside sRGB's gamut, where no factor would move a negative channel.
    """
    return jnp.maximum(radiance, _LEAST * radiance.max(0))


def draw_bands(
    scene: Scene, tables: Illumination | None = None, *, samples: int = 1, memory: int = _MEMORY
) -> Iterator[Band]:
    """Draw a scene from the top to the bottom in bands of rows, so that memory is bounded whatever
    the picture's size.

    Args:
        scene: The scene.
        tables: `scene.tables()`, which are computed where they are not given.
        samples: Each pixel is the mean of samples × samples points.
        memory: Bytes that a band may need, beyond what any picture does.

    Yields:
        The bands.
    """
    tables = scene.tables() if tables is None else tables
    width, height = scene.camera.size
    channels = 3 if scene.wavelengths is None else len(scene.wavelengths)
    most = memory // (_PIXEL + _CHANNEL * channels)
    count = min(-(-(width * height * samples**2) // most), height)
    rows = -(-height // count)
    response = respond(scene)
    for start in range(0, height, rows):
        # The last band begins earlier, so that all have one shape: another would be compiled for.
        first = min(start, height - rows)
        part = scene
        if count > 1 or samples > 1:
            part = scene.replace(camera=scene.camera.taking(first, rows, samples))
        view = look(part.eye, part.camera)
        texels = texture(view, part)
        light = illuminate(view, texels, part, tables)
        error = None if response.error is None else float(response.error)
        picture = np.asarray(shade(view, texels, light, response))
        picture = picture.reshape(rows, samples, width, samples, -1).mean((1, 3))
        yield Band(picture[start - first :], error)


def _asked(scene: Scene) -> tuple[Any, Any, Bands, Scales]:
    """Iris, index before it, channels and ranges of maps: what a response depends on."""
    bands = _bands(scene.eye.cornea, _spectrum(scene))
    return scene.iris, scene.eye.aqueous_index, bands, scale_ranges(scene.iris, scene.maps)


def _residual(view: View, scene: Scene) -> Float[Array, "channels pixels"] | None:
    if view.iris is None or scene.maps is None or scene.maps.residual is None:
        return None
    return _residual_at(view.iris, scene.eye, scene.maps.residual)


@pixelwise
def _residual_at(pixels: IrisPixels, eye: Eye, residual: Array) -> Float[Array, "channels pixels"]:
    return jnp.stack(sample_textures(pixels, eye, tuple(jnp.moveaxis(residual, -1, 0))))


def _spectrum(scene: Scene) -> _Spectrum:
    return scene.illuminant, scene.observer, scene.wavelengths


@eqx.filter_jit
def _bands(cornea: Cornea | None, spectrum: _Spectrum, every: bool = False) -> Bands:
    illuminant, observer, wavelengths = spectrum
    if wavelengths is None:
        return colour_bands(illuminant, observer, cornea, every=every)
    return spectral_bands(wavelengths, illuminant, cornea)


def _lamp(scene: Scene) -> Float[Array, " channels"]:
    """A lamp of radiance 1 in the channels of the picture."""
    return jnp.ones(3) if scene.wavelengths is None else _bands(None, _spectrum(scene)).white


@eqx.filter_jit
def _sclera_colours(sclera: Sclera, spectrum: _Spectrum) -> ColourTable:
    bands = _bands(None, spectrum, every=True)
    return colour_table(sclera, np.asarray(bands.wavelengths), bands.weights)


@eqx.filter_jit
def _lid_colours(lids: Lids, spectrum: _Spectrum) -> Float[Array, "3 channels"]:
    bands = _bands(None, spectrum, every=True)
    return lid_colours(lids, np.asarray(bands.wavelengths), bands.weights)


@eqx.filter_jit
def _added(whole: Array, parts: Any, size: tuple[int, int] | None = None) -> Array:
    """Channels of all pixels with those of some parts; as a picture where its `size` is given."""
    for index, colour in parts:
        if index is None:
            whole = whole + colour
        else:  # channel by channel: twice as fast as pixels of three numbers
            whole = whole.at[:, index].add(colour, mode="drop", wrap_negative_indices=False)
    return whole if size is None else whole.T.reshape(size[1], size[0], -1)
