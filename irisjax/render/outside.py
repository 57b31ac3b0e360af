"""Radiance of the outer surface of the eye: the white under its vessels, and images in the tear
film.

Vessels are a texture with blood only [F09 Section 6.5] in two layers: conjunctival ones, sharp and
red, and episcleral ones, seen blurred and veiled through the tissue over them.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax._types import Spectrum
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.anatomy.sclera import VeinMap
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.fusion import materialise
from irisjax.numerics.interpolation import polar_bilinear
from irisjax.numerics.roots import safe_sqrt
from irisjax.optics.conicoid import from_parts
from irisjax.render.environment import Environment
from irisjax.render.lids import BOUNCE, let_in, mirrored_past
from irisjax.render.lights import Lights, wrapped
from irisjax.render.project import MirrorPixels, ScleraPixels
from irisjax.render.surfaces import GlobeSurface
from irisjax.tissue.diffusion import (
    bloodless_absorption,
    diffuse_reflectance,
    fibrous_scattering,
    melanosome_absorption,
    slab_reflectance,
)
from irisjax.tissue.pigments import extinction

SHALLOW, DEEP = 0.07, 0.3
"""Tissue over conjunctival and over episcleral vessels, mm."""

DEEP_CHORD = 0.08
"""Blood in an episcleral vessel, mm: opaque in the green, clear in the red, so that its exact value
shows little.
"""

DEEPEST = 0.25
"""Largest vein depth of the colour table, mm."""

# mm: below it the table's nodes are uniform, above it logarithmic, as the Soret band requires.
_KNEE = 2e-3
_BLEED = 0.3  # the white is translucent: light reaches 17° past the terminator, set by eye


class Blood(NamedTuple):
    """Vessels over points of the white: `depth` of blood in a conjunctival one along its normal,
    mm; `cover`, the share of the light, 0 to 1, that meets it (`None`: all); `deep`, the share that
    meets an episcleral one.
    """

    depth: Float[Array, "*s"]
    cover: Float[Array, "*s"] | None = None
    deep: Float[Array, "*s"] | None = None


def bulk_reflectance(sclera: Sclera, wavelengths: ArrayLike) -> Spectrum:
    """Diffuse reflectance of the white without vessels, wavelengths in nm.

    A slab of fibrous tissue, sclera and conjunctiva, 1.1 mm in all, before a choroid of 5 % blood
    and 0.6 % melanosomes. It absorbs by its capillaries, 0.07 % of its volume, and by
    `sclera.yellowing` times the pigment of a bloodless tissue. About 0.6, near the 0.5 that models
    of the fundus take [Delori & Pflibsen 1989, Appl. Opt. 28, 1061]. Thicknesses and shares are set
    by eye.
    """
    scattering, blood = fibrous_scattering(wavelengths), absorption(sclera, wavelengths)
    choroid = 0.05 * blood + 0.006 * melanosome_absorption(wavelengths)
    behind = diffuse_reflectance(choroid, scattering, inside=0.0)
    own = sclera.yellowing * bloodless_absorption(wavelengths) + 7e-4 * blood
    return slab_reflectance(own, scattering, 1.1, behind)


def veil(wavelengths: ArrayLike, thickness: float) -> Spectrum:
    """Share of light that `thickness` mm of clear tissue above a vessel sends back, wavelengths in
    nm. It makes vessels fainter, and bluer with depth.
    """
    scattering = fibrous_scattering(wavelengths)
    nothing = jnp.zeros_like(scattering)
    return slab_reflectance(nothing, scattering, thickness, nothing)


def absorption(sclera: Sclera, wavelengths: ArrayLike) -> Spectrum:
    """Napierian absorption of the vessels' blood, 1/mm, at `wavelengths` (nm)."""
    table = extinction(wavelengths)
    share = sclera.saturation
    return sclera.hemoglobin * (share * table.oxyhemoglobin + (1 - share) * table.deoxyhemoglobin)


def sclera_reflectance(
    sclera: Sclera, wavelengths: ArrayLike, blood: Blood
) -> Float[Array, "... wavelengths"]:
    """Diffuse reflectance of the white under vessels, shape (…, wavelengths).

    ρ (1 − c (1 − v₁)(1 − e^(−2μd))) (1 − e (1 − v₂)(1 − e^(−2μD))): bulk reflectance ρ, cover c and
    e, veils v, and light that passes the blood twice (Beer–Lambert). Wavelengths in nm.
    Approximations: light that wanders sideways below a vessel narrower than its 0.5 mm path passes
    the blood once rather than twice, so real capillaries are up to half as dark; back-scatter of
    the blood itself (some 0.05 in the red) is left out.

    Raises:
        ValueError: A wavelength lies outside the tables of haemoglobin.
    """
    depth, cover, deep = blood
    mu = absorption(sclera, wavelengths)
    dark = (1 - veil(wavelengths, SHALLOW)) * -jnp.expm1(-2 * mu * depth[..., None])
    dark = dark if cover is None else cover[..., None] * dark
    light = bulk_reflectance(sclera, wavelengths) * (1 - dark)
    return light if deep is None else light * (1 - deep[..., None] * _dimming(mu, wavelengths))


def _dimming(mu: Spectrum, wavelengths) -> Spectrum:
    """Share that an episcleral vessel takes from the light."""
    return (1 - veil(wavelengths, DEEP)) * -jnp.expm1(-2 * mu * DEEP_CHORD)


class ColourTable(eqx.Module):
    """Colour of the white as a function of the blood before it, for look-up.

    `values`: shape (nodes, 2, channels), the light without deep vessels and what full cover by them
    takes away; colours are linear in both covers, so the table is exact in them.
    """

    values: Float[Array, "nodes 2 channels"]

    def __call__(self, blood: Blood) -> Float[Array, "... channels"]:
        """Channels, shape (…, channels)."""
        return jnp.stack(self.channels(blood), axis=-1)

    def channels(self, blood: Blood) -> list[Float[Array, "..."]]:
        """As a call, each channel by itself."""
        depth, cover, deep = blood
        last = self.values.shape[0] - 1
        node = jnp.clip(jnp.log1p(depth / _KNEE) * (last / np.log1p(DEEPEST / _KNEE)), 0, last)
        # Computed once: XLA would work out the logarithm anew for each channel.
        node = materialise(node)
        i = jnp.minimum(jnp.asarray(node, jnp.int32), last - 1)
        u = node - i

        def of(column):
            first, second = (column.at[i + k].get(mode="promise_in_bounds") for k in (0, 1))
            found = first * (1 - u) + second * u
            return found if cover is None else column[0] + cover * (found - column[0])

        light, taken = self.values[:, 0].T, self.values[:, 1].T
        if deep is None:
            return [of(column) for column in light]
        return [of(column) - deep * of(under) for column, under in zip(light, taken, strict=True)]


def colour_table(sclera: Sclera, wavelengths: ArrayLike, weights: ArrayLike) -> ColourTable:
    """Table from blood to channels; `weights` (channels, wavelengths) take a reflectance there.

    With 64 nodes linear interpolation errs by 1.2e-4 of white at most in XYZ and in linear sRGB.
    """
    depth = _KNEE * jnp.expm1(jnp.linspace(0.0, np.log1p(DEEPEST / _KNEE), 64))
    light = sclera_reflectance(sclera, wavelengths, Blood(depth))
    taken = light * _dimming(absorption(sclera, wavelengths), wavelengths)
    return ColourTable(jnp.stack([light, taken], axis=1) @ jnp.asarray(weights, light.dtype).T)


def vein_depth_at(veins: VeinMap, azimuth: Float[Array, "*s"], across: Float[Array, "*s"]) -> Blood:
    """Bilinear look-up at a `vein_place`; held at the limbus and the equator."""
    textures = veins.depth, veins.cover, veins.deep
    return Blood(*(polar_bilinear(texture, azimuth, across) for texture in textures))


@pixelwise
def white_colour(
    pixels: ScleraPixels, eye: Eye, table: ColourTable, veins: VeinMap | None
) -> Float[Array, "channels pixels"]:
    """Channels of the sclera under an irradiance of one, all shares on the way out included."""
    blood = Blood(jnp.zeros(1, pixels.share.dtype))
    if veins is not None:
        # Each computed once: XLA would work out the place anew for each texture, and the blood for
        # each channel.
        place = materialise(GlobeSurface(eye).place(from_parts(pixels.point)))
        blood = materialise(vein_depth_at(veins, *place))
    share = (1 - pixels.reflectance) * pixels.share / jnp.pi
    return jnp.stack(table.channels(blood)) * share


@pixelwise
def white(
    pixels: tuple[ScleraPixels, Float[Array, "channels pixels"]],
    lights: Lights,
    eye: Eye | None = None,
    skin: Float[Array, " channels"] | None = None,
) -> Float[Array, "channels pixels"]:
    """Channels of the sclera from its `white_colour`: lit as a matt white, light wrapped a little
    round its edge. Of light that lids keep from it, some comes back from their `skin`.

    Approximation: the tear film takes its share on the way out and not on the way in.
    """
    sclera, colour = pixels
    towards, irradiance = lights.seen_from(sclera.point)
    cosine = jnp.asarray(sum(n * t for n, t in zip(sclera.normal, towards, strict=True)))
    power, tint = irradiance * wrapped(cosine, _BLEED), lights.factors
    if eye is None or eye.lids is None or skin is None:
        return colour * (tint.T @ power)
    open_to = let_in(eye, sclera.point, towards, lights.radius[:, None])
    back = BOUNCE * skin[:, None] * (tint.T @ (power * (1 - open_to)))
    return colour * (tint.T @ (power * open_to) + back)


@pixelwise
def mirrored(
    pixels: tuple[MirrorPixels, Float[Array, "channels pixels"] | None],
    lights: Lights | None,
    lamp: Float[Array, " channels"],
    eye: Eye | None = None,
    skin: Float[Array, " channels"] | None = None,
) -> Float[Array, "channels pixels"]:
    """Channels of images in the tear film: lamps as soft discs of their angular radius, the room of
    `room_at` (or `None`) as it is, and lids as `skin` of a radiance. `lamp` is a lamp of radiance 1
    in the picture's channels.
    """
    film, room = pixels
    total = jnp.zeros((lamp.size, film.reflectance.size), film.reflectance.dtype)
    if lights is not None:
        # Chords in place of angles: an arc cosine a pixel and light costs more than all the rest.
        towards, _ = lights.seen_from(film.point)
        x, y, z = (m - t for m, t in zip(film.mirror, towards, strict=True))
        chord = safe_sqrt(x * x + y * y + z * z)
        outer, inner = (2 * jnp.sin(share * lights.radius / 2)[:, None] for share in (1.1, 0.9))
        inside = jnp.clip((outer - chord) / (outer - inner), 0, 1)
        radiance = lights.irradiance / (jnp.pi * jnp.sin(lights.radius) ** 2)
        colour = radiance[:, None] * (lamp if lights.tint is None else lights.tint)
        total = total + colour.T @ inside
    total = total if room is None else total + room
    if eye is not None and eye.lids is not None and skin is not None:
        past, between = mirrored_past(eye, film.point, film.mirror)
        total = (total * past + skin[:, None] * (1 - past)) * between
    return total * film.reflectance


@pixelwise
def room_at(pixels: MirrorPixels, environment: Environment) -> Float[Array, "3 pixels"]:
    """Radiance of the environment in the direction that the tear film mirrors."""
    return environment.lookup(from_parts(pixels.mirror)).T
