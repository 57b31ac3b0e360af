"""Lids in a picture: what a camera sees of them, how they are lit, and the light that they keep
from the eye.

Skin is matt under a rough sheen; what is blocked comes back as light from skin. Lids cast no
shadows on themselves but at the fold and in the corners, where they are darkened by their shape.
"""

import equinox as eqx
import jax.numpy as jnp
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
from irisjax.render.camera import Camera
from irisjax.render.lights import Lights, wrapped
from irisjax.tissue.diffusion import (
    bloodless_absorption,
    diffuse_reflectance,
    melanosome_absorption,
)
from irisjax.tissue.pigments import extinction

LASH = 0.015
"""Reflectance of a lash."""
BOUNCE = 0.2
"""Share of the light that lids keep from the eye which comes back from their skin."""
_FRONT = -3.0  # z in front of everything but the brow, mm
_BLEED = 0.35  # cosine by which light reaches past the terminator of skin


Coordinates = tuple[Float[Array, "..."], ...]
"""x, y and z of points, or of directions that broadcast with them."""


class LidPixels(eqx.Module):
    """Pixels that see lids.

    Attributes:
        index: As of `IrisPixels`.
        point: Point of the lids, mm.
        normal: Unit normal there, with the relief of the skin.
        sight: Direction of the line of sight, into the eye.
        share: Share of the pixel, less what the fold and the corners keep dark.
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
    """Diffuse reflectance of skin [Jacques 2013, Phys. Med. Biol. 58, R37]: a dermis of `blood`
    (share of volume) under an epidermis of 0.06 mm with `melanin` (share of melanosomes), which
    light crosses twice at 60°. Wavelengths in nm.
    """
    x = jnp.asarray(wavelengths, jnp.result_type(float))
    table = extinction(wavelengths)
    whole = 2.33 * (0.75 * table.oxyhemoglobin + 0.25 * table.deoxyhemoglobin)  # 150 g/l
    lost = bloodless_absorption(wavelengths) + blood * whole
    dermis = diffuse_reflectance(lost, 4.6 * (x / 500.0) ** -1.421)
    return dermis * jnp.exp(-4 * 0.06 * melanin * melanosome_absorption(wavelengths))


def lid_colours(
    lids: Lids, wavelengths: ArrayLike, weights: Float[Array, "channels bands"]
) -> Float[Array, "3 channels"]:
    """Channels of pale skin, of flushed skin, and of the wet conjunctiva, which has no melanin."""
    kinds = (
        (lids.melanin, 0.7 * lids.blood),
        (1.1 * lids.melanin, 3 * lids.blood),
        (0 * lids.melanin, 2.0 * lids.blood),
    )
    return jnp.stack([skin_reflectance(wavelengths, *kind) for kind in kinds]) @ weights.T


def lashes_seen(eye: Eye, camera: Camera) -> Float[Array, " pixels"] | None:
    """Share of each pixel of a camera that lashes cover.

    Where the camera is traced its field must be 15 mm wide or more.
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
    """Distance along rays to the lids, mm, by steps from height to height."""
    assert eye.lids is not None
    lids, centre = eye.lids, sclera_centre(eye)
    (x0, y0, z0), (dx, dy, dz) = parts(origin), parts(direction)
    slow = jnp.maximum(dz, 0.1)
    t = (_FRONT - z0) / slow
    for k in range(8):
        x, y = x0 + t * dx, y0 + t * dy
        height = lids.skin_depth(x, y, centre) if k < 3 else lids.depth(x, y, centre)
        t = t + (height - z0 - t * dz) / slow
    return t


@pixelwise
def lid_pixels(index: Array, eye: Eye, camera: Camera) -> LidPixels:
    """Pixels of these numbers as those that see lids."""
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    origin, direction = camera.towards(index, eye)
    point = advance(origin, meet_lids(eye, origin, direction), direction)
    x, y, _ = parts(point)
    at = lids.edge(x, y)
    u, v, w = lids.normal(x, y, centre)
    wet = smoothstep((0.6 * EDGE_WIDTH - at.outside) / 0.5 + 0.5)
    red = 0.2 + 0.35 * jnp.exp(-jnp.maximum(at.outside - 0.5, 0) / 2.5)
    red = red + 0.3 * jnp.exp(-jnp.abs(at.along - 1) * 6)
    if lids.skin is not None:
        row, column = ((c / FACE + 1) * (lids.skin.shape[1] / 2) - 0.5 for c in (y, x))
        slope_x, slope_y, blotch = bilinear(lids.skin, row, column)
        u, v = u - (1 - wet) * slope_x * w, v - (1 - wet) * slope_y * w
        length = jnp.sqrt(u * u + v * v + w * w)
        u, v, w = u / length, v / length, w / length
        red = red + 0.3 * blotch
    arch = jnp.maximum(1 - at.along * at.along, 0.0)
    over = at.upper - (1.1 + 3.0 * arch)
    dark = 0.5 * jnp.exp(-((over / 0.45) ** 2)) + 0.35 * smoothstep(-at.outside / 2.0)
    normal = u, v, w
    return LidPixels(
        index, parts(point), normal, parts(direction), 1 - dark, jnp.clip(red, 0, 1), wet
    )


@pixelwise
def lid_colour(
    pixels: LidPixels, colours: Float[Array, "3 channels"]
) -> Float[Array, "channels pixels"]:
    """Channels of the lids where pixels see them, in light of irradiance π."""
    pale, flushed, inner = colours[:, :, None]
    skin = pale + pixels.red * (flushed - pale)
    return skin + pixels.wet * (inner - skin)


@pixelwise
def lids_lit(
    pixels: tuple[LidPixels, Float[Array, "channels pixels"]],
    lights: Lights,
    lamp: Float[Array, " channels"],
) -> Float[Array, "channels pixels"]:
    """Radiance of lids, from their `lid_colour`: skin and its sheen, sharper where it is wet."""
    seen, colour = pixels
    towards, irradiance = lights.seen_from(seen.point)
    cosine = jnp.asarray(sum(n * t for n, t in zip(seen.normal, towards, strict=True)))
    power, tint = irradiance * wrapped(cosine, _BLEED), lights.factors
    half = [t - s for t, s in zip(towards, seen.sight, strict=True)]
    length = safe_sqrt(jnp.asarray(sum(h * h for h in half)))
    upright = sum(h * n for h, n in zip(half, seen.normal, strict=True)) / (length + 1e-6)
    upright = jnp.clip(upright, 1e-3, 1.0)
    facing = length / 2  # cosine between the light and the half vector
    mirror = 0.028 + 0.972 * jnp.maximum(1 - facing, 0.0) ** 5
    sharp = 14 + 200 * seen.wet
    sheen = mirror * (sharp + 2) / 8 * jnp.exp(sharp * jnp.log(upright)) * jnp.maximum(cosine, 0.0)
    matt = colour * (tint.T @ power)
    return (matt + lamp[:, None] * (tint.T @ (irradiance * sheen))) * (seen.share / jnp.pi)


def in_front(lights: Lights, lamp: Float[Array, " channels"]) -> Float[Array, " channels"]:
    """Irradiance on a surface that faces out of the face."""
    power = lights.irradiance * jnp.maximum(-lights.towards[:, 2], 0.0)
    return lamp * (lights.factors.T @ power)


def let_in(
    eye: Eye, point: Coordinates, towards: Coordinates, spread: Float[Array, "..."] | float
) -> Float[Array, "..."]:
    """Share of the light from unit directions that lids and lashes let through to points of the
    eye. `spread` is the half angle of the light, radians, which softens their shadow.
    """
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    x, y, reach = _leaving(point, towards, centre, DOME)
    at = lids.edge(x, y)
    soft = 0.25 + reach * jnp.minimum(spread, 0.6)
    behind = smoothstep((point[2] + reach * towards[2] - centre + 4.0) / 2)
    shown = (1 - smoothstep(0.5 + at.outside / (2 * soft))) * (1 - behind)
    return shown * (1 - 0.4 * smoothstep((at.upper + 2.2) / 2.4))


def mirrored_past(
    eye: Eye, point: Parts, towards: Parts
) -> tuple[Float[Array, " pixels"], Float[Array, " pixels"]]:
    """Shares of what the tear film mirrors that lids, and that lashes, do not hide."""
    lids, centre = eye.lids, sclera_centre(eye)
    assert lids is not None
    x, y, reach = _leaving(point, towards, centre, DOME)
    behind = smoothstep((point[2] + reach * towards[2] - centre + 4.0) / 2)
    past = (1 - smoothstep(0.5 + lids.edge(x, y).outside / 0.5)) * (1 - behind)
    if lids.fence is None:
        return past, jnp.ones_like(past)
    x, y, _ = _leaving(point, towards, centre, FENCE)
    half = lids.fence.shape[0] / 2
    row, column = ((c / FACE + 1) * half - 0.5 for c in (y, x))
    return past, 1 - bilinear(lids.fence[None], row, column)[0]


def _leaving(point: Coordinates, towards: Coordinates, centre: Scalar, radius: float):
    """x and y at which rays from within leave a sphere about the middle of the globe, and their
    length, mm."""
    x, y, z = point
    u, v, w = towards
    z = z - centre
    along = x * u + y * v + z * w
    reach = safe_sqrt(jnp.maximum(along**2 - (x * x + y * y + z * z) + radius**2, 0.0)) - along
    return x + reach * u, y + reach * v, reach


def meniscus(eye: Eye, point: Vector, normal: Vector) -> Vector:
    """Normals of the tear film, which climbs the margins in a strip of 0.5 mm."""
    assert eye.lids is not None
    point, normal = materialise((point, normal))
    x, y, _ = parts(point)
    at = eye.lids.edge(x, y)
    above, below = (jnp.clip(1 + away / 0.5, 0.0, 1.0) ** 2 for away in (at.upper, at.lower))
    u, v, w = parts(normal)
    v, w = v + 1.2 * (below - above), w - 0.5 * (below + above)
    length = jnp.sqrt(u * u + v * v + w * w)
    return jnp.stack([u / length, v / length, w / length], -1)
