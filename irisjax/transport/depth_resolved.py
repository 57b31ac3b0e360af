"""Depth-resolved transport: scalar radiative transfer in the same layers, solved as an integral equation.

Rayleigh's phase function has rank two (azimuth-averaged), so the unknowns are not radiances but a few
moments of them over angle, as functions of depth: polynomials of low order in depth (Galerkin). Given the
moments, each direction is a scalar problem, since interfaces keep a ray's Snell invariant: all mirror
images are one geometric series. The cost is linear in angles.  [Chandrasekhar 1960, Sections 10, 16]
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax.optics.fresnel import critical_cosine_squared, fresnel, refract
from irisjax.optics.quadrature import conserving, cosine_rule, gauss_legendre, refracted
from irisjax.tissue.layers import Layers
from irisjax.transport.process import attenuation, survival
from irisjax.transport.solution import RESULTS, Absorbed, Solution

# Thickest first panel that eight polynomials resolve to 1e-7, and growth from a panel to the next.
_FIRST_PANEL, _GROWTH = 4.0, 4.0


class Mode(NamedTuple):
    """One azimuthal order of Rayleigh's phase function: J(μ) = ω Σ_k strength_k f_k(μ) ∫ f_k I dμ'."""

    order: int
    parity: int
    strength: tuple[float, ...]

    def functions(self, mu):
        """f_k at cosines `mu` > 0, shape (rank, angles); at −μ they take the sign `parity`."""
        sine_squared = jnp.maximum(1 - mu * mu, 0.0)
        if self.order == 0:
            return jnp.stack([jnp.ones_like(mu), 1.5 * mu * mu - 0.5])
        if self.order == 1:
            return (mu * jnp.sqrt(sine_squared))[None]
        return sine_squared[None]


MODES = (Mode(0, 1, (0.5, 0.25)), Mode(1, -1, (0.375,)), Mode(2, 1, (0.09375,)))


class Directions(NamedTuple):
    """Directions in the stroma with what each meets at the interfaces, all of shape (angles,)."""

    cosine: jax.Array
    weight: jax.Array
    abl_cosine: jax.Array
    top: tuple[jax.Array, jax.Array]  # stroma/ABL
    surface: tuple[jax.Array, jax.Array]  # ABL/aqueous
    bottom: tuple[jax.Array, jax.Array]  # stroma/IPE


class Roof(NamedTuple):
    """The ABL seen from the stroma, or from the aqueous humour: shares of the flux that falls on it."""

    reflected: jax.Array
    passed: jax.Array
    absorbed: jax.Array


class Flux(NamedTuple):
    """Where the light of one wavelength goes."""

    reflectance: jax.Array
    mirrored: jax.Array
    abl: jax.Array
    stroma: jax.Array
    ipe: jax.Array
    brdf: jax.Array | None


def panels_for(extinction) -> int | None:
    """Depth panels needed for concrete optical depths; `None` for traced ones."""
    if isinstance(extinction, Tracer):
        return None
    thickest = float(np.nanmax(np.asarray(extinction), initial=0.0))
    if not np.isfinite(thickest):
        return 1
    panels = 1
    while thickest * _fractions(panels)[0] > _FIRST_PANEL:
        panels += 1
    return panels


def solve(layers: Layers, cos_incidence, cos_exit, azimuth, *, n_angles: int, n_depths: int, n_panels: int):
    """Radiative transfer in the iris; see `Solution`.

    The part of `reflectance` that is mirrored by the inner interfaces without scattering is not in the BRDF.
    """
    n, dtype = layers.indices, layers.extinction.dtype
    nodes = _nodes(layers, n_angles)
    if isinstance(cos_incidence, str):
        x, w = gauss_legendre(max(16, n_angles // 2))
        outside, power = jnp.asarray(x, dtype), jnp.asarray(2 * x * w, dtype)
    else:
        outside, power = jnp.atleast_1d(jnp.asarray(cos_incidence, dtype)), jnp.ones(1, dtype)
    beams = _entering(layers, outside)
    exits = None if cos_exit is None else _entering(layers, jnp.asarray(cos_exit, dtype))
    if exits is not None and azimuth is None:
        azimuth = jnp.zeros_like(exits.cosine)

    def one(abl, depth, albedo, coalbedo):
        return _one_wavelength(abl, depth, albedo, coalbedo, n, nodes, beams, power, exits, azimuth, n_depths, n_panels)

    flux = jax.vmap(one)(layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo)
    resolved = (layers.extinction * _fractions(n_panels)[0] <= 2 * _FIRST_PANEL).all()
    return Solution(
        reflectance=flux.reflectance,
        mirrored=flux.mirrored,
        absorbed=Absorbed(abl=flux.abl, stroma=flux.stroma, ipe=flux.ipe),
        standard_error=None,
        brdf=flux.brdf,
        brdf_error=None,
        result=RESULTS.where(
            layers.valid(),
            RESULTS.where(resolved, RESULTS.successful, RESULTS.under_resolved),
            RESULTS.invalid_input,
        ),
    )


def _nodes(layers: Layers, n_angles: int) -> Directions:
    n, order = layers.indices, layers.order
    neighbours = (n.aqueous, n.abl, n.ipe)
    rule = cosine_rule(
        jnp.stack([critical_cosine_squared(n.stroma, k) for k in neighbours]),
        (order.stroma_over_aqueous, order.stroma_over_abl, order.stroma_over_ipe),
        n_angles,
    )
    rule = conserving(rule)
    cosines = [refracted(rule, i, n.stroma, k) for i, k in enumerate(neighbours)]
    return _directions(layers, rule.cosine, rule.weight, *cosines)


def _entering(layers: Layers, outside) -> Directions:
    """Directions with given cosines in the aqueous humour; they carry no quadrature weight."""
    n = layers.indices
    abl, stroma = (refract(outside, n.aqueous, k) for k in (n.abl, n.stroma))
    ipe = refract(outside, n.aqueous, n.ipe)
    return _directions(layers, stroma, jnp.zeros_like(outside), outside, abl, ipe)


def _directions(layers: Layers, stroma, weight, aqueous, abl, ipe) -> Directions:
    n = layers.indices
    return Directions(
        # A beam that cannot enter has cosine 0 and no power; keep the exponentials finite.
        cosine=jnp.where(stroma > 0, stroma, 1.0),
        weight=weight,
        abl_cosine=jnp.where(abl > 0, abl, 1.0),
        top=fresnel(stroma, abl, n.stroma, n.abl),
        surface=fresnel(abl, aqueous, n.abl, n.aqueous),
        bottom=fresnel(stroma, ipe, n.stroma, n.ipe),
    )


def _roof(depth, d: Directions, *, from_stroma: bool) -> Roof:
    near, far = (d.top, d.surface) if from_stroma else (d.surface, d.top)
    t, lost = survival(depth, d.abl_cosine), attenuation(depth, d.abl_cosine)
    escape = lost * (1 + t) + t * t * (near[1] + near[0] * far[1])
    sealed = escape <= 0
    inside = jnp.where(sealed, 0.0, near[1] / jnp.where(sealed, 1.0, escape))
    return Roof(
        reflected=inside * t * t * far[0] * near[1],  # beyond the first interface's own reflectance
        passed=inside * t * far[1],
        absorbed=inside * lost * (1 + t * far[0]),
    )


def _one_wavelength(abl, depth, albedo, coalbedo, n, nodes, beams, power, exits, azimuth, n_depths, n_panels):
    slab = _Slab(depth, n_depths, n_panels)
    roof_in = _roof(abl, beams, from_stroma=False)
    entering = power * roof_in.passed
    beam = _bounded(slab, abl, beams)
    angle = _bounded(slab, abl, nodes)
    exit_ = None if exits is None else _bounded(slab, abl, exits)

    # What of the beam is absorbed or scattered on its way between the slab's ends.
    along = beam.series * attenuation(depth, beams.cosine) * (1 + beam.through * beam.floor)
    lost_beam = entering @ along
    moments = {}
    leaving_exit = 0.0
    for mode in MODES if exits is not None else MODES[:1]:
        strength = albedo * jnp.asarray(mode.strength, depth.dtype)
        f_nodes, f_beams = mode.functions(nodes.cosine), mode.functions(beams.cosine)
        operator = slab.moments(angle, nodes.weight * f_nodes[:, None] * f_nodes[None, :], mode.parity)
        driving = slab.driving(beam, f_beams * (entering / beams.cosine), mode.parity)
        size = operator.shape[0] * operator.shape[1]
        system = jnp.eye(size, dtype=depth.dtype) - operator.reshape(size, size) * jnp.repeat(
            strength, size // strength.size
        )
        right = driving.reshape(size)
        if mode.order == 0:
            system, right = _balanced(
                slab,
                system,
                right,
                strength,
                f_nodes,
                angle,
                nodes,
                _roof(abl, nodes, from_stroma=True),
                coalbedo,
                lost_beam,
            )
        moments[mode.order] = jnp.linalg.solve(system, right).reshape(driving.shape)
        if exits is not None and exit_ is not None:
            source = (strength[:, None] * mode.functions(exits.cosine)).T @ moments[mode.order]
            up_top, _ = slab.leaving(exit_, source, mode.parity)
            leaving_exit += up_top * jnp.cos(mode.order * azimuth) * (1 if mode.order == 0 else 2)

    mode = MODES[0]
    strength = albedo * jnp.asarray(mode.strength, depth.dtype)
    source = (strength[:, None] * mode.functions(nodes.cosine)).T @ moments[0]
    up_top, down_bottom = slab.leaving(angle, source, mode.parity)
    flux = nodes.weight * nodes.cosine
    roof_out = _roof(abl, nodes, from_stroma=True)
    roof_beam = _roof(abl, beams, from_stroma=True)
    # What no one scatters: the beam mirrored between the slab's ends.
    beam_down = entering * beam.series
    beam_bottom = beam_down * beam.through
    beam_top = beam_bottom * beams.bottom[0] * beam.through
    brdf = None
    if exits is not None:
        passing = _roof(abl, exits, from_stroma=True).passed
        brdf = leaving_exit * passing * (n.aqueous / n.stroma) ** 2 / (2 * jnp.pi)
    return Flux(
        reflectance=power @ roof_in.reflected + flux @ (up_top * roof_out.passed) + beam_top @ roof_beam.passed,
        mirrored=power @ beams.surface[0],
        abl=power @ roof_in.absorbed + flux @ (up_top * roof_out.absorbed) + beam_top @ roof_beam.absorbed,
        stroma=coalbedo * (slab.widths @ moments[0][0].reshape(n_panels, n_depths)[:, 0]),
        ipe=flux @ (down_bottom * nodes.bottom[1]) + beam_bottom @ beams.bottom[1],
        brdf=brdf,
    )


def _balanced(slab, system, right, strength, f, b, d: Directions, roof: Roof, coalbedo, lost_beam):
    """The system with one of its rows replaced by the sum of them that is the slab's balance of energy.

    Absorbed + leaving = lost by the beam. Mathematically nothing changes; in a thick slab that hardly
    absorbs, the rows' own sum would be lost in rounding.
    """
    top, bottom = slab.leaving_each(b, 1)
    flux = d.weight * d.cosine
    leaving = (flux * f) @ (top * (roof.passed + roof.absorbed) + bottom * d.bottom[1]).T
    row = (strength[:, None] * leaving).at[0, :: slab.n_depths].add(coalbedo * slab.widths).ravel()
    empty = slab.depth <= 0
    scale = 1 / jnp.where(empty, 1.0, slab.depth)
    which = (slab.n_panels - 1) * slab.n_depths
    return (
        system.at[which].set(jnp.where(empty, system[which], row * scale)),
        right.at[which].set(jnp.where(empty, right[which], lost_beam * scale)),
    )


class _Bounded(NamedTuple):
    """The slab's depth polynomials along some directions, with the mirror images of its two ends.

    `start` m_i = ∫φ_i e^{−xs} ds over a panel (panels, orders, angles); `emitted` x·m_i; `from_top`,
    `from_bottom` the survival from the slab's end to the panel (panels, angles).
    """

    start: jax.Array
    emitted: jax.Array
    from_top: jax.Array
    from_bottom: jax.Array
    through: jax.Array
    roof: jax.Array
    floor: jax.Array
    series: jax.Array
    cosine: jax.Array


def _bounded(slab: "_Slab", abl, d: Directions) -> _Bounded:
    roof = _roof(abl, d, from_stroma=True)
    through, lost = survival(slab.depth, d.cosine), attenuation(slab.depth, d.cosine)
    reflected = d.top[0] + roof.reflected
    escape = lost * (1 + through) + through * through * ((roof.passed + roof.absorbed) + reflected * d.bottom[1])
    sealed = escape <= 0
    x = slab.widths[:, None] / d.cosine
    start = _legendre_moments(x, 2 * slab.n_depths)
    return _Bounded(
        start=start,
        emitted=x[:, None, :] * start,
        from_top=jnp.exp(-slab.tops[:, None] / d.cosine),
        from_bottom=jnp.exp(-slab.below[:, None] / d.cosine),
        through=through,
        roof=reflected,
        floor=d.bottom[0],
        series=jnp.where(sealed, 0.0, 1 / jnp.where(sealed, 1.0, escape)),
        cosine=d.cosine,
    )


class _Slab:
    """The stroma cut into panels in depth, each with Legendre polynomials φ_i on [0, 1]."""

    def __init__(self, depth, n_depths: int, n_panels: int):
        fractions = _fractions(n_panels)
        edges = np.concatenate([[0.0], np.cumsum(fractions)])
        self.depth, self.n_depths, self.n_panels = depth, n_depths, n_panels
        self.widths = depth * jnp.asarray(fractions, depth.dtype)
        self.tops = depth * jnp.asarray(edges[:-1], depth.dtype)
        self.below = depth * jnp.asarray(1 - edges[1:], depth.dtype)
        self.edges = edges
        self.sign = jnp.asarray((-1.0) ** np.arange(n_depths), depth.dtype)
        self.norm = jnp.asarray(2.0 * np.arange(n_depths) + 1, depth.dtype)

    def _sources(self, b: _Bounded, parity: int):
        """Radiance that unit sources φ_j make: leaving at the slab's ends, and re-entering from them."""
        emitted = b.emitted[:, : self.n_depths]
        up = (parity * emitted * b.from_top[:, None]).reshape(-1, b.cosine.size)
        down = (emitted * self.sign[:, None] * b.from_bottom[:, None]).reshape(-1, b.cosine.size)
        downward = b.roof * b.series * (b.floor * b.through * down + up)
        upward = b.floor * (b.through * downward + down)
        return up, down, downward, upward

    def _tests(self, b: _Bounded):
        """Depth moments of radiance entering at the top and at the bottom, (panels·orders, angles)."""
        start = b.start[:, : self.n_depths] * self.norm[:, None]
        return (
            (start * b.from_top[:, None]).reshape(-1, b.cosine.size),
            (start * self.sign[:, None] * b.from_bottom[:, None]).reshape(-1, b.cosine.size),
        )

    def moments(self, b: _Bounded, weights, parity: int):
        """Moments of the radiance that unit sources make, (rank, panels·orders, rank, panels·orders)."""
        rank, size = weights.shape[0], self.n_panels * self.n_depths
        _, _, downward, upward = self._sources(b, parity)
        entering_top, entering_bottom = self._tests(b)
        out = jnp.einsum("lka,ia,ja->likj", weights, entering_top, downward)
        out += jnp.einsum("lka,ia,ja->likj", weights, parity * entering_bottom, upward)
        n, panels = self.n_depths, self.n_panels
        shape = (rank, panels, n, rank, panels, n)
        out = out.reshape(shape)
        overlap = jnp.asarray(_overlap(n), self.depth.dtype)
        # A panel on itself: ∫∫ φ_i(s) x e^{−x|s−s'|} φ_j(s') = 2 Σ_k overlap_ijk x m_k(x).
        own = jnp.einsum("lka,pca->lkpc", weights, b.emitted)
        own = 2 * jnp.einsum("ijc,lkpc->lipkj", overlap, own) * self.norm[:, None, None, None]
        for p in range(panels):
            out = out.at[:, p, :, :, p, :].add(own[:, :, p])
        # One panel on another: what leaves the one, thinned by the gap.
        start, emitted = b.start[:, :n] * self.norm[:, None], b.emitted[:, :n]
        for above in range(panels):
            for under in range(above + 1, panels):
                gap = jnp.exp(-self.depth * (self.edges[under] - self.edges[above + 1]) / b.cosine)
                out = out.at[:, under, :, :, above, :].add(
                    jnp.einsum("lka,ia,ja->likj", weights * gap, start[under], self.sign[:, None] * emitted[above])
                )
                out = out.at[:, above, :, :, under, :].add(
                    jnp.einsum("lka,ia,ja->likj", weights * gap, self.sign[:, None] * start[above], emitted[under])
                )
        return out.reshape(rank, size, rank, size)

    def driving(self, b: _Bounded, weights, parity: int):
        """Moments of beams of radiance `weights` (rank, beams) that enter at the top, (rank, panels·orders)."""
        entering_top, entering_bottom = self._tests(b)
        downward = weights * b.series
        upward = parity * downward * b.through * b.floor
        return downward @ entering_top.T + upward @ entering_bottom.T

    def leaving_each(self, b: _Bounded, parity: int):
        """Radiance that each unit source sends to the top and to the bottom, (panels·orders, angles)."""
        up, down, downward, upward = self._sources(b, parity)
        return up + b.through * upward, down + b.through * downward

    def leaving(self, b: _Bounded, source, parity: int):
        """Radiance that sources (angles, panels·orders) send to the top and to the bottom, (angles,)."""
        top, bottom = self.leaving_each(b, parity)
        return (source.T * top).sum(0), (source.T * bottom).sum(0)


def _fractions(n_panels: int) -> np.ndarray:
    widths = _GROWTH ** np.arange(n_panels)
    return widths / widths.sum()


def _legendre_moments(x, count: int):
    """m_k(x) = ∫₀¹ φ_k(s) e^{−xs} ds = (−1)^k e^{−x/2} i_k(x/2), shape (panels, count, angles).

    Ratios r_k = i_k/i_{k−1} of modified spherical Bessel functions, by the recurrence that is stable:
    downwards for thin panels, upwards for thick ones.
    """
    z = x / 2
    thick = z > 50.0
    z_thin, z_thick = jnp.where(thick, 1.0, z), jnp.where(thick, z, 100.0)
    top = count + 14
    ratio = z_thin / (top + jnp.sqrt((top + 0.5) ** 2 + z_thin * z_thin))
    thin = []
    for k in range(top - 1, 0, -1):
        ratio = z_thin / (2 * k + 1 + z_thin * ratio)
        if k < count:
            thin.append(ratio)
    moments = [_mean_survival(x)]
    # coth z is 1 to the last bit here.
    ratio = 1 - 1 / z_thick
    for k, r in enumerate(reversed(thin), start=1):
        moments.append(-moments[-1] * jnp.where(thick, ratio, r))
        ratio = 1 / ratio - (2 * k + 1) / z_thick
    return jnp.stack(moments, axis=-2)


def _mean_survival(x):
    """(1 − e^{−x})/x, with a gradient that is right at small x too."""
    small = x < 0.1
    y = jnp.where(small, x, 0.0)
    series = 1 - y / 2 * (1 - y / 3 * (1 - y / 4 * (1 - y / 5 * (1 - y / 6 * (1 - y / 7 * (1 - y / 8))))))
    z = jnp.where(small, 1.0, x)
    return jnp.where(small, series, -jnp.expm1(-z) / z)


@lru_cache(maxsize=16)
def _overlap(n: int) -> np.ndarray:
    """½∫[φ_i(s+r)φ_j(s) + φ_i(s)φ_j(s+r)] ds over 0 ≤ s ≤ 1−r as Σ_k overlap[i, j, k] φ_k(r)."""

    def shifted_legendre(count, s):
        return np.stack([np.polynomial.legendre.legval(2 * s - 1, np.eye(count)[k]) for k in range(count)])

    r, w_r = gauss_legendre(2 * n + 2)
    s, w_s = gauss_legendre(n + 2)
    phi_r = shifted_legendre(2 * n, r) * (2 * np.arange(2 * n) + 1)[:, None]
    out = np.zeros((n, n, 2 * n))
    for q in range(r.size):
        inner = s * (1 - r[q])
        product = np.einsum(
            "ia,ja,a->ij", shifted_legendre(n, inner + r[q]), shifted_legendre(n, inner), w_s * (1 - r[q])
        )
        out += 0.5 * (product + product.T)[..., None] * phi_r[:, q] * w_r[q]
    return out
