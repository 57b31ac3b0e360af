"""Lids in a picture: what a camera sees of them, how they are lit, and the light that they block.

Skin is matt with a rough sheen; a share of the light that it blocks reaches the eye from the skin.
Lids cast no shadows on themselves; at the fold and in the corners they are darkened by a formula.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.lids import DOME, EDGE_WIDTH, FACE, FENCE, Lids
from irisjax.anatomy.sclera import sclera_centre
from irisjax.numerics.checks import is_known
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.fusion import materialise
from irisjax.numerics.interpolation import bilinear, smoothstep
from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.strokes import stamp_strokes, stroke_sections
from irisjax.optics.conicoid import Parts, Vector, advance, parts
from irisjax.render.camera import AnySize, Camera
from irisjax.render.lights import Lights, wrapped_cosine
from irisjax.tissue.diffusion import (
    bloodless_absorption,
    diffuse_reflectance,
    melanosome_absorption,
)
from irisjax.tissue.pigments import extinction

LASH = 0.01
"""Reflectance of a lash."""
BOUNCE = 0.2
"""Share of the light blocked by lids that a white skin would send to the eye; the reflectance of
the skin multiplies it.
"""
_START_DEPTH = -3.0  # z at which the search along rays begins, in front of all but the brow, mm
_GREEN = 560.0  # wavelength, nm
_WRAP = 0.35  # cosine by which light reaches past the terminator of skin


Coordinates = tuple[Float[Array, "..."], ...]
"""x, y and z of points, or of directions that broadcast with them."""


class LidPixels(eqx.Module):
    """Pixels that see lids.

    Attributes:
        index: As of `IrisPixels`.
        point: Point of the lids, mm.
        normal: Unit normal there, with the relief of the skin.
        sight: Direction of the line of sight, into the eye.
        share: Share of the pixel, times the darkening in the fold and the corners.
        red: Redness of the skin, 0 to 1.
        wet: 1 on the inside of the margin and on the caruncle, 0 on skin.
    """

    index: Int[Array, " pixels"] | None
    point: Parts
    normal: Parts
    sight: Parts
    share: Float[Array, " pixels"]
    red: Float[Array, " pixels"]
    wet: Float[Array, " pixels"]


def skin_reflectance(
    wavelengths: ArrayLike, melanin: Scalar, blood: Scalar
) -> Float[Array, " wavelengths"]:
    """Compute the diffuse reflectance of skin  [Jacques 2013, Phys. Med. Biol. 58, R37].

    A dermis lies under an epidermis of 0.06 mm, which light crosses twice at 60°.

    Args:
        wavelengths: Wavelengths, nm.
        melanin: Volume share of melanosomes in the epidermis.
        blood: Volume share of blood in the dermis.
    """
    x = jnp.asarray(wavelengths, jnp.result_type(float))
    table = extinction(wavelengths)
    blood_absorption = 2.33 * (0.75 * table.oxyhemoglobin + 0.25 * table.deoxyhemoglobin)  # 150 g/l
    absorption = bloodless_absorption(wavelengths) + blood * blood_absorption
    dermis = diffuse_reflectance(absorption, 4.6 * (x / 500.0) ** -1.421)
    return dermis * jnp.exp(-4 * 0.06 * melanin * melanosome_absorption(wavelengths))


def lid_colours(
    lids: Lids, wavelengths: ArrayLike, weights: Float[Array, "channels bands"]
) -> Float[Array, "3 channels"]:
    """Compute the channels of pale skin, of flushed skin, and of the wet conjunctiva, which has no
    melanin.
    """
    flushed = skin_reflectance(wavelengths, 1.1 * lids.melanin, 3 * lids.blood)
    wet = skin_reflectance(wavelengths, 0 * lids.melanin, 2.0 * lids.blood)
    return jnp.stack([_pale_skin(lids, wavelengths), flushed, wet]) @ weights.T


def _pale_skin(lids: Lids, wavelengths: ArrayLike) -> Float[Array, " wavelengths"]:
    return skin_reflectance(wavelengths, lids.melanin, 0.7 * lids.blood)


def light_past_lids(visibility: Float[Array, "..."], lids: Lids) -> Float[Array, "..."]:
    """Compute the share of light that reaches the iris from its `lid_visibility`: what lids do not
    block, and what their skin sends on.

    Approximation: light from the skin keeps the direction of the light that is blocked, and its
    colour, by the skin's reflectance in the green. It is an eighth of what is blocked at most,
    and of usual skin a fifteenth.
    """
    return visibility + BOUNCE * _pale_skin(lids, np.array([_GREEN]))[0] * (1 - visibility)


def lash_coverage(eye: Eye, camera: Camera) -> Float[Array, " pixels"] | None:
    """Compute the share of each pixel of a camera that lashes cover; `None` without lashes.

    A camera that JAX traces must have a field 15 mm wide or more.
    """
    if eye.lids is None or eye.lids.lashes is None:
        return None
    lashes = eye.lids.lashes
    column, row = camera.pixel(lashes[..., :3], eye)
    radius = lashes[..., 3] * (camera.size[0] / camera.width)
    strokes = jnp.stack([column, row, radius], -1)
    longest, widest = jnp.abs(jnp.diff(strokes[..., :2], axis=1)).max(), 2 * radius.max()
    if not is_known(longest):
        longest, widest = camera.size[0] / 15, camera.size[0] / 100
    sections = stroke_sections(float(longest), float(widest))
    return stamp_strokes(strokes, camera.shape, *sections).ravel()


def meet_lids(eye: Eye, origin: Vector, direction: Vector) -> Float[Array, " pixels"]:
    """Compute the distance along rays to the lids, mm, by fixed-point steps in depth."""
    assert eye.lids is not None
    lids, centre = eye.lids, sclera_centre(eye)
    (x0, y0, z0), (dx, dy, dz) = parts(origin), parts(direction)
    slow = jnp.maximum(dz, 0.1)
    t = (_START_DEPTH - z0) / slow
    for k in range(8):
        x, y = x0 + t * dx, y0 + t * dy
        height = lids.skin_depth(x, y, centre) if k < 3 else lids.depth(x, y, centre)
        t = t + (height - z0 - t * dz) / slow
    return t


@pixelwise
def trace_lids(index: Array, eye: Eye, camera: Camera | AnySize) -> LidPixels:
    """Trace pixels of these numbers to the lids."""
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    origin, direction = camera.rays(index, eye)
    point = advance(origin, meet_lids(eye, origin, direction), direction)
    x, y, _ = parts(point)
    edge = lids.edge(x, y)
    u, v, w = lids.normal(x, y, centre)
    wet = smoothstep((0.6 * EDGE_WIDTH - edge.outside) / 0.5 + 0.5)
    red = 0.2 + 0.35 * jnp.exp(-jnp.maximum(edge.outside - 0.5, 0) / 2.5)
    red = red + 0.3 * jnp.exp(-jnp.abs(edge.along - 1) * 6)
    if lids.skin is not None:
        row, column = ((c / FACE + 1) * (lids.skin.shape[1] / 2) - 0.5 for c in (y, x))
        slope_x, slope_y, blotch = bilinear(lids.skin, row, column)
        u, v = u - (1 - wet) * slope_x * w, v - (1 - wet) * slope_y * w
        length = jnp.sqrt(u * u + v * v + w * w)
        u, v, w = u / length, v / length, w / length
        red = red + 0.3 * blotch
    arch = jnp.maximum(1 - edge.along * edge.along, 0.0)
    over = edge.upper - (1.1 + 3.0 * arch)
    dark = 0.5 * jnp.exp(-((over / 0.45) ** 2)) + 0.35 * smoothstep(-edge.outside / 2.0)
    normal = u, v, w
    return LidPixels(
        index, parts(point), normal, parts(direction), 1 - dark, jnp.clip(red, 0, 1), wet
    )


@pixelwise
def lid_base_colour(
    pixels: LidPixels, colours: Float[Array, "3 channels"]
) -> Float[Array, "channels pixels"]:
    """Compute the channels of the lids at pixels, in light of irradiance π."""
    pale, flushed, inner = colours[:, :, None]
    skin = pale + pixels.red * (flushed - pale)
    return skin + pixels.wet * (inner - skin)


@pixelwise
def lid_radiance(
    pixels_and_colour: tuple[LidPixels, Float[Array, "channels pixels"]],
    lights: Lights,
    lamp: Float[Array, " channels"],
) -> Float[Array, "channels pixels"]:
    """Compute the radiance of lids from their `lid_base_colour`: matt skin with a sheen, which is
    sharper where it is wet. `lamp` is a lamp of radiance 1 in the picture's channels.
    """
    pixels, colour = pixels_and_colour
    towards, irradiance = lights.incident_at(pixels.point)
    cosine = jnp.asarray(sum(n * t for n, t in zip(pixels.normal, towards, strict=True)))
    power, tint = irradiance * wrapped_cosine(cosine, _WRAP), lights.tint_factors
    halfway = [t - s for t, s in zip(towards, pixels.sight, strict=True)]
    length = safe_sqrt(jnp.asarray(sum(h * h for h in halfway)))
    upright = sum(h * n for h, n in zip(halfway, pixels.normal, strict=True)) / (length + 1e-6)
    upright = jnp.clip(upright, 1e-3, 1.0)
    cosine_to_halfway = length / 2  # cosine between the light and the half vector
    fresnel_factor = 0.028 + 0.972 * jnp.maximum(1 - cosine_to_halfway, 0.0) ** 5
    exponent = 14 + 200 * pixels.wet
    sheen = fresnel_factor * (exponent + 2) / 8 * jnp.exp(exponent * jnp.log(upright))
    sheen = sheen * jnp.maximum(cosine, 0.0)
    matt = colour * (tint.T @ power)
    return (matt + lamp[:, None] * (tint.T @ (irradiance * sheen))) * (pixels.share / jnp.pi)


def lid_visibility(
    eye: Eye, point: Coordinates, towards: Coordinates, spread: Float[Array, "..."] | float
) -> Float[Array, "..."]:
    """Compute the share of light from unit directions that passes lids and lashes to points of the
    eye. `spread` is the light's angular radius, radians, which softens their shadow.
    """
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    x, y, distance = _leave_sphere(point, towards, centre, DOME)
    edge = lids.edge(x, y)
    soft = 0.25 + distance * jnp.minimum(spread, 0.6)
    behind = smoothstep((point[2] + distance * towards[2] - centre + 4.0) / 2)
    visible = (1 - smoothstep(0.5 + edge.outside / (2 * soft))) * (1 - behind)
    return visible * (1 - 0.4 * smoothstep((edge.upper + 2.2) / 2.4))


def mirror_visibility(
    eye: Eye, point: Parts, towards: Parts
) -> tuple[Float[Array, " pixels"], Float[Array, " pixels"]]:
    """Compute the shares of what the tear film mirrors that lids, and that lashes, do not hide."""
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    x, y, distance = _leave_sphere(point, towards, centre, DOME)
    behind = smoothstep((point[2] + distance * towards[2] - centre + 4.0) / 2)
    lid_visible = (1 - smoothstep(0.5 + lids.edge(x, y).outside / 0.5)) * (1 - behind)
    if lids.fence is None:
        return lid_visible, jnp.ones_like(lid_visible)
    x, y, _ = _leave_sphere(point, towards, centre, FENCE)
    half = lids.fence.shape[0] / 2
    row, column = ((c / FACE + 1) * half - 0.5 for c in (y, x))
    return lid_visible, 1 - bilinear(lids.fence[None], row, column)[0]


def _leave_sphere(point: Coordinates, towards: Coordinates, centre: Scalar, radius: float):
    """Return x and y at which rays from within leave a sphere round the globe's middle, and their
    length, mm.
    """
    x, y, z = point
    u, v, w = towards
    z = z - centre
    along = x * u + y * v + z * w
    distance = safe_sqrt(jnp.maximum(along**2 - (x * x + y * y + z * z) + radius**2, 0.0)) - along
    return x + distance * u, y + distance * v, distance


def meniscus_normal(eye: Eye, point: Vector, normal: Vector) -> Vector:
    """Tilt the normals of the tear film along the lid margins, which it climbs within 0.5 mm."""
    assert eye.lids is not None
    point, normal = materialise((point, normal))
    x, y, _ = parts(point)
    edge = eye.lids.edge(x, y)
    above, below = (jnp.clip(1 + away / 0.5, 0.0, 1.0) ** 2 for away in (edge.upper, edge.lower))
    u, v, w = parts(normal)
    v, w = v + 1.2 * (below - above), w - 0.5 * (below + above)
    length = jnp.sqrt(u * u + v * v + w * w)
    return jnp.stack([u / length, v / length, w / length], -1)
