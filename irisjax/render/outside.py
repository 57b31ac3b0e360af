"""Radiance of the outer surface of the eye: the sclera under its vessels, and images in the tear
film.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.anatomy.sclera import VeinMap
from irisjax.numerics.portions import pixelwise
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import Parts, joined
from irisjax.render.environment import Environment
from irisjax.render.lights import Lights
from irisjax.render.project import MirrorPixels, ScleraPixels
from irisjax.render.sclera import ColourTable, vein_depth_at
from irisjax.render.surfaces import GlobeSurface

_BLEED = 0.3
"""Cosine by which light reaches past the terminator of the white."""


@pixelwise
def white_colour(
    pixels: ScleraPixels, eye: Eye, table: ColourTable, veins: VeinMap | None
) -> Float[Array, "channels pixels"]:
    """Channels of the sclera under an irradiance of one, all shares on the way out included."""
    if veins is None:
        colour = table.channels(jnp.zeros(1, pixels.share.dtype))
    else:
        # Each computed once: XLA would work out the place anew for each texture, and the blood for
        # each channel.
        place = jax.lax.optimization_barrier(GlobeSurface(eye).place(joined(pixels.point)))
        blood = jax.lax.optimization_barrier(vein_depth_at(veins, *place))
        colour = table.at_node(jax.lax.optimization_barrier(table.node(blood.depth)), blood)
    return jnp.stack(colour) * ((1 - pixels.reflectance) * pixels.share / jnp.pi)


@pixelwise
def white(
    pixels: tuple[ScleraPixels, Float[Array, "channels pixels"]], lights: Lights
) -> Float[Array, "channels pixels"]:
    """Channels of the sclera from its `white_colour`: lit as a matt white, light wrapped a little
    round its edge.

    Approximation: the tear film takes its share on the way out and not on the way in.
    """
    sclera, colour = pixels
    towards, irradiance = lights.around(sclera.point)
    cosine = sum(n * t for n, t in zip(sclera.normal, towards, strict=True))
    # The sclera is translucent: light bleeds 17° past the terminator. A round white sends back what
    # a matt one does.
    bled = jnp.where(cosine > _BLEED, cosine, jnp.maximum(cosine + _BLEED, 0.0) ** 2 / (4 * _BLEED))
    tint = jnp.ones((len(lights), 1), bled.dtype) if lights.tint is None else lights.tint
    return colour * (tint.T @ (irradiance * bled / (1 + _BLEED**2 / 3)))


@pixelwise
def mirrored(
    pixels: tuple[MirrorPixels, Parts | None, Float[Array, "channels pixels"] | None],
    lights: Lights | None,
    lamp: Float[Array, " channels"],
) -> Float[Array, "channels pixels"]:
    """Channels of images in the tear film: lamps as soft discs of their angular radius, the room of
    `room_at` (or `None`) as it is. Lamps that are near ask for the points of `mirror_points`.
    `lamp` is a lamp of radiance 1 in the picture's channels."""
    film, point, room = pixels
    total = jnp.zeros((lamp.size, film.reflectance.size), film.reflectance.dtype)
    if lights is not None:
        # Chords in place of angles: an arc cosine a pixel and light costs more than all the rest.
        towards = (
            [t[:, None] for t in lights.towards.T] if point is None else lights.around(point)[0]
        )
        x, y, z = (m - t for m, t in zip(film.mirror, towards, strict=True))
        chord = safe_sqrt(x * x + y * y + z * z)
        outer, inner = (2 * jnp.sin(share * lights.radius / 2)[:, None] for share in (1.1, 0.9))
        inside = jnp.clip((outer - chord) / (outer - inner), 0, 1)
        radiance = lights.irradiance / (jnp.pi * jnp.sin(lights.radius) ** 2)
        total = (
            total + (radiance[:, None] * (lamp if lights.tint is None else lights.tint)).T @ inside
        )
    if room is not None:
        total = total + room
    return total * film.reflectance


@pixelwise
def room_at(pixels: MirrorPixels, environment: Environment) -> Float[Array, "3 pixels"]:
    """Radiance of the environment in the direction that the tear film mirrors."""
    return environment.lookup(joined(pixels.mirror)).T
