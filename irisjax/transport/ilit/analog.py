"""One event of a photon by the rules of ILIT  [LB06 Section 3, Fig. 4]."""

import jax.numpy as jnp

from irisjax.optics.fresnel import fresnel_at
from irisjax.transport import lanes
from irisjax.transport.lanes import LaneLayers, Photon, Scale, Words
from irisjax.transport.process import Ilit, attenuation, sample_entry


def ilit_event(
    photon: Photon, words: Words, layers: LaneLayers, scale: Scale, process: Ilit
) -> Photon:
    """One flight and the interface at its end, by the rules of ILIT  [LB06 Section 3, Fig. 4]."""
    place, mode = lanes.InLayer.of(photon.code, layers), (photon.code >> 4) & 3
    k = photon.code >> 7
    u_outcome, u_direction, azimuth = lanes.draws(words, scale)
    deflected = lanes.deflect(
        photon.direction, process.phase_function.sample_cosine(u_direction), azimuth
    )
    fresh = jnp.copysign(sample_entry(u_direction), photon.direction)
    direction = jnp.where(mode == lanes.SCATTERED, deflected, photon.direction)
    direction = jnp.where(mode == lanes.FRESH, fresh, direction)
    # Dividing by a traced 1 keeps the compiler from recomputing the direction in each fusion below.
    direction = jnp.clip(direction, -1.0, 1.0) / scale[2]
    down, mu = direction > 0.0, jnp.maximum(jnp.abs(direction), 1e-12)

    depth = place.pick(layers.abl, layers.stroma, layers.ipe)
    if process.rescatter == "to-interface":
        depth = jnp.where(mode == lanes.SCATTERED, 0.0, depth)
    p_event = attenuation(depth, mu)
    n_here = place.pick(layers.n_abl, layers.n_stroma, layers.n_ipe)
    n_ahead = place.beyond(down, layers)
    mirror = fresnel_at(mu, n_here, n_ahead)[0]
    # One uniform decides: first surface | absorbed | scattered | reflected | transmitted.
    albedo = place.pick(0.0, layers.albedo, 0.0)
    first = jnp.where(k == 0, layers.mirrored, 0.0)
    t_absorbed = first + (1.0 - first) * p_event * (1.0 - albedo)
    t_event = first + (1.0 - first) * p_event
    t_mirror = t_event + (1.0 - t_event) * mirror
    absorbed = u_outcome < t_absorbed
    if not process.perturb_on_reflection:
        n_behind = place.beyond(~down, layers)
        absorbed |= lanes.guided(mu, n_here, n_ahead, n_behind) & (albedo == 0.0)
    transmitted = (u_outcome >= t_mirror) & ~absorbed
    scattered = (u_outcome >= t_absorbed) & (u_outcome < t_event) & ~absorbed
    leaves = transmitted & place.leaves(down)
    fate = place.fate(leaves, absorbed, u_outcome < first)
    redrawn = transmitted | process.perturb_on_reflection
    mode = jnp.where(scattered, lanes.SCATTERED, jnp.where(redrawn, lanes.FRESH, lanes.KEPT))
    reverses = ~scattered & ~transmitted
    return Photon(direction, None, place.pack(fate, transmitted, down, mode, reverses, k + 1))
