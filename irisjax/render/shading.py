"""From lights and pixels to channels: what reaches the iris, what the sclera sends back, what the tear film mirrors."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.optics.conicoid import dot, norm
from irisjax.optics.fresnel import fresnel_at, safe_sqrt
from irisjax.render.camera import IrisPixels, SurfacePixels
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination, bare
from irisjax.render.lights import Lights
from irisjax.render.memory import Memory
from irisjax.render.sclera import ColourTable, VeinMap, vein_depth_at
from irisjax.tissue.anatomy import Eye
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, fetch
from irisjax.tissue.noise import step

PUPIL_MARGIN = 0.12
"""Width over which the iris fades into the pupil, mm."""


class Field(eqx.Module):
    """Light on the iris, all lamps together: flux vectors on a square grid of ± `extent` mm.

    Shape (rows y, columns x, tints, 3), the share 1 − F that enters the tissue included; one tint where no light
    has a colour of its own.
    """

    flux: Float[Array, "rows columns tints 3"]
    extent: Float[Array, ""]

    def at(self, point: Float[Array, "pixels 3"]) -> Float[Array, "pixels tints 3"]:
        """Bilinear look-up at points of the iris (mm)."""
        size = self.flux.shape[0]
        x, y = (jnp.clip((c / self.extent + 1) * ((size - 1) / 2), 0, size - 1) for c in (point[:, 0], point[:, 1]))
        j, i = (jnp.minimum(jnp.floor(c), size - 2) for c in (x, y))
        u, v = (x - j)[:, None], (y - i)[:, None]
        flat = self.flux.reshape(size * size, -1)
        base = jnp.asarray(i * size + j, jnp.int32)
        a, b, c, d = (flat.at[base + step].get(mode="promise_in_bounds") for step in (0, 1, size, size + 1))
        low, high = a + u * (b - a), c + u * (d - c)
        return (low + v * (high - low)).reshape(-1, *self.flux.shape[2:])


@eqx.filter_jit
def field_of(lights: Lights, eye: Eye, iris: Iris, tables: Illumination | None, size: int = 161) -> Field:
    """Sum the lights on a grid over the iris, one after the other. `tables` are `None` for a bare iris."""
    place = _grid(eye, size)
    normal = eye.iris_normal(place)
    n = iris.indices()

    def add(total, i):
        flux = _flux(lights, i, place, tables)
        length = norm(flux)
        cosine = -dot(flux, normal) / jnp.where(length > 0, length, 1.0)
        flux = flux * jnp.where(cosine > 0, fresnel_at(jnp.maximum(cosine, 0.0), n.aqueous, n.abl)[1], 0.0)[..., None]
        tint = jnp.ones(1, flux.dtype) if lights.tint is None else lights.tint[i]
        return total + flux[..., None, :] * tint[:, None], None

    tints = 1 if lights.tint is None else 3
    zero = jnp.zeros((size, size, tints, 3), lights.irradiance.dtype)
    return Field(jax.lax.scan(add, zero, jnp.arange(len(lights)))[0], eye.iris_radius)


@eqx.filter_jit
def fluxes_of(
    lights: Lights, eye: Eye, tables: Illumination | None, size: int = 161
) -> Float[Array, "lights rows columns 3"]:
    """Flux vectors of each light by itself, in the chamber just before the iris, on the grid of a `Field`."""
    place = _grid(eye, size)
    return jax.lax.map(lambda i: _flux(lights, i, place, tables), jnp.arange(len(lights)))


def _grid(eye: Eye, size: int):
    line = jnp.linspace(-1, 1, size) * eye.iris_radius
    x, y = jnp.meshgrid(line, line)
    r = jnp.sqrt(x * x + y * y)
    if eye.cornea is None:
        height = eye.iris_depth + jnp.zeros_like(r)
    else:
        height = eye.cornea.anterior.sagitta(jnp.minimum(r, eye.limbus_radius))  # about where the light enters
    return jnp.stack([x, y, height], axis=-1)


def _flux(lights: Lights, i, place, tables: Illumination | None):
    towards, power = lights.seen_from(place, i)
    flux = bare(place, towards) if tables is None else tables.at(place[..., :2], towards)
    return flux * jnp.broadcast_to(power, place.shape[:-1])[..., None]


def scales_at(pixels: IrisPixels, eye: Eye, iris: Iris, maps: IrisMaps | None, memory: Memory) -> Scales:
    """How the texels differ from the uniform iris, at the pixels; a map that has not changed is not fetched again."""
    return _each(lambda name, part: memory.once(name, _scale_at, part, iris, pixels.point, eye), maps)


def ranges_of(iris: Iris, maps: IrisMaps | None, memory: Memory) -> Scales:
    """`Scales.ranges` of the maps; a map that has not changed is not searched again."""
    return _each(lambda name, part: memory.once(f"range of {name}", _range, part, iris), maps)


def _each(f, maps: IrisMaps | None) -> Scales:
    """`f` of each scale's name and the maps that it depends on; `None` where there are none."""
    maps = IrisMaps() if maps is None else maps
    parts = {
        "abl": IrisMaps(abl_thickness=maps.abl_thickness, freckles=maps.freckles),
        "stroma": IrisMaps(stroma_thickness=maps.stroma_thickness),
        "eumelanin": IrisMaps(eumelanin=maps.eumelanin),
        "pheomelanin": IrisMaps(pheomelanin=maps.pheomelanin),
    }
    return Scales(*(f(name, part) if part.present() else None for name, part in parts.items()))


def _only(scales: Scales):
    return next(s for s in scales if s is not None)


@eqx.filter_jit
def _scale_at(part: IrisMaps, iris: Iris, point, eye: Eye):
    return fetch(_only(Scales.of(part, iris)), *_polar(point, eye))


@eqx.filter_jit
def _range(part: IrisMaps, iris: Iris):
    return _only(Scales.of(part, iris).ranges())


@eqx.filter_jit
def irradiance_at(
    pixels: IrisPixels, field: Field, eye: Eye, relief: Float[Array, "angles radii"] | None
) -> Float[Array, "tints pixels"]:
    """Irradiance on the iris at the pixels, times all shares on the way out to the camera."""
    normal = normals(pixels.point, eye, relief)
    irradiance = jnp.maximum(-(field.at(pixels.point) * normal[:, None]).sum(-1), 0.0)
    return (irradiance * shares(pixels, eye)[:, None]).T


def _polar(point: Float[Array, "pixels 3"], eye: Eye):
    """Angle (radians) and relative radius of points of the iris."""
    x, y = point[:, 0], point[:, 1]
    return jnp.arctan2(y, x), (jnp.sqrt(x * x + y * y) - eye.pupil_radius) / (eye.iris_radius - eye.pupil_radius)


def normals(
    point: Float[Array, "pixels 3"], eye: Eye, relief: Float[Array, "angles radii"] | None
) -> Float[Array, "pixels 3"]:
    """Unit normals of the iris towards the cornea, tilted by the relief where there is one."""
    normal = eye.iris_normal(point)
    if relief is None:
        return normal
    x, y = point[:, 0], point[:, 1]
    r = jnp.sqrt(x * x + y * y)
    slope = fetch(_slopes(relief, eye), *_polar(point, eye))
    out, round_ = (jnp.stack(v, axis=-1) for v in ((x / r, y / r), (-y / r, x / r)))
    normal = normal.at[:, :2].add(-slope[:, :1] * out - slope[:, 1:] * round_)
    return normal / norm(normal)[:, None]


def shares(pixels: IrisPixels, eye: Eye) -> Float[Array, " pixels"]:
    """Of the iris's radiance that reaches the camera; fades into the pupil, 0 for padding."""
    seen = step((norm(pixels.point[:, :2]) - eye.pupil_radius) / PUPIL_MARGIN)
    return jnp.where(pixels.index < 0, 0.0, pixels.share * seen)


def _slopes(relief, eye: Eye):
    """∂h/∂r and ∂h/(r ∂angle) of a relief, shape (angles, radii, 2)."""
    rows, columns = relief.shape
    span = eye.iris_radius - eye.pupil_radius
    radius = eye.pupil_radius + span * (jnp.arange(columns) + 0.5) / columns
    along = jnp.gradient(relief, axis=1) * (columns / span)
    across = (jnp.roll(relief, -1, 0) - jnp.roll(relief, 1, 0)) * (rows / (4 * jnp.pi)) / radius
    return jnp.stack([along, across], axis=-1)


@eqx.filter_jit
def white_colour(
    pixels: SurfacePixels, eye: Eye, table: ColourTable, veins: VeinMap | None
) -> Float[Array, "pixels channels"]:
    """Channels of the sclera under an irradiance of one, all shares on the way out included."""
    colour = table(jnp.zeros(1, pixels.share.dtype) if veins is None else vein_depth_at(veins, eye, pixels.point))
    return colour * ((1 - pixels.reflectance) * pixels.share / jnp.pi)[:, None]


@eqx.filter_jit
def white(
    pixels: SurfacePixels, lights: Lights, colour: Float[Array, "pixels channels"]
) -> Float[Array, "pixels channels"]:
    """Channels of the sclera: lit as a matt white, light wrapped a little round its edge."""
    cosine = pixels.normal @ lights.towards.T
    # The sclera is translucent: light bleeds some 20° past the terminator, with the same total.
    wrap = jnp.maximum(cosine + 0.3, 0.0) ** 2 / 1.69
    tint = jnp.ones((len(lights), 1), wrap.dtype) if lights.tint is None else lights.tint
    return colour * (wrap @ (lights.irradiance[:, None] * tint))


@eqx.filter_jit
def mirrored(
    pixels: SurfacePixels,
    lights: Lights | None,
    room: Float[Array, "pixels channels"] | None,
    lamp: Float[Array, " channels"],
) -> Float[Array, "pixels channels"]:
    """Channels of images in the tear film: lamps as soft discs of their angular radius, the `room` of `room_at` as it
    is. `lamp` is a lamp of radiance 1 in the picture's channels."""
    total = jnp.zeros((pixels.index.size, lamp.size), pixels.mirror.dtype)
    if lights is not None:
        # Chords in place of angles: an arc cosine a pixel and light costs more than all the rest.
        chord = safe_sqrt(((pixels.mirror[:, None] - lights.towards) ** 2).sum(-1))
        outer, inner = (2 * jnp.sin(share * lights.radius / 2) for share in (1.1, 0.9))
        inside = jnp.clip((outer - chord) / (outer - inner), 0, 1)
        radiance = lights.irradiance / (jnp.pi * jnp.sin(lights.radius) ** 2)
        total = total + inside @ (radiance[:, None] * (lamp if lights.tint is None else lights.tint))
    if room is not None:
        total = total + room
    return total * pixels.reflectance[:, None]


@eqx.filter_jit
def room_at(pixels: SurfacePixels, environment: Environment) -> Float[Array, "pixels 3"]:
    """What the tear film would mirror of the environment, were it silver."""
    return environment.lookup(pixels.mirror)
