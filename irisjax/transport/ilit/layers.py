"""Responses of ILIT's layers to light whose direction was redrawn on entering them.

A layer is described by the probability that a cosine-distributed entry leaves above or below. At
each cosine the internal reflections are a geometric series; scattering in the stroma closes in a
linear system of the phase function's rank.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from irisjax._types import Spectrum
from irisjax.numerics import linear
from irisjax.numerics.quadrature import CosineRule, conserving, cosine_rule
from irisjax.numerics.roots import share_of
from irisjax.numerics.sharding import vary_alike
from irisjax.optics.fresnel import critical_cosine_squared, fresnel, refracted
from irisjax.tissue.indices import Order, RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.process import Ilit, attenuation, entry_density, reflections, survival


class LayerFates(NamedTuple):
    """Fate of unit power entering a layer with a cosine-distributed direction, one value a
    wavelength.
    """

    reflected: Spectrum
    passed: Spectrum
    absorbed: Spectrum


def abl_responses(
    depth: Spectrum, n: RefractiveIndices, order: Order, process: Ilit, n_angles: int
) -> tuple[LayerFates, LayerFates]:
    """Responses of the ABL to entry from above and from below  [LB06 Section 3.3, Eq. 3]."""
    critical = jnp.stack([critical_cosine_squared(n.abl, k) for k in (n.aqueous, n.stroma)])
    redrawn, possible = process.perturb_on_reflection, (True, order.abl_over_stroma)
    rule = cosine_rule(critical, possible, n_angles, leave_out_first=not redrawn)
    top = fresnel(rule.cosine, refracted(rule, 0, n.abl, n.aqueous), n.abl, n.aqueous)
    bottom = fresnel(rule.cosine, refracted(rule, 1, n.abl, n.stroma), n.abl, n.stroma)
    grid = depth[:, None], rule.cosine[None, :]
    light = entry_weights(rule), survival(*grid), attenuation(*grid)
    solve = _redrawn_layer if redrawn else _specular_layer

    def fates(near, far):
        reflected, passed, absorbed = solve(*light, near, far)
        # What is left out is guided: the least pigment absorbs it, without any it never leaves.
        return LayerFates(reflected, passed, absorbed + rule.omitted)

    return fates(top, bottom), fates(bottom, top)


def _specular_layer(entry, t, loss, near, far):
    """Entry through `near`; a reflected ray keeps its cosine: a geometric series at each node."""
    t_near, (f_far, t_far) = near[1], far
    series, guided = reflections(t, loss, *_rows((near, far)))
    weight = entry[None, :] * series
    tw = t * weight
    reflected = (tw * t) @ (f_far * t_near)
    passed = tw @ t_far
    guided = jnp.where(guided, entry[None, :], 0.0)
    absorbed = (weight * loss * (1 + t * f_far[None, :]) + guided).sum(-1)
    return reflected, passed, absorbed


def _redrawn_layer(entry, t, loss, near, far):
    """Entry through `near`; a reflected ray is redrawn, so each crossing is alike."""
    (_, t_near), (f_far, t_far) = near, far
    crossing = entry[None, :] * t
    transmission, reflection = crossing @ t_far, crossing @ f_far
    escape = crossing @ t_near
    absorbed = loss @ entry
    # 1 − reflection·back as a sum of losses.
    series = (transmission + absorbed) + reflection * (escape + absorbed)
    series = jnp.where(series <= 0, 1.0, series)
    return reflection * escape / series, transmission / series, absorbed * (1 + reflection) / series


def stroma_response(
    layers: Layers, process: Ilit, n_angles: int
) -> tuple[LayerFates, Bool[Array, ""]]:
    """Response of the stroma to entry from the ABL  [LB06 Section 3.4, Eqs. 6, 7], and whether it
    converged.
    """
    n, order = layers.indices, layers.order
    critical = jnp.stack([critical_cosine_squared(n.stroma, k) for k in (n.abl, n.ipe)])
    possible = (order.stroma_over_abl, order.stroma_over_ipe)
    rule = conserving(cosine_rule(critical, possible, n_angles))
    f_top, t_top = fresnel(rule.cosine, refracted(rule, 0, n.stroma, n.abl), n.stroma, n.abl)
    f_bottom, t_bottom = fresnel(rule.cosine, refracted(rule, 1, n.stroma, n.ipe), n.stroma, n.ipe)
    grid = layers.extinction[:, None], rule.cosine[None, :]
    t, c = survival(*grid), attenuation(*grid)
    # A density, as S is.
    entry = (entry_weights(rule) / jnp.where(rule.weight > 0, rule.weight, 1.0))[None, :]
    tested = process.rescatter == "retest"
    w = rule.weight
    if process.perturb_on_reflection:
        # Crossings down and up from a unit entry; reflected rays start afresh from `entry`.
        repeat, escape = (2 * c, t) if tested else (jnp.zeros_like(c), jnp.ones_like(c))
        source, absorbed, converged = _scattered(process, rule, entry * c, repeat, escape, layers)
        scattered = source * t if tested else source
        direct = entry * t
        top_direct, top_scattered = direct @ (w * f_top), scattered @ (w * f_top)
        bottom_direct, bottom_scattered = direct @ (w * f_bottom), scattered @ (w * f_bottom)
        # (δ, υ): starts downwards and upwards. υ = δ b + (δ+υ) s_b; δ = 1 + υ a + (δ+υ) s_a.
        turn = (bottom_direct + bottom_scattered) / (1 - bottom_scattered)
        start = 1 / (1 - top_scattered - turn * (top_direct + top_scattered))
        up, total = turn * start, (1 + turn) * start
        return LayerFates(
            reflected=up * (direct @ (w * t_top)) + total * (scattered @ (w * t_top)),
            passed=start * (direct @ (w * t_bottom)) + total * (scattered @ (w * t_bottom)),
            absorbed=total * absorbed,
        ), converged

    out_top, out_bottom = w * t_top, w * t_bottom
    (f_top, t_top), (f_bottom, t_bottom) = _rows(((f_top, t_top), (f_bottom, t_bottom)))
    series, guided = reflections(t, c, (f_top, t_top), (f_bottom, t_bottom))
    series_t = series * t
    # Events per unit entering, and per unit scattered into both senses of travel; the rest of those
    # leaves.
    crossings = series + f_bottom * series_t
    initial = entry * c * crossings
    if tested:
        repeat = c * (crossings + series + f_top * series_t)
        escape = series_t * (t * (t_top + f_top * t_bottom) + c * (t_top + t_bottom) / 2)
    else:
        repeat = c * (f_top * crossings + f_bottom * (series + f_top * series_t))
        escape = 1 - repeat / 2
    source, absorbed, converged = _scattered(process, rule, initial, repeat, escape, layers)
    # A scattered ray arrives at an interface at once, or after one more survival.
    arrive = series_t if tested else series
    arrive_t = series_t * t if tested else series_t
    up = entry * f_bottom * (series_t * t) + source * (arrive + f_bottom * arrive_t)
    down = entry * series_t + source * (arrive + f_top * arrive_t)
    return LayerFates(
        reflected=up @ out_top,
        passed=down @ out_bottom,
        absorbed=absorbed + (jnp.where(guided, 1.0, 0.0) * entry) @ w,
    ), converged


def loss_between(upper: LayerFates, lower: LayerFates) -> Spectrum:
    """1 − R R' between two layers as a sum of losses, which does not cancel; 1 if there is none."""
    loss = (lower.passed + lower.absorbed) + lower.reflected * (upper.passed + upper.absorbed)
    return jnp.where(loss <= 0, 1.0, loss)


def with_epithelium(
    stroma: LayerFates, layers: Layers, process: Ilit, n_angles: int
) -> tuple[LayerFates, Spectrum, Bool[Array, ""]]:
    """The stroma, which responds so to entry from above, together with a pigment epithelium that
    lets light through: fates of entry from above; the share of what passes the stroma for good that
    leaves behind; and whether the stroma's response from below converged.
    """
    n, order = layers.indices, layers.order
    assert layers.ipe_absorption is not None
    # The epithelium is a layer as the ABL is, turned over: it has aqueous humour on its far side.
    reverse = RefractiveIndices(n.aqueous, n.ipe, n.stroma, n.abl)
    _, epithelium = abl_responses(layers.ipe_absorption, reverse, Order(), process, n_angles)
    reverse_layers = dataclasses.replace(
        layers,
        indices=reverse,
        order=Order(stroma_over_abl=order.stroma_over_ipe, stroma_over_ipe=order.stroma_over_abl),
    )
    upwards, converged = stroma_response(reverse_layers, process, n_angles)
    entry = epithelium.passed + epithelium.absorbed
    arrival = stroma.passed / loss_between(upwards, epithelium)
    upward = arrival * epithelium.reflected
    fates = LayerFates(
        reflected=stroma.reflected + upward * upwards.passed,
        passed=arrival * entry,
        absorbed=stroma.absorbed + upward * upwards.absorbed,
    )
    return fates, share_of(epithelium.passed, entry, 0.0), converged


def _scattered(process: Ilit, rule: CosineRule, initial, repeat, escape, layers: Layers):
    """Sources of all orders of scattering S = ω (½ Σ w f + K f) and events f = initial + repeat·S.

    `escape` is 1 − repeat/2, the share of scattered light that leaves without another event. The
    isotropic part is summed by hand, its series 1/(1 − ω(1 − escape)) written as losses: light that
    can hardly leave nor be absorbed is then still accounted for to the last digit.

    Returns S (λ, n), the share of the light absorbed by the events (λ,), and whether a series
    converged.
    """
    k, w = process.phase_function.redistribution(rule), rule.weight
    albedo, coalbedo = layers.albedo[:, None], layers.coalbedo
    k, w, initial, repeat, escape, albedo, coalbedo = vary_alike(
        (k, w, initial, repeat, escape, albedo, coalbedo)
    )
    if k.collect is None and process.rescatter == "to-interface":
        # Between scatters a ray must be mirrored by an interface, so the orders fall off fast: sum
        # them.
        def operator(s):
            f = repeat * s
            return albedo * (0.5 * (f @ w)[:, None] + k.anisotropic(f))

        entering = albedo * (0.5 * (initial @ w)[:, None] + k.anisotropic(initial))
        source, converged = jax.lax.custom_linear_solve(
            lambda s: s - operator(s),
            entering,
            _sum_orders,
            transpose_solve=_sum_orders,
            has_aux=True,
        )
        return source, coalbedo * ((initial + repeat * source) @ w), converged

    # S = a·y + b, where y = Σ w f counts the events; both solve (1 − ω K repeat) S = ….
    right = (0.5 * albedo * jnp.ones_like(repeat), albedo * k.anisotropic(initial))
    if k.collect is not None:
        # Rank one: a division.
        through = (repeat @ (k.collect * k.scatter)[0])[:, None]
        a, b = (s + albedo * k.anisotropic(repeat * s) / (1 - albedo * through) for s in right)
    else:
        identity = jnp.eye(w.shape[0], dtype=repeat.dtype)[None]
        matrix = identity - albedo[..., None] * (k.scatter.T[None] * repeat[:, None, :])
        a, b = jnp.moveaxis(jax.vmap(linear.solve)(matrix, jnp.stack(right, axis=-1)), -1, 0)
    # Σ w repeat a = ω(1 − escape) − 2ω Σ w escape K(repeat a), for K neither adds nor takes energy.
    loss = coalbedo + layers.albedo * ((escape + 2 * escape * k.anisotropic(repeat * a)) @ w)
    events = (initial + repeat * b) @ w
    total = share_of(events, loss, 0.0)
    # Light that can neither leave nor be absorbed is counted as absorbed, the limit of least
    # absorption.
    return total[:, None] * a + b, jnp.where(loss <= 0, events, coalbedo * total), jnp.asarray(True)


def _sum_orders(operator, b):
    """Solve (1 − K) m = b for a contraction K by adding orders until they no longer count.

    Returns the sum and whether the last order was negligible.
    """
    negligible = jnp.finfo(b.dtype).eps * jnp.abs(b).max()

    def counts(order):
        return jnp.abs(order).max() > negligible

    def step(state):
        total, order, i = state
        order = order - operator(order)
        return total + order, order, i + 1

    state = (b, b, jnp.asarray(0, jnp.int32))
    for _ in range(4):  # LB06's irides take eight: a few outside the loop fuse better
        state = step(state)
    total, order, _ = jax.lax.while_loop(lambda s: counts(s[1]) & (s[2] < 2000), step, state)
    return total, ~counts(order)


def _rows(coefficients):
    """Each interface's coefficients along the last axis of two, behind the wavelengths'."""
    return jax.tree.map(lambda x: x[None, :], coefficients)


def entry_weights(rule: CosineRule) -> Float[Array, " n"]:
    """Quadrature weights of the entry density, normalised so that nothing is lost on entering."""
    w = entry_density(rule.cosine) * rule.weight
    return w * ((1 - rule.omitted) / w.sum())
