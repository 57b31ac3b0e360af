"""Windows of the iris, and the renderer as a matrix for their colours  [F09 Section 5.2]."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import procedural
from irisjax.numerics.streams import key_of
from irisjax.photo.light import SHADED
from irisjax.photo.photograph import Brightness, Colours, Mask
from irisjax.photo.texture import LUMINANCE_WEIGHTS
from irisjax.photo.thickness import generic_thickness
from irisjax.render.bands import Bands, colour_bands
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import solve_response
from irisjax.render.lights import Lights
from irisjax.render.outside import mirrored_environment
from irisjax.render.project import IrisPixels, View, VisiblePart, pixel_numbers, scatter_to_picture
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import ENVIRONMENT_LIGHTS
from irisjax.render.separable import Separable
from irisjax.render.shading import IrisModel, scale_ranges
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.transport.solution import RESULTS

TURNS = 16  # places around the eye to which its maps are turned, so that no feature has a place
_SEED = 5
ANGLES, RINGS = 16, 4
"""Windows around the iris, and across it."""
MARGIN = 0.35  # distance of the windows from the pupil's edge, mm
# From root and limbus, mm: the white's soft edge, modelled only as a blend, shades the iris below.
OUTER_MARGIN = 0.7
COUNT = ANGLES * RINGS
_MOST_PIXELS, _LEAST_PIXELS = 96, 24  # most taken of a window; least of a window that counts
_COPIES = 4  # turns of the maps that one pixel sees
_Integrator = Separable | RadiativeIntegrator
_WindowColours = Float[np.ndarray, "windows 3"]
_Modelled = Float[Array, "windows 3"]


class WindowPixels(NamedTuple):
    """Pixels of the windows of one photograph, and the windows' mean colours.

    Every photograph has the same shapes: windows with too few pixels are empty, and missing pixels
    have the number of no window, `COUNT`.

    Attributes:
        seen: Some pixels of the windows.
        window: The number of each pixel's window.
        colour: Mean linear values of all of a window's pixels in the photograph.
        present: Windows with enough pixels, and not in the shade.
        veil: Share of a uniform room's radiance that the tear film mirrors.
        mirrored: Radiance that it mirrors of the environment.
    """

    seen: IrisPixels
    window: Int[np.ndarray, " pixels"]
    colour: _WindowColours
    present: Bool[np.ndarray, " windows"]
    veil: Float[np.ndarray, " windows"]
    mirrored: _WindowColours


class WhiteSeen(NamedTuple):
    """Evidence of the white of the eye on the exposure and the balance of the light.

    Attributes:
        colour: Linear values in the photograph.
        reflectance: Its usual colour where a white sheet that faces the camera has 1.
        light: Radiance of such a sheet in the light without the room.
        root: Inverse root of the covariance of the logarithms of the colour, (3, 3).
    """

    colour: Float[np.ndarray, "3"]
    reflectance: Float[np.ndarray, "3"]
    light: Float[np.ndarray, "3"]
    root: Float[np.ndarray, "3 3"]


NO_WHITE = WhiteSeen(np.ones(3), np.ones(3), np.ones(3), np.zeros((3, 3)))


class Windows(eqx.Module):
    """Windows of one photograph: their mean colours, and the model's as a matrix.

    A picture is linear in the coefficients of the iris's response. What lights, cornea and
    thickness map do to them is computed once, and a change of the pigments costs a product with a
    small matrix.

    Attributes:
        colour: As in `WindowPixels`, as are `present`, `veil` and `mirrored`.
        matrix: Matrix from the coefficients of a response to radiance, and its derivative by the
            logarithm of the stroma's thickness, (2, windows, channels, products × functions).
        room: The same for a uniform room of radiance 1 beside the lights.
        in_room: 1 with that room, 0 without: an array, so that photographs share programs.
        bands: Wavelength bands of the response.
        ranges: Ranges of its thickness scales.
        integrator: Model of light in the iris.
        aqueous_index: Refractive index of the aqueous humour.
        exposure: The photograph's exposure, as mirror images of wide lights tell it; 0 without.
        at_least: Whether the exposure may be more: these images are cut off, or there are none.
        white: The white of the eye, whose `WhiteSeen.root` is 0 where none is seen.
    """

    colour: _WindowColours
    present: Bool[np.ndarray, " windows"]
    veil: Float[np.ndarray, " windows"]
    mirrored: _WindowColours
    matrix: Float[Array, "2 windows 3 terms"]
    room: Float[Array, "2 windows 3 terms"]
    in_room: Float[np.ndarray, ""]
    bands: Bands
    ranges: Scales
    integrator: _Integrator
    aqueous_index: Scalar
    exposure: Float[np.ndarray, ""] = eqx.field(default_factory=lambda: np.zeros(()))
    at_least: Bool[np.ndarray, ""] = eqx.field(default_factory=lambda: np.ones((), bool))
    white: WhiteSeen = eqx.field(default_factory=lambda: NO_WHITE)

    def radiance(self, iris: Iris, room: Scalar | float = 0.0) -> _Modelled:
        """Return the mean linear sRGB of an iris in each window, where a white sheet that faces an
        irradiance of π has 1, in a `room` of some radiance; NaN for an iris that cannot be solved.
        """
        return self.radiance_and_slope(iris, room)[0]

    def radiance_and_slope(
        self, iris: Iris, room: Scalar | float = 0.0
    ) -> tuple[_Modelled, _Modelled]:
        """Return `radiance`, and its derivative by the logarithm of the stroma's thickness."""
        arguments = self.aqueous_index, self.bands, self.ranges
        coefficients, status = self.integrator.coefficients(iris, *arguments)
        terms = coefficients.reshape(-1, 3)
        if status is not None:
            terms = jnp.where(status == RESULTS.successful, terms, jnp.nan)
        around = self.in_room * room
        matrix = self.matrix + around * self.room
        radiance, slope = jnp.einsum("dwtk,kt->dwt", matrix, terms)
        return radiance + self.mirrored + around * self.veil[:, None], slope

    def thickness_response(self, iris: Iris) -> float:
        """Return d ln luminance / d ln thickness of a mean stroma, seen and lit from the front."""
        luminance = self._from_the_front(iris, self.ranges, Scales(stroma=jnp.asarray([0.9, 1.1])))
        return float(np.log(luminance[1] / luminance[0]) / np.log(1.1 / 0.9))

    def freckle_response(
        self, iris: Iris, shares: Float[np.ndarray, " shares"]
    ) -> Float[np.ndarray, " shares"]:
        """Return the luminance of an iris with shares of a freckle (as in `IrisMaps.freckles`) over
        its own, seen and lit from the front.
        """
        spots = IrisMaps(freckles=jnp.asarray([shares, 0 * shares], float))
        ranges = self.ranges._replace(abl=scale_ranges(iris, spots).abl)
        abl_scale = spots.abl_scale(iris)
        assert abl_scale is not None
        scales = Scales(abl=abl_scale[0], stroma=jnp.ones_like(abl_scale[0]))
        own = scales._replace(abl=0 * abl_scale[0] + 1)
        spotted, bare = (self._from_the_front(iris, ranges, s) for s in (scales, own))
        return spotted / bare

    def _from_the_front(self, iris: Iris, ranges: Scales, scales: Scales) -> np.ndarray:
        """Luminance of uniform irides."""
        arguments = self.integrator, iris, self.aqueous_index, self.bands, ranges
        return LUMINANCE_WEIGHTS @ np.asarray(_frontal_brdf(solve_response(*arguments), scales))


@eqx.filter_jit
def _frontal_brdf(response: Any, scales: Scales) -> Float[Array, "channels texels"]:
    ones = jnp.ones_like(scales.stroma)
    return response.brdf(scales, ones, ones, 0 * ones)


def make_windows(
    chosen: WindowPixels,
    eye: Eye,
    iris: Iris,
    maps: IrisMaps,
    lights: Lights,
    integrator: _Integrator,
    tables: Illumination | None,
    room: bool = False,
    turned: bool = False,
) -> Windows:
    """Compute the matrix of the windows.

    The iris fixes everything but the melanins. Beside the lights there may be a room, whose tables
    need caustics. For the pixels of each window the maps may be turned to `TURNS` places around the
    eye: the window then shows what is usual at its distance from the pupil.
    """
    ranges = scale_ranges(iris, maps)
    bands = colour_bands(lights.illuminant, cornea=eye.cornea)
    prepared: Any = integrator.prepare(iris, eye.aqueous_index, bands, ranges)
    arguments = eye, iris, maps, tables, ranges, bands, prepared
    # Each pixel sees the maps at several turns: features of a window by chance would look like an
    # error of the contrast.
    turns, copies = (TURNS, _COPIES) if turned else (1, 1)
    pixels = jax.tree.map(lambda leaf: jnp.repeat(leaf, copies, -1), chosen.seen)
    window = jnp.repeat(jnp.asarray(chosen.window), copies)
    # Neighbours in a window have different turns.
    turn = 2 * np.pi / turns * (np.arange(len(window)) % turns)
    pixels = dataclasses.replace(pixels, turn=jnp.asarray(turn))
    # Lights are filled up to the number of a room's, and tinted as these: one program serves all.
    missing = -len(lights) % ENVIRONMENT_LIGHTS
    ahead, none = np.tile([0.0, 0.0, -1.0], (missing, 1)), np.zeros(missing)
    dark = Lights(ahead, none, np.ones((missing, 3)), illuminant=lights.illuminant)
    matrix = _matrix(pixels, window, lights + dark, *arguments)
    of_room = jnp.zeros_like(matrix)
    if room:
        uniform = Environment.uniform().to_lights(ENVIRONMENT_LIGHTS)
        of_room = _matrix(pixels, window, uniform, *arguments)
    rooms = of_room, np.asarray(float(room))
    index = jnp.asarray(eye.aqueous_index)
    return Windows(*chosen[2:], matrix, *rooms, bands, ranges, prepared, index)


def choose_pixels(
    pixels: Colours,
    clear: Mask,
    view: View,
    eye: Eye,
    environment: Environment | None = None,
    light: Brightness | None = None,
) -> WindowPixels:
    """Choose the pixels of all windows, from the clear pixels of the camera's picture, which show
    the iris without highlights, lashes, lids, freckles and white.

    `light` is the model's irradiance of the iris at each pixel, if only the eye itself casts
    shadows on it. Windows beside those in the shade do not count then either: the shadow's edge
    moves with the direction of the light, which is uncertain by degrees. Without it, windows in the
    shade are recognised by the photograph's brightness, which also drops windows that are dark
    themselves. Six windows at least must be free.
    """
    iris = view.iris
    if iris is None:
        raise ValueError("the camera does not see the iris")
    everywhere = _windows_of_pixels(iris, eye)
    is_clear = clear.reshape(-1)[pixel_numbers(iris)]
    windows = _with_enough_pixels(np.where(is_clear, everywhere, COUNT))
    index, window = _sample_windows(windows)
    sampled = dataclasses.replace(iris, index=None)
    sampled = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), sampled)
    count, mean = _means_of_windows(windows, iris)
    colour = mean(pixels, 3)
    if light is None:
        shaded = _find_shaded(colour @ LUMINANCE_WEIGHTS, count > 0)
    else:  # known where a window is hidden, too
        number, mean_light = _means_of_windows(_with_enough_pixels(everywhere), iris)
        shaded = _with_neighbours(_find_shaded(mean_light(light, 1)[:, 0], number > 0))
    present = (count > 0) & ~shaded
    if present.sum() < 6:
        raise ValueError(
            f"only {present.sum()} windows of the iris are free of highlights, lashes, lids and "
            "their shadows; at least 6 are needed for the pigments"
        )
    veil, mirrored = _tear_film(view, clear.shape, environment)
    return WindowPixels(sampled, window, colour, present, mean(veil, 1)[:, 0], mean(mirrored, 3))


def iris_alone(view: View) -> Mask:
    """Return the pixels of a picture that see the iris and none of the white, which shines through
    at the limbus.
    """

    def seen(part: VisiblePart | None) -> Mask:
        if part is None:
            return np.zeros(shape, bool)
        return scatter_to_picture(part, np.ones(len(pixel_numbers(part)), bool), shape)

    columns, rows = view.size
    shape = rows, columns
    return seen(view.iris) & ~seen(view.sclera)


def average_thickness(eye: Eye) -> float:
    """Return the mean of the generic thickness over the area of an eye's iris, mm."""
    radius = np.linspace(float(eye.pupil_radius), float(eye.iris_radius), 200)
    return float(np.average(generic_thickness(radius), weights=radius))


def average_maps(eye: Eye) -> IrisMaps:
    """Return the average thickness by ultrasound with fibres, crypts and relief of `procedural`.

    Pigments are fitted with this iris: the thickness map is estimated from the same photograph, so
    it must not be used as independent evidence for the pigments. Fibres and clouds are fainter than
    in a light iris. Shade and uneven thickness make an iris darker than a smooth one inside the
    collarette, a blue one by a quarter and a brown one by 7 %; outside they change it by 3 % at
    most.
    """
    iris = Iris(stroma_thickness=jnp.asarray(average_thickness(eye)))
    return procedural(iris, eye, fibres=0.5, clouds=0.4, key=key_of(_SEED))


@eqx.filter_jit
def _matrix(pixels, window, lights, eye, iris, maps, tables, ranges, bands, integrator):
    response = integrator.response(iris, eye.aqueous_index, bands, ranges)
    first_channel = response.coefficients[..., :1]
    share = jnp.maximum(jnp.zeros(COUNT).at[window].add(1.0, mode="drop"), 1.0)

    facing = IrisModel(eye, iris, maps).facing(pixels)

    def light_pixels(log_scale):
        thicker = maps.replace(stroma_depth=maps.stroma_depth * jnp.exp(log_scale))
        model = IrisModel(eye, iris, thicker)
        texels = integrator.texels(pixels, model, ranges)
        light = integrator.illuminate(pixels, lights, model, tables, facing)
        return eqx.partition((texels, light), eqx.is_inexact_array)

    zero, one = jnp.zeros((), first_channel.dtype), jnp.ones((), first_channel.dtype)
    numbers, derivatives, rest = jax.jvp(light_pixels, (zero,), (one,), has_aux=True)

    def means(numbers, coefficients):
        coefficients = coefficients.reshape(first_channel.shape)
        with_coefficients = eqx.tree_at(lambda r: r.coefficients, response, coefficients)
        shaded = with_coefficients.shade(pixels, *eqx.combine(numbers, rest))
        sums = jnp.zeros((COUNT, shaded.shape[0])).at[window].add(shaded.T, mode="drop")
        return sums / share[:, None]

    flat = jnp.zeros(first_channel.size, first_channel.dtype)

    def column(direction):
        def linear(numbers):
            return jax.jvp(lambda c: means(numbers, c), (flat,), (direction,))[1]

        return jnp.stack(jax.jvp(linear, (numbers,), (derivatives,)))

    return jax.lax.map(column, jnp.eye(first_channel.size)).transpose(1, 2, 3, 0)


def ring_radius(eye: Eye, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the radii (mm) of the rings between pupil and root on which points of the iris lie."""
    return np.asarray(eye.from_axis(eye.ring_of(x, y)[0]))


def _find_shaded(light, present) -> Bool[np.ndarray, " windows"]:
    """Windows much darker than most of their ring: in a shadow, whose edge is not modelled well."""
    rings = np.ma.masked_array(light, ~present).reshape(RINGS, ANGLES)
    return (rings < SHADED * np.ma.median(rings, axis=1)[:, None]).filled(False).ravel()


def _with_neighbours(windows: Bool[np.ndarray, " windows"]) -> Bool[np.ndarray, " windows"]:
    """Add the windows that touch some, across the iris and round it."""
    edges: Any = "constant", "wrap"
    return ndimage.maximum_filter(windows.reshape(RINGS, ANGLES), 3, mode=edges).ravel()


def _tear_film(view: View, shape: tuple[int, int], environment: Environment | None):
    """Reflectance of every pixel of the picture, and the radiance mirrored of an environment."""
    mirror = view.mirror
    if mirror is None:
        return np.zeros(shape), np.zeros((*shape, 3))
    reflectance = np.asarray(mirror.reflectance)
    room = np.zeros((len(reflectance), 3))
    if environment is not None:
        room = reflectance[:, None] * np.asarray(mirrored_environment(mirror, environment)).T
    return scatter_to_picture(mirror, reflectance, shape), scatter_to_picture(mirror, room, shape)


def _means_of_windows(windows, seen: IrisPixels):
    """Number of pixels of each window, and a function for the mean of the values of a picture in
    each.
    """
    inside = windows < COUNT
    windows, numbers = windows[inside], pixel_numbers(seen)[inside]
    count = np.bincount(windows, minlength=COUNT)

    def mean(values, channels: int):
        values = values.reshape(-1, channels)[numbers].T
        sums = [np.bincount(windows, v, COUNT) for v in values]
        return np.stack(sums, -1) / np.maximum(count, 1)[:, None]

    return count, mean


def _windows_of_pixels(seen: IrisPixels, eye: Eye):
    """The number of each pixel's window, `COUNT` for none."""
    number = pixel_numbers(seen)
    x, y = map(np.asarray, seen.point[:2])
    r, around = ring_radius(eye, x, y), np.arctan2(y, x) % (2 * np.pi)
    inner = float(eye.pupil_radius) + MARGIN
    outer = min(float(eye.iris_radius), float(eye.limbus_radius)) - OUTER_MARGIN
    usable = (number >= 0) & (r > inner) & (r < outer)
    ring = np.minimum((r - inner) / (outer - inner) * RINGS, RINGS - 1).astype(int)
    sector = np.minimum(around / (2 * np.pi) * ANGLES, ANGLES - 1).astype(int)
    return np.where(usable, ring * ANGLES + sector, COUNT)


def _with_enough_pixels(window):
    """Give the pixels of windows that have too few of them the number of none."""
    enough = np.bincount(window, minlength=COUNT + 1) >= _LEAST_PIXELS
    return np.where(enough[window], window, COUNT)


def _sample_windows(window):
    """Indices of some pixels of each window, and the numbers of their windows."""
    # Equally many of each, so that one compiled program serves all photographs.
    index, name = np.zeros((COUNT, _MOST_PIXELS), int), np.full((COUNT, _MOST_PIXELS), COUNT)
    for w in np.unique(window[window < COUNT]):
        of = np.flatnonzero(window == w)
        taken = of[np.linspace(0, len(of) - 1, min(_MOST_PIXELS, len(of))).astype(int)]
        index[w, : len(taken)], name[w, : len(taken)] = taken, w
    # Padding repeats a visible pixel.
    index[name == COUNT] = index[name < COUNT][0] if (name < COUNT).any() else 0
    return index.ravel(), name.ravel()
