"""One event of a photon in radiative transfer: a free path in depth, or an interface."""

import jax.numpy as jnp

from irisjax.optics.fresnel import fresnel_at, refract
from irisjax.transport.lanes import (
    ABL,
    IPE,
    KEPT,
    MIRRORED,
    REFLECTED,
    SCATTERED,
    STROMA,
    LaneLayers,
    Photon,
    beyond,
    deflect,
    draws,
    guided,
    pack,
)
from irisjax.transport.process import RadiativeTransfer, attenuation, sample_entry


def event(photon: Photon, words, layers: LaneLayers, scale, process: RadiativeTransfer) -> Photon:
    """One flight with a free path in depth; directions change at interfaces by Snell's law only."""
    in_abl, mode, k = (photon.code & 8) > 0, (photon.code >> 4) & 3, photon.code >> 6
    outside = k == 0
    u_outcome, u_direction, azimuth = draws(words, scale)
    law = process.phase_function if layers.phase is None else layers.phase
    turned = deflect(photon.direction, law.sample_cosine(u_direction), azimuth)
    entering = jnp.where(
        layers.incidence < 0, sample_entry(u_direction), layers.incidence
    )  # < 0: diffuse
    direction = jnp.where(outside, entering, jnp.where(mode == SCATTERED, turned, photon.direction))
    direction = jnp.clip(direction, -1.0, 1.0) / scale[2]
    down, mu = direction > 0.0, jnp.maximum(jnp.abs(direction), 1e-12)

    to_end = jnp.where(down, layers.stroma - photon.depth, photon.depth)
    path = jnp.where(outside, 0.0, jnp.where(in_abl, layers.abl, to_end))
    p_event = attenuation(path, mu)
    n_here = jnp.where(outside, layers.n_aqueous, jnp.where(in_abl, layers.n_abl, layers.n_stroma))
    n_ahead = jnp.where(outside, layers.n_abl, beyond(in_abl, down, layers))
    mirror = fresnel_at(mu, n_here, n_ahead)[0]
    albedo = jnp.where(in_abl, 0.0, layers.albedo)
    t_absorbed = p_event * (1.0 - albedo)
    t_mirror = p_event + (1.0 - p_event) * mirror
    absorbed = u_outcome < t_absorbed
    ends = guided(mu, n_here, n_ahead, beyond(in_abl, ~down, layers)) & in_abl & ~outside
    absorbed |= ends
    transmitted = (u_outcome >= t_mirror) & ~absorbed
    scattered = (u_outcome >= t_absorbed) & (u_outcome < p_event) & ~absorbed
    # Given a scatter, (u − t_absorbed)/albedo is uniform below `p_event`: the same
    # number places it.
    placed = (u_outcome - t_absorbed) / jnp.maximum(albedo, 1e-30)
    flown = -jnp.log1p(-jnp.clip(placed, 0.0, p_event)) * mu
    moved = photon.depth + jnp.where(down, 1.0, -1.0) * jnp.minimum(flown, to_end)
    at_end = jnp.where(down, layers.stroma, 0.0)
    depth = jnp.where(in_abl | outside, 0.0, jnp.where(scattered, moved, at_end)) / scale[2]
    direction = jnp.where(
        transmitted, jnp.sign(direction) * refract(mu, n_here, n_ahead), direction
    )
    leaves = transmitted & (in_abl ^ down) & ~outside
    fate = jnp.where(
        leaves,
        jnp.where(in_abl, REFLECTED, IPE),
        jnp.where(absorbed, jnp.where(in_abl, ABL, STROMA), 0),
    )
    fate = jnp.where(outside & ~transmitted, MIRRORED, fate)
    crosses = transmitted & ~outside
    mode = jnp.where(scattered, SCATTERED, KEPT)
    return Photon(
        direction, depth, pack(fate, in_abl ^ crosses, mode, ~scattered & ~transmitted, k + 1)
    )
