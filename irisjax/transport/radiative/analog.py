"""One event of a photon in radiative transfer: a free path in depth, or an interface."""

import jax.numpy as jnp

from irisjax.optics.fresnel import fresnel_at, refract
from irisjax.transport import lanes
from irisjax.transport.lanes import LaneLayers, Photon, Scale, Words
from irisjax.transport.process import RadiativeTransfer, attenuation, sample_entry


def radiative_event(
    photon: Photon, words: Words, layers: LaneLayers, scale: Scale, process: RadiativeTransfer
) -> Photon:
    """One flight with a free path in depth; directions change at interfaces by Snell's law only."""
    place, mode = lanes.InLayer.of(photon.code, layers), (photon.code >> 4) & 3
    k = photon.code >> 7
    outside = k == 0
    u_outcome, u_direction, azimuth = lanes.draws(words, scale)
    law = process.phase_function if layers.phase is None else layers.phase
    deflected = lanes.deflect(photon.direction, law.sample_cosine(u_direction), azimuth)
    diffuse = layers.incidence < 0
    entering = jnp.where(diffuse, sample_entry(u_direction), layers.incidence)
    direction = jnp.where(
        outside, entering, jnp.where(mode == lanes.SCATTERED, deflected, photon.direction)
    )
    direction = jnp.clip(direction, -1.0, 1.0) / scale[2]
    down, mu = direction > 0.0, jnp.maximum(jnp.abs(direction), 1e-12)

    to_end = jnp.where(down, layers.stroma - photon.depth, photon.depth)
    path = jnp.where(outside, 0.0, place.pick(layers.abl, to_end, layers.ipe))
    p_event = attenuation(path, mu)
    n_inside = place.pick(layers.n_abl, layers.n_stroma, layers.n_ipe)
    n_here = jnp.where(outside, layers.n_aqueous, n_inside)
    n_ahead = jnp.where(outside, layers.n_abl, place.beyond(down, layers))
    mirror = fresnel_at(mu, n_here, n_ahead)[0]
    albedo = place.pick(0.0, layers.albedo, 0.0)
    t_absorbed = p_event * (1.0 - albedo)
    t_mirror = p_event + (1.0 - p_event) * mirror
    absorbed = u_outcome < t_absorbed
    n_behind, turns = place.beyond(~down, layers), place.pick(False, True, False)
    absorbed |= lanes.guided(mu, n_here, n_ahead, n_behind) & ~turns & ~outside
    transmitted = (u_outcome >= t_mirror) & ~absorbed
    scattered = (u_outcome >= t_absorbed) & (u_outcome < p_event) & ~absorbed
    # Given a scatter, (u − t_absorbed)/albedo is uniform below `p_event`, and places it.
    position = (u_outcome - t_absorbed) / jnp.maximum(albedo, 1e-30)
    travel = -jnp.log1p(-jnp.clip(position, 0.0, p_event)) * mu
    target = photon.depth + jnp.where(down, 1.0, -1.0) * jnp.minimum(travel, to_end)
    at_end = jnp.where(down, layers.stroma, 0.0)
    depth = place.pick(0.0, jnp.where(scattered, target, at_end), layers.stroma)
    depth = jnp.where(outside, 0.0, depth) / scale[2]
    refracted = jnp.sign(direction) * refract(mu, n_here, n_ahead)
    direction = jnp.where(transmitted, refracted, direction)
    leaves = transmitted & place.leaves(down) & ~outside
    fate = place.fate(leaves, absorbed, outside & ~transmitted)
    mode, reverses = jnp.where(scattered, lanes.SCATTERED, lanes.KEPT), ~scattered & ~transmitted
    code = place.pack(fate, transmitted & ~outside, down, mode, reverses, k + 1)
    return Photon(direction, depth, code)
