"""Exact solver: integrates the process of `transport.process` over the cosine.

Because a ray's direction is redrawn on entering a layer, a layer is known by the chance that a
cosine-distributed entry leaves above or below. At each cosine the internal reflections are a
geometric series; scattering in the stroma closes in a linear system of the phase function's rank.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from irisjax._types import Spectrum
from irisjax.numerics import linear as elimination
from irisjax.numerics.quadrature import CosineRule, conserving, cosine_rule, gauss_legendre
from irisjax.optics.fresnel import critical_cosine_squared, fresnel, fresnel_at, refract, refracted
from irisjax.tissue.indices import Order, RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.process import Process, attenuation, entry_density, survival
from irisjax.transport.radiative import exact as depth_resolved
from irisjax.transport.solution import RESULTS, Absorbed, Solution
from irisjax.transport.solver import AbstractSolver

DIFFUSE = "diffuse"
"""Incidence from every direction alike (cosine-weighted hemisphere)."""


class Response(NamedTuple):
    """Fate of unit power entering a layer with a cosine-distributed direction, one value a
    wavelength.
    """

    reflected: Spectrum
    passed: Spectrum
    absorbed: Spectrum


class Exact(AbstractSolver):
    """Deterministic solver, accurate to rounding for the default irides.

    - `n_angles`: quadrature nodes a layer. 40: below 1e-10 relative; 28: 1e-8; 24: 3e-8; 16: 1e-5.
    - `n_depths`: polynomials in depth for depth-resolved transport (per panel).
    - `n_panels`: depth panels for depth-resolved transport; `None` takes as many as the optical
        depth asks for where it is known (1e-7), and one while tracing: enough for every iris of
        LB06; the status tells where it is not (1e-6).
    """

    n_angles: int = eqx.field(static=True, default=40)
    n_depths: int = eqx.field(static=True, default=8)
    n_panels: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        for name, low in (("n_angles", 4), ("n_depths", 2), ("n_panels", 1)):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, int) or value < low):
                raise ValueError(
                    f"Exact({name}={value!r}): must be a whole number of at least {low}"
                )

    def prepare(self, layers: Callable[[], Layers], process: Process) -> "Exact":
        """The solver with everything fixed that must be known before tracing."""
        if not process.depth_resolved or self.n_panels is not None:
            return self
        panels = depth_resolved.panels_for(layers(), self.n_depths)
        return Exact(n_angles=self.n_angles, n_depths=self.n_depths, n_panels=panels)

    def solve(
        self,
        layers: Layers,
        process: Process,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ):
        """See `AbstractSolver.solve`; no `key` and no `rays` are used."""
        if process.depth_resolved:
            return depth_resolved.solve(
                layers,
                cos_incidence,
                cos_exit,
                azimuth,
                n_angles=self.n_angles,
                n_depths=self.n_depths,
                n_panels=self.n_panels or 1,
            )
        return _solve_whole_layer(self, layers, process, cos_incidence, cos_exit)


def _solve_whole_layer(
    solver: Exact, layers: Layers, process: Process, cos_incidence, cos_exit
) -> Solution:
    from_above, from_below = abl_responses(
        layers.abl_absorption, layers.indices, layers.order, process, solver.n_angles
    )
    stroma, converged = stroma_response(layers, process, solver.n_angles)
    return combine(
        layers, from_above, from_below, stroma, converged, process, cos_incidence, cos_exit
    )


def combine(
    layers: Layers,
    from_above: Response,
    from_below: Response,
    stroma: Response,
    converged,
    process: Process,
    cos_incidence,
    cos_exit,
) -> Solution:
    """Put the layers together: light bounces between ABL and stroma until it leaves or is
    absorbed.
    """
    mirrored, entered = first_surface(cos_incidence, layers.indices, layers.extinction.dtype)
    # 1 − R_below R_stroma as a sum of losses, which does not cancel when little is lost.
    lost = (stroma.passed + stroma.absorbed) + stroma.reflected * (
        from_below.passed + from_below.absorbed
    )
    sealed = lost <= 0
    into_stroma = entered * from_above.passed / jnp.where(sealed, 1.0, lost)
    up = into_stroma * stroma.reflected
    brdf = None
    if cos_exit is not None:
        brdf = _exit_brdf(layers, process, cos_exit, entered, up, from_above, from_below)
    ones = jnp.ones_like(layers.extinction)
    valid = layers.valid()
    result = RESULTS.where(
        valid,
        RESULTS.where(converged, RESULTS.successful, RESULTS.not_converged),
        RESULTS.invalid_input,
    )
    return Solution(
        reflectance=entered * from_above.reflected + up * from_below.passed,
        mirrored=mirrored * ones,
        absorbed=Absorbed(
            abl=entered * from_above.absorbed + up * from_below.absorbed,
            stroma=into_stroma * stroma.absorbed,
            ipe=into_stroma * stroma.passed,
        ),
        standard_error=None,
        brdf=brdf,
        brdf_error=None,
        result=result,
    )


def first_surface(cos_incidence, indices: RefractiveIndices, dtype):
    """Share mirrored by and share passing the aqueous/ABL interface."""
    if isinstance(cos_incidence, str):
        x, w = gauss_legendre(48)
        mu, w = jnp.asarray(x, dtype), jnp.asarray(2 * x * w, dtype)
        mirrored, entered = fresnel_at(mu, indices.aqueous, indices.abl)
        return w @ mirrored, w @ entered
    return fresnel_at(jnp.asarray(cos_incidence, dtype), indices.aqueous, indices.abl)


def abl_responses(
    depth: Spectrum, n: RefractiveIndices, order: Order, process: Process, n_angles: int
):
    """Responses of the ABL to entry from above and from below  [LB06 Section 3.3, Eq. 3]."""
    critical = jnp.stack(
        [critical_cosine_squared(n.abl, n.aqueous), critical_cosine_squared(n.abl, n.stroma)]
    )
    rule = cosine_rule(
        critical,
        (order.abl_over_aqueous, order.abl_over_stroma),
        n_angles,
        leave_out_first=not process.perturb_on_reflection,
    )
    top = fresnel(rule.cosine, refracted(rule, 0, n.abl, n.aqueous), n.abl, n.aqueous)
    bottom = fresnel(rule.cosine, refracted(rule, 1, n.abl, n.stroma), n.abl, n.stroma)
    entry = _entry_weights(rule)
    t = survival(depth[:, None], rule.cosine)
    lost = attenuation(depth[:, None], rule.cosine)
    solve = _redrawn_layer if process.perturb_on_reflection else _specular_layer
    return tuple(
        Response(
            reflected=r,
            passed=p,
            # What is left out is guided: without pigment it never leaves, with the least it is
            # absorbed.
            absorbed=a + rule.omitted,
        )
        for r, p, a in (solve(entry, t, lost, top, bottom), solve(entry, t, lost, bottom, top))
    )


def _specular_layer(entry, t, lost, near, far):
    """Entry through `near`; a reflected ray keeps its cosine,
    so each node is a geometric series.
    """
    (f_near, t_near), (f_far, t_far) = near, far
    # 1 − t² F F' without cancellation.
    escape = lost * (1 + t) + t * t * (t_near + f_near * t_far)
    guided = escape <= 0
    weight = jnp.where(guided, 0.0, entry / jnp.where(guided, 1.0, escape))
    tw = t * weight
    reflected = (tw * t) @ (f_far * t_near)
    passed = tw @ t_far
    absorbed = (weight * lost * (1 + t * f_far) + jnp.where(guided, entry, 0.0)).sum(-1)
    return reflected, passed, absorbed


def _redrawn_layer(entry, t, lost, near, far):
    """Entry through `near`; a reflected ray is redrawn, so each crossing is alike."""
    (_, t_near), (f_far, t_far) = near, far
    crossing = entry * t
    passed, turned = crossing @ t_far, crossing @ f_far
    out = crossing @ t_near
    absorbed = lost @ entry
    # 1 − turned·back as a sum of losses.
    series = (passed + absorbed) + turned * (out + absorbed)
    series = jnp.where(series <= 0, 1.0, series)
    return turned * out / series, passed / series, absorbed * (1 + turned) / series


def stroma_response(
    layers: Layers, process: Process, n_angles: int
) -> tuple[Response, Bool[Array, ""]]:
    """Response of the stroma to entry from the ABL  [LB06 Section 3.4, Eqs. 6, 7], and whether it
    converged.
    """
    n, order = layers.indices, layers.order
    critical = jnp.stack(
        [critical_cosine_squared(n.stroma, n.abl), critical_cosine_squared(n.stroma, n.ipe)]
    )
    rule = conserving(
        cosine_rule(critical, (order.stroma_over_abl, order.stroma_over_ipe), n_angles)
    )
    f_top, t_top = fresnel(rule.cosine, refracted(rule, 0, n.stroma, n.abl), n.stroma, n.abl)
    f_bottom, t_bottom = fresnel(rule.cosine, refracted(rule, 1, n.stroma, n.ipe), n.stroma, n.ipe)
    depth = layers.extinction[:, None]
    t, c = survival(depth, rule.cosine), attenuation(depth, rule.cosine)
    entry = _entry_weights(rule) / jnp.where(
        rule.weight > 0, rule.weight, 1.0
    )  # a density, as S is
    tested = process.rescatter == "retest"
    w = rule.weight
    if process.perturb_on_reflection:
        # Crossings down and up from a unit entry; reflected rays start afresh from `entry`.
        again, rest = (2 * c, t) if tested else (jnp.zeros_like(c), jnp.ones_like(c))
        source, absorbed, converged = _scattered(process, rule, entry * c, again, rest, layers)
        scattered = source * t if tested else source
        direct = entry * t
        top_direct, top_scattered = direct @ (w * f_top), scattered @ (w * f_top)
        bottom_direct, bottom_scattered = direct @ (w * f_bottom), scattered @ (w * f_bottom)
        # (δ, υ): starts downwards and upwards. υ = δ b + (δ+υ) s_b; δ = 1 + υ a + (δ+υ) s_a.
        turn = (bottom_direct + bottom_scattered) / (1 - bottom_scattered)
        start = 1 / (1 - top_scattered - turn * (top_direct + top_scattered))
        up, both = turn * start, (1 + turn) * start
        return Response(
            reflected=up * (direct @ (w * t_top)) + both * (scattered @ (w * t_top)),
            passed=start * (direct @ (w * t_bottom)) + both * (scattered @ (w * t_bottom)),
            absorbed=both * absorbed,
        ), converged

    # 1 − t² F F', the geometric series of mirror reflections at one cosine.
    escape = c * (1 + t) + t * t * (t_top + f_top * t_bottom)
    guided = escape <= 0
    series = jnp.where(guided, 0.0, 1 / jnp.where(guided, 1.0, escape))
    series_t = series * t
    # Events per unit entering, and per unit scattered into both senses of travel; the rest of those
    # leaves.
    crossings = series + f_bottom * series_t
    first = entry * c * crossings
    if tested:
        again = c * (crossings + series + f_top * series_t)
        rest = series_t * (t * (t_top + f_top * t_bottom) + c * (t_top + t_bottom) / 2)
    else:
        again = c * (f_top * crossings + f_bottom * (series + f_top * series_t))
        rest = 1 - again / 2
    source, absorbed, converged = _scattered(process, rule, first, again, rest, layers)
    # A scattered ray arrives at an interface at once, or after one more survival.
    arrive = series_t if tested else series
    arrive_t = series_t * t if tested else series_t
    up = entry * f_bottom * (series_t * t) + source * (arrive + f_bottom * arrive_t)
    down = entry * series_t + source * (arrive + f_top * arrive_t)
    return Response(
        reflected=up @ (w * t_top),
        passed=down @ (w * t_bottom),
        absorbed=absorbed + (jnp.where(guided, 1.0, 0.0) * entry) @ w,
    ), converged


def _scattered(process: Process, rule: CosineRule, first, again, rest, layers: Layers):
    """Sources of all orders of scattering, S = ω (½ Σ w f + K f) with events f = first + again·S.

    `rest` is 1 − again/2, the share of scattered light that leaves without another event. The
    isotropic part is summed by hand, its series 1/(1 − ω(1 − rest)) written as losses: light that
    can hardly leave nor be absorbed is then still accounted for to the last digit.

    Returns S (λ, n), the share of the light absorbed by the events (λ,), and whether a series
    converged.
    """
    k, w = process.phase_function.redistribution(rule), rule.weight
    albedo, coalbedo = layers.albedo[:, None], layers.coalbedo
    if k.collect is None and process.rescatter == "to-interface":
        # Between scatters a ray must be mirrored by an interface, so the orders fall off fast: sum
        # them.
        def operator(s):
            f = again * s
            return albedo * (0.5 * (f @ w)[:, None] + k.anisotropic(f))

        entering = albedo * (0.5 * (first @ w)[:, None] + k.anisotropic(first))
        source, converged = jax.lax.custom_linear_solve(
            lambda s: s - operator(s),
            entering,
            _sum_orders,
            transpose_solve=_sum_orders,
            has_aux=True,
        )
        return source, coalbedo * ((first + again * source) @ w), converged

    # S = a·y + b, where y = Σ w f counts the events; both solve (1 − ω K again) S = ….
    right = (0.5 * albedo * jnp.ones_like(again), albedo * k.anisotropic(first))
    if k.collect is not None:
        # Rank one: a division.
        through = (again @ (k.collect * k.scatter)[0])[:, None]
        a, b = (s + albedo * k.anisotropic(again * s) / (1 - albedo * through) for s in right)
    else:
        identity = jnp.eye(w.shape[0], dtype=again.dtype)
        matrix = identity - albedo[..., None] * (k.scatter.T * again[:, None, :])
        a, b = jnp.moveaxis(jax.vmap(elimination.solve)(matrix, jnp.stack(right, axis=-1)), -1, 0)
    # Σ w again a = ω(1 − rest) − 2ω Σ w rest K(again a), for K neither adds nor takes energy.
    lost = coalbedo + layers.albedo * ((rest + 2 * rest * k.anisotropic(again * a)) @ w)
    events = (first + again * b) @ w
    trapped = lost <= 0
    total = jnp.where(trapped, 0.0, events / jnp.where(trapped, 1.0, lost))
    # Light that can neither leave nor be absorbed is counted as absorbed, the limit of least
    # absorption.
    return total[:, None] * a + b, jnp.where(trapped, events, coalbedo * total), jnp.asarray(True)


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

    state = (b, b, jnp.asarray(0))
    for _ in range(4):  # LB06's irides take eight: a few outside the loop fuse better
        state = step(state)
    total, order, _ = jax.lax.while_loop(lambda s: counts(s[1]) & (s[2] < 2000), step, state)
    return total, ~counts(order)


def _entry_weights(rule: CosineRule) -> Float[Array, " n"]:
    """Quadrature weights of the entry density, normalised so that nothing is lost on entering."""
    w = entry_density(rule.cosine) * rule.weight
    return w * ((1 - rule.omitted) / w.sum())


def _exit_brdf(layers: Layers, process: Process, cos_exit, entered, up, from_above, from_below):
    """BRDF f = (1 − F(μ_o)) · [ABL's upward radiance at the refracted cosine], shape (λ, exits).

    Light leaves the ABL at inside cosine μ with density 2μ·U(μ); refraction carries dμ into dμ_o by
    n² μ dμ = μ_o dμ_o, and f is the exit density over 2π μ_o.
    """
    n = layers.indices
    mu = refract(cos_exit, n.aqueous, n.abl)
    f_top, t_top = fresnel(mu, cos_exit, n.abl, n.aqueous)
    f_bottom, t_bottom = fresnel_at(mu, n.abl, n.stroma)
    depth = layers.abl_absorption[:, None]
    t, lost = survival(depth, mu), attenuation(depth, mu)
    if process.perturb_on_reflection:
        # Every upward crossing starts cosine-distributed, so the exit is the same for all of them.
        rate = (entered * from_above.reflected + up * from_below.passed)[:, None]
        everything = _transmitted_crossing(layers, process)
        leaving = t * rate / jnp.where(everything > 0, everything, 1.0)[:, None]
    else:
        escape = lost * (1 + t) + t * t * (t_top + f_top * t_bottom)
        leaving = (entered * t * t * f_bottom + up[:, None] * t) / jnp.where(
            escape > 0, escape, 1.0
        )
    ratio = n.aqueous / n.abl
    return leaving * t_top * ratio**2 / jnp.pi


def _transmitted_crossing(layers: Layers, process: Process) -> Spectrum:
    """Share of cosine-distributed upward crossings of the ABL that leave it."""
    n, order = layers.indices, layers.order
    critical = jnp.stack([critical_cosine_squared(n.abl, n.aqueous)])
    rule = cosine_rule(critical, (order.abl_over_aqueous,), 48)
    _, t_top = fresnel(rule.cosine, refracted(rule, 0, n.abl, n.aqueous), n.abl, n.aqueous)
    return survival(layers.abl_absorption[:, None], rule.cosine) @ (_entry_weights(rule) * t_top)
