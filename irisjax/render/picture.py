"""A picture is a composition of five functions of a scene.

`project` finds the point of each surface that a pixel sees, `texture` looks up the maps of these
surfaces there, `illuminate` computes the light that arrives, `respond` how the iris sends light
back, and `shade` combines them into the picture. Each is pure and works under `jit`, `vmap` and
`grad`. To draw many pictures of one scene, keep the values that do not change: another camera
changes `view`, `texels` and `light`, a moved lamp only `light`, other pigments only `response`.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from irisjax.anatomy.eye import Cornea, Eye, Sclera
from irisjax.anatomy.lids import Lids
from irisjax.numerics.chunks import on_cores, pixelwise, share_count
from irisjax.render import outside
from irisjax.render.bands import Bands, colour_bands, spectral_bands
from irisjax.render.environment import LUMINANCE
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractResponse, solve_response
from irisjax.render.lids import LASH, lid_base_colour, lid_colours, lid_radiance
from irisjax.render.outside import ColourTable, colour_table
from irisjax.render.project import (
    LEAST_PADDED,
    IrisPixels,
    View,
    project,
    project_shares,
    project_visible,
    scatter_to_picture,
)
from irisjax.render.scene import Scene
from irisjax.render.shading import Facing, IrisModel, sample_textures, scale_ranges
from irisjax.tissue.maps import Scales

# Bytes for the pixels of a band; programs and tables take three times as much in addition.
_MEMORY = 1 << 28
_PIXEL_BYTES, _CHANNEL_BYTES = 1200, 24  # measured for each pixel of a band, and for each channel
_SCLERA_LUMINANCE = 0.6  # of the white of the eye in a well exposed photograph
_PREVIEW_WIDTH = 160  # pixels of the picture from which an exposure is computed
_LEAST_SHARE = 0.01  # of a pixel's brightest channel in its others
_Spectrum = tuple[str, str, tuple[float, ...] | None]
_PARTS = "lids", "lashes", "sclera", "film", "iris"  # the order in which radiances are added
Radiances = dict[str, tuple[Int[Array, " _"] | None, Float[Array, "channels _"]]]
"""Radiances of a picture by name: numbers of pixels (−1 for padding), or `None` for all, and their
radiance.
"""


class Texels(eqx.Module):
    """Maps of the surfaces at the points that pixels see; absent parts are `None`.

    Attributes:
        iris: Result of `AbstractIntegrator.texels`.
        facing: How the relief of the iris turns it towards light.
        sclera: Radiance of the sclera under an irradiance of one, (channels, pixels).
        environment: Radiance of the environment that the tear film mirrors, (channels, pixels).
        residual: Factors on the radiance of the iris, (channels, pixels).
        lids: Colour of the lids, (channels, pixels).
    """

    iris: Any
    facing: Facing | None
    sclera: Float[Array, "channels sclera_pixels"] | None
    environment: Float[Array, "channels mirror_pixels"] | None
    residual: Float[Array, "channels iris_pixels"] | None = None
    lids: Float[Array, "channels lid_pixels"] | None = None


class LitView(eqx.Module):
    """Light of a scene at its pixels.

    Attributes:
        surroundings: Radiance of everything but the iris: sclera, images in the tear film and
            lids, (channels, pixels of the picture).
        iris: Light on the iris, the result of `AbstractIntegrator.illuminate`.
    """

    surroundings: Float[Array, "channels pixels"]
    iris: Any


class Band(NamedTuple):
    """A band of rows of a picture.

    Attributes:
        pixels: Radiance, (rows, width, channels).
        error: Error of a tabulated response; `None` of others.
    """

    pixels: np.ndarray
    error: float | None


def draw(
    scene: Scene, tables: Illumination | None = None, *, caustics: bool | None = None
) -> Float[Array, "height width channels"]:
    """Draw a scene.

    The channels are linear sRGB, unbounded: 1 is a white sheet facing an irradiance of π. Pure: JAX
    may trace pigments, maps, lights, eye and camera; only the radiances of an environment must be
    concrete, since lights that approximate it are chosen from them.

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


def draw_on_cores(
    scene: Scene,
    tables: Illumination | None = None,
    response: AbstractResponse | None = None,
    model: IrisModel | None = None,
) -> Float[Array, "height width channels"]:
    """Draw a scene as `draw` does, not to be traced. Each core draws a share of the pixels from
    beginning to end if the integrator allows it, so that threads wait for one another only once.

    A camera that moves changes none of the other arguments.

    Args:
        scene: The scene.
        tables: `scene.tables()`, which are computed where they are not given, as are the others.
        response: `respond(scene)`.
        model: `lit_model(scene, tables)`.

    Returns:
        The picture.
    """
    tables = scene.tables() if tables is None else tables
    response = respond(scene) if response is None else response
    model = lit_model(scene, tables) if model is None else model

    def draw_share(trace: Callable[[], View]) -> Radiances:
        view = trace()
        texels = texture(view, scene, model)
        light = light_on_iris(view, texels, scene, tables, model)
        parts = surrounding_parts(view, texels, scene)
        return parts | iris_part(view, texels, light, response)

    size = scene.camera.size
    return add_parts(black_picture(scene, size), on_cores(draw_share, trace_shares(scene)), size)


def trace_shares(scene: Scene) -> list[Callable[[], View]]:
    """Return `project_shares` in as many shares as there are threads for the picture; in one if the
    integrator looks at all pixels.
    """
    rows, columns = scene.camera.shape
    shares = share_count(rows * columns) if scene.integrator.pixels_apart else 1
    return project_shares(scene.eye, scene.camera, shares)


def texture(view: View, scene: Scene, model: IrisModel | None = None) -> Texels:
    """Look up the maps of the surfaces at the points that pixels see.

    Args:
        view: Result of `project` or `project_visible` for the eye and the camera of the scene.
        scene: The scene; its lamps and pigments make no difference.
        model: `iris_model(scene)`, which is the same for every view; computed by default.
    """
    iris = facing = sclera = environment = residual = lids = None
    eye = scene.eye
    if view.sclera is not None and eye.sclera is not None:
        table = _sclera_colours(eye.sclera, _spectrum(scene))
        sclera = outside.sclera_base_colour(view.sclera, eye, table, scene.veins)
    if view.mirror is not None and scene.environment is not None:
        environment = outside.mirrored_environment(view.mirror, scene.environment)
    if view.lids is not None and eye.lids is not None:
        lids = lid_base_colour(view.lids, _lid_colours(eye.lids, _spectrum(scene)))
    if view.iris is not None:
        model = iris_model(scene) if model is None else model
        assert model.ranges is not None
        iris = scene.integrator.texels(view.iris, model, model.ranges)
        facing = model.facing(view.iris)
        if scene.maps is not None and scene.maps.residual is not None:
            residual = _residual_at(view.iris, eye, scene.maps.residual)
    return Texels(iris, facing, sclera, environment, residual, lids)


def iris_model(scene: Scene) -> IrisModel:
    """Return the iris of a scene, with what is the same for many views and lights."""
    return IrisModel(scene.eye, scene.iris, scene.maps).prepared()


def lit_model(
    scene: Scene, tables: Illumination | None, model: IrisModel | None = None
) -> IrisModel:
    """Return `iris_model(scene)`, which may be given, with what is the same for many views."""
    model = iris_model(scene) if model is None else model
    return scene.integrator.lit(model, scene.all_lights(), tables)


def illuminate(
    view: View,
    texels: Texels,
    scene: Scene,
    tables: Illumination | None = None,
    model: IrisModel | None = None,
) -> LitView:
    """Compute the light that arrives at the points that pixels see.

    Args:
        view: Result of `project` or `project_visible` for the eye and the camera of the scene.
        texels: Result of `texture`.
        scene: The scene; its pigments make no difference.
        tables: `scene.tables()`, which are computed where they are not given.
        model: `lit_model(scene, tables)`, which is the same for every view.
    """
    tables = scene.tables() if tables is None else tables
    light = light_on_iris(view, texels, scene, tables, model)
    return LitView(surroundings(view, texels, scene), light)


def light_on_iris(
    view: View,
    texels: Texels,
    scene: Scene,
    tables: Illumination | None,
    model: IrisModel | None = None,
) -> Any:
    """Compute the light on the iris, the second part of `illuminate`; `None` without an iris. The
    `lit_model` of the scene may be given.
    """
    if view.iris is None:
        return None
    model = IrisModel(scene.eye, scene.iris, scene.maps) if model is None else model
    arguments = view.iris, scene.all_lights(), model, tables, texels.facing
    return scene.integrator.illuminate(*arguments)


def surroundings(view: View, texels: Texels, scene: Scene) -> Float[Array, "channels pixels"]:
    """Compute the radiance of everything but the iris: sclera, images in the tear film and lids."""
    return add_parts(black_picture(scene, view.size), [surrounding_parts(view, texels, scene)])


def black_picture(scene: Scene, size: tuple[int, int]) -> Float[Array, "channels pixels"]:
    """Return a picture of this width and height without any part, to which `add_parts` adds."""
    lamp = _unit_lamp(scene)
    return jnp.zeros((lamp.size, size[0] * size[1]), lamp.dtype)


def surrounding_parts(view: View, texels: Texels, scene: Scene) -> Radiances:
    """Compute `surroundings`, each part at its own pixels."""
    lamp, eye, parts = _unit_lamp(scene), scene.eye, dict[Any, Any]()
    skin, mirrored_lids, lights = None, None, None
    if eye.lids is not None or view.sclera is not None:
        lights = scene.all_lights(largest_polar=None)
    if eye.lids is not None and lights is not None:
        out_of_face = jnp.asarray([0.0, 0.0, -1.0], lights.towards.dtype)
        frontal = lamp * lights.irradiance_on(out_of_face) / jnp.pi
        skin = _lid_colours(eye.lids, _spectrum(scene))[0]
        mirrored_lids = 0.3 * skin * frontal
        if view.lids is not None and texels.lids is not None:
            radiance = lid_radiance((view.lids, texels.lids), lights, lamp)
            parts["lids"] = view.lids.index, radiance
        if view.lashes is not None:
            parts["lashes"] = None, LASH * frontal[:, None] * view.lashes
        skin = skin / lamp
    if view.sclera is not None and texels.sclera is not None and lights is not None:
        sclera = outside.sclera_radiance((view.sclera, texels.sclera), lights, eye, skin)
        parts["sclera"] = view.sclera.index, sclera
    if view.mirror is not None:
        film = view.mirror, texels.environment
        images = outside.tear_film_radiance(film, scene.lights, lamp, eye, mirrored_lids)
        parts["film"] = view.mirror.index, scene.camera.images * images
    return parts


def exposure_of_white(scene: Scene) -> float:
    """Compute the factor on radiances that exposes for the white of the eye, as photographs do: the
    80th percentile of its luminance becomes 0.6. Not to be traced.

    Raises:
        ValueError: The camera sees no white, or no light falls on it.
    """
    width, height = scene.camera.size
    size = min(width, _PREVIEW_WIDTH), max(round(height * min(1.0, _PREVIEW_WIDTH / width)), 1)
    camera = dataclasses.replace(scene.camera, size=size)
    view = project_visible(scene.eye, camera, once=True)
    if view.sclera is None:
        raise ValueError("exposure by the white: the camera sees no white of the eye")
    light = np.asarray(surroundings(view, texture(view, scene), scene), np.float64)
    share = scatter_to_picture(view.sclera, np.asarray(view.sclera.share), camera.shape).ravel()
    luminance = np.asarray(LUMINANCE) @ light[:, share > 0.8 * share.max()]
    bright = float(np.quantile(luminance, 0.8))
    if not bright > 0:
        raise ValueError("exposure by the white: no light falls on the white of the eye")
    return _SCLERA_LUMINANCE / bright


def respond(scene: Scene, ranges: Scales | None = None) -> AbstractResponse:
    """Compute how the iris of a scene sends light back, in the channels of the picture.

    Args:
        scene: The scene.
        ranges: Ranges of the texels, in place of those of its maps.

    Raises:
        ValueError: The layers of a texel are outside the range of the integrator's solver.
    """
    arguments = _response_arguments(scene, ranges)
    return solve_response(scene.integrator.prepare(*arguments), *arguments)


def prepare_scene(scene: Scene) -> Scene:
    """Fix the settings of the integrator that depend on concrete numbers, for many pictures."""
    return scene.replace(integrator=scene.integrator.prepare(*_response_arguments(scene)))


def shade(
    view: View, texels: Texels, light: LitView, response: AbstractResponse
) -> Float[Array, "height width channels"]:
    """Combine the results of the other functions into the picture."""
    iris = iris_part(view, texels, light.iris, response)
    return add_parts(light.surroundings, [iris], view.size)


def iris_part(view: View, texels: Texels, light: Any, response: AbstractResponse) -> Radiances:
    """Compute the radiance of the iris in `light_on_iris`; nothing without an iris."""
    if view.iris is None:
        return {}
    radiance = response.shade(view.iris, texels.iris, light)
    if texels.residual is not None:
        radiance = _with_residual(radiance, texels.residual)
    return {"iris": (view.iris.index, radiance)}


@eqx.filter_jit
def add_parts(
    picture: Float[Array, "channels _"],
    shares: list[Radiances],
    size: tuple[int, int] | None = None,
) -> Array:
    """Add the channels of the parts of several shares to those of all pixels, a part after the
    other; as a picture where its `size` is given.
    """
    for index, radiance in (share[name] for name in _PARTS for share in shares if name in share):
        if index is None:
            picture = picture + radiance
        else:  # channel by channel: twice as fast as pixels of three numbers
            picture = picture.at[:, index].add(radiance, mode="drop", wrap_negative_indices=False)
    return picture if size is None else picture.T.reshape(size[1], size[0], -1)


@eqx.filter_jit
def within_gamut(radiance: Float[Array, "channels pixels"]) -> Float[Array, "channels pixels"]:
    """Raise each channel to at least 1 % of the brightest one: a saturated colour may lie outside
    sRGB's gamut, and a factor cannot raise a negative channel.
    """
    return jnp.maximum(radiance, _LEAST_SHARE * radiance.max(0))


@eqx.filter_jit
def _with_residual(radiance: Array, residual: Array) -> Float[Array, "channels pixels"]:
    return within_gamut(radiance) * residual


def draw_bands(
    scene: Scene, tables: Illumination | None = None, *, samples: int = 1, memory: int = _MEMORY
) -> Iterator[Band]:
    """Draw a scene from the top to the bottom in bands of rows, so that memory is bounded whatever
    the picture's size.

    Args:
        scene: The scene.
        tables: `scene.tables()`, which are computed where they are not given.
        samples: Each pixel is the mean of samples × samples points.
        memory: Bytes that a band may need, in addition to those of a small picture.

    Yields:
        The bands.
    """
    tables = scene.tables() if tables is None else tables
    width, height = scene.camera.size
    channels = 3 if scene.wavelengths is None else len(scene.wavelengths)
    max_pixels = memory // (_PIXEL_BYTES + _CHANNEL_BYTES * channels)
    if max_pixels >= LEAST_PADDED:  # to as many are the parts of bands padded
        max_pixels = 1 << (max_pixels.bit_length() - 1)
    count = -(-height // max(max_pixels // (width * samples**2), 1))
    rows = -(-height // count)
    response, model = respond(scene), lit_model(scene, tables)
    for start in range(0, height, rows):
        # The last band overlaps the one before, so that all bands have one compiled shape.
        first = min(start, height - rows)
        band_scene = scene
        if count > 1 or samples > 1:
            band_scene = scene.replace(camera=scene.camera.crop_rows(first, rows, samples))
        view = project_visible(band_scene.eye, band_scene.camera, once=True)
        texels = texture(view, band_scene, model)
        light = illuminate(view, texels, band_scene, tables, model)
        error = None if response.error is None else float(response.error)
        picture = np.asarray(shade(view, texels, light, response))
        picture = picture.reshape(rows, samples, width, samples, -1).mean((1, 3))
        yield Band(picture[start - first :], error)


def _response_arguments(scene: Scene, ranges: Scales | None = None) -> tuple[Any, Any, Bands, Any]:
    """Return the arguments of `AbstractIntegrator.response`; its ranges default to the maps'."""
    bands = _bands(scene.eye.cornea, _spectrum(scene))
    ranges = scale_ranges(scene.iris, scene.maps) if ranges is None else ranges
    return scene.iris, scene.eye.aqueous_index, bands, ranges


@pixelwise
def _residual_at(pixels: IrisPixels, eye: Eye, residual: Array) -> Float[Array, "channels pixels"]:
    return jnp.stack(sample_textures(pixels, eye, tuple(jnp.moveaxis(residual, -1, 0))))


def _spectrum(scene: Scene) -> _Spectrum:
    return scene.illuminant, scene.observer, scene.wavelengths


@eqx.filter_jit
def _bands(cornea: Cornea | None, spectrum: _Spectrum, all_wavelengths: bool = False) -> Bands:
    illuminant, observer, wavelengths = spectrum
    if wavelengths is None:
        return colour_bands(illuminant, observer, cornea, all_wavelengths=all_wavelengths)
    return spectral_bands(wavelengths, illuminant, cornea)


def _unit_lamp(scene: Scene) -> Float[Array, " channels"]:
    """Return a lamp of radiance 1 in the channels of the picture."""
    return jnp.ones(3) if scene.wavelengths is None else _bands(None, _spectrum(scene)).white


@eqx.filter_jit
def _sclera_colours(sclera: Sclera, spectrum: _Spectrum) -> ColourTable:
    bands = _bands(None, spectrum, all_wavelengths=True)
    return colour_table(sclera, np.asarray(bands.wavelengths), bands.weights)


@eqx.filter_jit
def _lid_colours(lids: Lids, spectrum: _Spectrum) -> Float[Array, "3 channels"]:
    bands = _bands(None, spectrum, all_wavelengths=True)
    return lid_colours(lids, np.asarray(bands.wavelengths), bands.weights)
