"""One event of a photon by the rules of ILIT, as LB06 tells it."""

import jax.numpy as jnp

from irisjax.optics.fresnel import fresnel_at
from irisjax.transport.lanes import (
    ABL,
    FRESH,
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
from irisjax.transport.process import Ilit, attenuation, sample_entry


def event(photon: Photon, words, layers: LaneLayers, scale, process: Ilit) -> Photon:
    """One flight and the interface at its end, by the rules of ILIT  [LB06 Section 3, Fig. 4]."""
    in_abl, mode, k = (photon.code & 8) > 0, (photon.code >> 4) & 3, photon.code >> 6
    u_outcome, u_direction, azimuth = draws(words, scale)
    turned = deflect(photon.direction, process.phase_function.sample_cosine(u_direction), azimuth)
    fresh = jnp.copysign(sample_entry(u_direction), photon.direction)
    direction = jnp.where(
        mode == FRESH, fresh, jnp.where(mode == SCATTERED, turned, photon.direction)
    )
    # (dividing by a traced 1 keeps the compiler from recomputing the direction in each fusion
    # below)
    direction = jnp.clip(direction, -1.0, 1.0) / scale[2]
    down, mu = direction > 0.0, jnp.maximum(jnp.abs(direction), 1e-12)

    depth = jnp.where(in_abl, layers.abl, layers.stroma)
    if process.rescatter == "to-interface":
        depth = jnp.where(mode == SCATTERED, 0.0, depth)
    p_event = attenuation(depth, mu)
    n_here = jnp.where(in_abl, layers.n_abl, layers.n_stroma)
    n_ahead = beyond(in_abl, down, layers)
    mirror = fresnel_at(mu, n_here, n_ahead)[0]
    # One uniform decides: first surface | absorbed | scattered | reflected | transmitted.
    albedo = jnp.where(in_abl, 0.0, layers.albedo)
    first = jnp.where(k == 0, layers.mirrored, 0.0)
    t_absorbed = first + (1.0 - first) * p_event * (1.0 - albedo)
    t_event = first + (1.0 - first) * p_event
    t_mirror = t_event + (1.0 - t_event) * mirror
    absorbed = u_outcome < t_absorbed
    if not process.perturb_on_reflection:
        absorbed |= guided(mu, n_here, n_ahead, beyond(in_abl, ~down, layers)) & (albedo == 0.0)
    transmitted = (u_outcome >= t_mirror) & ~absorbed
    scattered = (u_outcome >= t_absorbed) & (u_outcome < t_event) & ~absorbed
    leaves = transmitted & (in_abl ^ down)  # upwards out of the ABL or downwards out of the stroma
    fate = jnp.where(
        leaves,
        jnp.where(in_abl, REFLECTED, IPE),
        jnp.where(absorbed, jnp.where(in_abl, ABL, STROMA), 0),
    )
    fate = jnp.where(u_outcome < first, MIRRORED, fate)
    redrawn = transmitted | process.perturb_on_reflection
    mode = jnp.where(scattered, SCATTERED, jnp.where(redrawn, FRESH, KEPT))
    return Photon(
        direction, None, pack(fate, in_abl ^ transmitted, mode, ~scattered & ~transmitted, k + 1)
    )
