"""Radiance of the outer surface of the eye: the sclera with its vessels, and images in the tear
film.

Vessels are textures of blood alone [F09 Section 6.5] in two layers: conjunctival vessels, sharp and
red, and episcleral vessels, blurred and veiled by the tissue over them.
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
from irisjax.render.lids import BOUNCE, lid_visibility, mirror_visibility
from irisjax.render.lights import Lights, wrapped_cosine
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
_TINTED = np.array([450.0, 550.0, 610.0])  # nm, middles of a picture's blue, green and red
_WRAP = 0.3  # the white is translucent: light reaches 17° past the terminator, set by eye


class Blood(NamedTuple):
    """Vessels over points of the sclera.

    Attributes:
        depth: Depth of blood in a conjunctival vessel along the normal, mm.
        cover: Share of the light, 0 to 1, that meets this vessel; `None` for all.
        deep: Share of the light that meets an episcleral vessel; `None` for none.
    """

    depth: Float[Array, "*s"]
    cover: Float[Array, "*s"] | None = None
    deep: Float[Array, "*s"] | None = None


def bulk_reflectance(sclera: Sclera, wavelengths: ArrayLike) -> Spectrum:
    """Compute the diffuse reflectance of the sclera without vessels, wavelengths in nm.

    A slab of fibrous tissue, sclera and conjunctiva, 1.1 mm in all, lies before a choroid of 5 %
    blood and 0.6 % melanosomes. It absorbs by its capillaries, 0.07 % of its volume, and by
    `sclera.yellowing` times the pigment of a bloodless tissue. The reflectance is about 0.6, near
    the 0.5 of models of the fundus [Delori & Pflibsen 1989, Appl. Opt. 28, 1061]. Thicknesses and
    shares are set by eye. `sclera.tint` multiplies it.
    """
    scattering, blood = fibrous_scattering(wavelengths), blood_absorption(sclera, wavelengths)
    choroid = 0.05 * blood + 0.006 * melanosome_absorption(wavelengths)
    behind = diffuse_reflectance(choroid, scattering, inside=0.0)
    absorption = sclera.yellowing * bloodless_absorption(wavelengths) + 7e-4 * blood
    reflectance = slab_reflectance(absorption, scattering, 1.1, behind)
    if sclera.tint is None:
        return reflectance
    return reflectance * jnp.interp(jnp.asarray(wavelengths), _TINTED, sclera.tint[::-1])


def veil(wavelengths: ArrayLike, thickness: float) -> Spectrum:
    """Compute the share of light that `thickness` mm of clear tissue above a vessel scatters back,
    wavelengths in nm. It makes vessels fainter, and bluer with depth.
    """
    scattering = fibrous_scattering(wavelengths)
    nothing = jnp.zeros_like(scattering)
    return slab_reflectance(nothing, scattering, thickness, nothing)


def blood_absorption(sclera: Sclera, wavelengths: ArrayLike) -> Spectrum:
    """Compute the Napierian absorption of the vessels' blood, 1/mm, wavelengths in nm."""
    table = extinction(wavelengths)
    share = sclera.saturation
    return sclera.hemoglobin * (share * table.oxyhemoglobin + (1 - share) * table.deoxyhemoglobin)


def sclera_reflectance(
    sclera: Sclera, wavelengths: ArrayLike, blood: Blood
) -> Float[Array, "... wavelengths"]:
    """Compute the diffuse reflectance of the sclera under vessels, shape (…, wavelengths).

    It is ρ (1 − c (1 − v₁)(1 − e^(−2μd))) (1 − e (1 − v₂)(1 − e^(−2μD))), with bulk reflectance ρ,
    covers c and e, veils v, and blood that light passes twice (Beer–Lambert); wavelengths in nm.
    Approximations: light that wanders sideways below a vessel narrower than its 0.5 mm path passes
    the blood once rather than twice, so real capillaries are up to half as dark; back-scatter of
    the blood itself (some 0.05 in the red) is left out.

    Raises:
        ValueError: A wavelength lies outside the tables of haemoglobin.
    """
    depth, cover, deep = blood
    mu = blood_absorption(sclera, wavelengths)
    absorbed = (1 - veil(wavelengths, SHALLOW)) * -jnp.expm1(-2 * mu * depth[..., None])
    absorbed = absorbed if cover is None else cover[..., None] * absorbed
    reflectance = bulk_reflectance(sclera, wavelengths) * (1 - absorbed)
    if deep is None:
        return reflectance
    return reflectance * (1 - deep[..., None] * _deep_vessel_loss(mu, wavelengths))


def _deep_vessel_loss(mu: Spectrum, wavelengths) -> Spectrum:
    """Compute the share of light that an episcleral vessel absorbs."""
    return (1 - veil(wavelengths, DEEP)) * -jnp.expm1(-2 * mu * DEEP_CHORD)


class ColourTable(eqx.Module):
    """Colour of the sclera, tabulated over the depth of blood before it.

    Colours are linear in the covers of both layers of vessels, in which the table is exact.

    Attributes:
        values: Colour without deep vessels, and the part of it that full cover by them absorbs.
    """

    values: Float[Array, "nodes 2 channels"]

    def __call__(self, blood: Blood) -> Float[Array, "... channels"]:
        """Interpolate the channels under vessels, shape (…, channels)."""
        return jnp.stack(self.channels(blood), axis=-1)

    def channels(self, blood: Blood) -> list[Float[Array, "..."]]:
        """Interpolate each channel, as an array of its own."""
        depth, cover, deep = blood
        last = self.values.shape[0] - 1
        node = jnp.clip(jnp.log1p(depth / _KNEE) * (last / np.log1p(DEEPEST / _KNEE)), 0, last)
        # Materialised: XLA would compute the logarithm again for each channel.
        node = materialise(node)
        i = jnp.minimum(jnp.asarray(node, jnp.int32), last - 1)
        u = node - i

        def interpolate(column):
            first, second = (column.at[i + k].get(mode="promise_in_bounds") for k in (0, 1))
            value = first * (1 - u) + second * u
            return value if cover is None else column[0] + cover * (value - column[0])

        clear, absorbed = self.values[:, 0].T, self.values[:, 1].T
        if deep is None:
            return [interpolate(column) for column in clear]
        pairs = zip(clear, absorbed, strict=True)
        return [interpolate(column) - deep * interpolate(loss) for column, loss in pairs]


def colour_table(sclera: Sclera, wavelengths: ArrayLike, weights: ArrayLike) -> ColourTable:
    """Tabulate channels over the depth of blood; `weights` (channels, wavelengths) turn a
    reflectance into channels.

    With 64 nodes linear interpolation errs by 1.2e-4 of white at most in XYZ and in linear sRGB.
    """
    depth = _KNEE * jnp.expm1(jnp.linspace(0.0, np.log1p(DEEPEST / _KNEE), 64))
    reflectance = sclera_reflectance(sclera, wavelengths, Blood(depth))
    loss = _deep_vessel_loss(blood_absorption(sclera, wavelengths), wavelengths)
    spectra = jnp.stack([reflectance, reflectance * loss], axis=1)
    return ColourTable(spectra @ jnp.asarray(weights, reflectance.dtype).T)


def sample_veins(veins: VeinMap, azimuth: Float[Array, "*s"], across: Float[Array, "*s"]) -> Blood:
    """Interpolate maps of vessels at a `vein_place`, constant beyond the limbus and the equator."""
    textures = veins.depth, veins.cover, veins.deep
    return Blood(*(polar_bilinear(texture, azimuth, across) for texture in textures))


@pixelwise
def sclera_base_colour(
    pixels: ScleraPixels, eye: Eye, table: ColourTable, veins: VeinMap | None
) -> Float[Array, "channels pixels"]:
    """Compute the radiance of the sclera under an irradiance of one, all shares on the way out
    included.
    """
    blood = Blood(jnp.zeros(1, pixels.share.dtype))
    if veins is not None:
        # Materialised: XLA would compute the place again for each texture, and the blood again for
        # each channel.
        place = materialise(GlobeSurface(eye).texture_coordinates(from_parts(pixels.point)))
        blood = materialise(sample_veins(veins, *place))
    share = (1 - pixels.reflectance) * pixels.share / jnp.pi
    return jnp.stack(table.channels(blood)) * share


@pixelwise
def sclera_radiance(
    pixels_and_colour: tuple[ScleraPixels, Float[Array, "channels pixels"]],
    lights: Lights,
    eye: Eye | None = None,
    skin: Float[Array, " channels"] | None = None,
) -> Float[Array, "channels pixels"]:
    """Compute the radiance of the sclera from its `sclera_base_colour`: a matt surface, on which
    light reaches a little past the terminator. A share of the light that lids block comes from
    their `skin`, a reflectance in the picture's channels.

    Approximation: the tear film reflects its share on the way out and not on the way in.
    """
    pixels, colour = pixels_and_colour
    towards, irradiance = lights.incident_at(pixels.point)
    cosine = jnp.asarray(sum(n * t for n, t in zip(pixels.normal, towards, strict=True)))
    power, tint = irradiance * wrapped_cosine(cosine, _WRAP), lights.tint_factors
    if eye is None or eye.lids is None or skin is None:
        return colour * (tint.T @ power)
    visibility = lid_visibility(eye, pixels.point, towards, lights.radius[:, None])
    bounced = BOUNCE * skin[:, None] * (tint.T @ (power * (1 - visibility)))
    return colour * (tint.T @ (power * visibility) + bounced)


@pixelwise
def tear_film_radiance(
    film_and_environment: tuple[MirrorPixels, Float[Array, "channels pixels"] | None],
    lights: Lights | None,
    lamp: Float[Array, " channels"],
    eye: Eye | None = None,
    skin: Float[Array, " channels"] | None = None,
) -> Float[Array, "channels pixels"]:
    """Compute the radiance of images in the tear film.

    Args:
        film_and_environment: The pixels, and `mirrored_environment` at them or `None`.
        lights: Lamps, mirrored as soft discs of their angular radius.
        lamp: A lamp of radiance 1 in the picture's channels.
        eye: The eye, whose lids and lashes are mirrored.
        skin: Radiance of the lids.
    """
    film, environment = film_and_environment
    total = jnp.zeros((lamp.size, film.reflectance.size), film.reflectance.dtype)
    if lights is not None:
        # Chords in place of angles: an arc cosine for each pixel and light would cost more than all
        # other operations.
        towards, _ = lights.incident_at(film.point)
        x, y, z = (m - t for m, t in zip(film.mirror, towards, strict=True))
        chord = safe_sqrt(x * x + y * y + z * z)
        outer, inner = (2 * jnp.sin(share * lights.radius / 2)[:, None] for share in (1.1, 0.9))
        inside = jnp.clip((outer - chord) / (outer - inner), 0, 1)
        radiance = lights.irradiance / (jnp.pi * jnp.sin(lights.radius) ** 2)
        colour = radiance[:, None] * (lamp if lights.tint is None else lights.tint)
        total = total + colour.T @ inside
    total = total if environment is None else total + environment
    if eye is not None and eye.lids is not None and skin is not None:
        past_lids, past_lashes = mirror_visibility(eye, film.point, film.mirror)
        total = (total * past_lids + skin[:, None] * (1 - past_lids)) * past_lashes
    return total * film.reflectance


@pixelwise
def mirrored_environment(
    pixels: MirrorPixels, environment: Environment
) -> Float[Array, "3 pixels"]:
    """Look up the environment's radiance in the directions that the tear film mirrors."""
    return environment.lookup(from_parts(pixels.mirror)).T
