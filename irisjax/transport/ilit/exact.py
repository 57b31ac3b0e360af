"""ILIT integrated over the cosine, to rounding.

Because a ray's direction is redrawn on entering a layer, the layers' responses are numbers a
wavelength (`ilit.layers`), and light that bounces between them is a geometric series.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from irisjax._types import PRNGKey, Spectrum
from irisjax.numerics.checks import check_whole
from irisjax.numerics.precision import full_precision
from irisjax.numerics.quadrature import cosine_rule
from irisjax.optics.fresnel import critical_cosine_squared, fresnel, fresnel_at, refract, refracted
from irisjax.tissue.layers import Layers
from irisjax.transport.ilit.layers import (
    LayerFates,
    abl_responses,
    entry_weights,
    loss_between,
    stroma_response,
    with_epithelium,
)
from irisjax.transport.light import Light, first_surface
from irisjax.transport.process import ILIT_2006, Ilit, attenuation, reflections, survival
from irisjax.transport.solution import RESULTS, Flux, Solution, outcome
from irisjax.transport.solver import AbstractSolver, check_layers, check_process


class IlitExact(AbstractSolver):
    """Deterministic solver of ILIT, accurate to rounding for the default irides.

    Attributes:
        n_angles: Quadrature nodes a layer. 40: below 1e-10 relative; 28: 1e-8; 24: 3e-8; 16: 1e-5.
        process: `ILIT_2006`, `ILIT_CORRECTED` or an `Ilit` of your own.
    """

    n_angles: int = eqx.field(static=True, default=40)
    process: Ilit = eqx.field(default=ILIT_2006, kw_only=True)

    def __check_init__(self) -> None:
        check_whole("n_angles", self.n_angles, 4)
        check_process(self, Ilit)

    @full_precision
    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        check_layers(self, layers)
        from_above, from_below = abl_responses(
            layers.abl_absorption, layers.indices, layers.order, self.process, self.n_angles
        )
        stroma, converged = stroma_response(layers, self.process, self.n_angles)
        through = None
        if layers.ipe_absorption is not None:
            stroma, through, also = with_epithelium(stroma, layers, self.process, self.n_angles)
            converged = converged & also
        fates, check = (from_above, from_below, stroma), (converged, RESULTS.not_converged)
        return combine(layers, light, self.process, fates, check, through)


def combine(
    layers: Layers,
    light: Light,
    process: Ilit,
    fates: tuple[LayerFates, LayerFates, LayerFates],
    check: tuple[Bool[Array, ""], RESULTS],
    through: Spectrum | None = None,
) -> Solution:
    """Put the layers together: light bounces between ABL and stroma until it leaves or is
    absorbed.

    `fates` are of light from above and from below in the ABL, and of light in the stroma; `check`
    as in `outcome`; `through`: the share of what the stroma passes that leaves behind, if any does.
    """
    from_above, from_below, stroma = fates
    mirrored, entered = first_surface(light, layers.indices, layers.extinction.dtype)
    into_stroma = entered * from_above.passed / loss_between(from_below, stroma)
    up = into_stroma * stroma.reflected
    brdf = None
    if light.exits is not None:
        brdf = _exit_brdf(layers, process, light.exits.cosine, entered, up, from_above, from_below)
    return Flux(
        reflectance=entered * from_above.reflected + up * from_below.passed,
        mirrored=mirrored * jnp.ones_like(layers.extinction),
        abl=entered * from_above.absorbed + up * from_below.absorbed,
        stroma=into_stroma * stroma.absorbed,
        ipe=into_stroma * stroma.passed,
        brdf=brdf,
        behind=None if through is None else into_stroma * stroma.passed * through,
    ).solution(outcome(layers.valid(), check))


def _exit_brdf(layers: Layers, process: Ilit, cos_exit, entered, up, from_above, from_below):
    """BRDF f = (1 − F(μ_o)) · [ABL's upward radiance at the refracted cosine], shape (λ, exits).

    Light leaves the ABL at inside cosine μ with density 2μ·U(μ); refraction carries dμ into dμ_o by
    n² μ dμ = μ_o dμ_o, and f is the exit density over 2π μ_o.
    """
    n = layers.indices
    mu = refract(cos_exit, n.aqueous, n.abl)
    f_top, t_top = fresnel(mu, cos_exit, n.abl, n.aqueous)
    bottom = fresnel_at(mu, n.abl, n.stroma)
    mu, f_top, t_top, *bottom = (x[None, :] for x in (mu, f_top, t_top, *bottom))
    depth = layers.abl_absorption[:, None]
    t, loss = survival(depth, mu), attenuation(depth, mu)
    if process.perturb_on_reflection:
        # Every upward crossing starts cosine-distributed, so the exit is the same for all of them.
        rate = (entered * from_above.reflected + up * from_below.passed)[:, None]
        everything = _transmitted_crossing(layers)
        leaving = t * rate / jnp.where(everything > 0, everything, 1.0)[:, None]
    else:
        series, _ = reflections(t, loss, (f_top, t_top), (bottom[0], bottom[1]))
        leaving = (entered * t * t * bottom[0] + up[:, None] * t) * series
    ratio = n.aqueous / n.abl
    return leaving * t_top * ratio**2 / jnp.pi


def _transmitted_crossing(layers: Layers):
    """Share of cosine-distributed upward crossings of the ABL that leave it."""
    n = layers.indices
    critical = jnp.stack([critical_cosine_squared(n.abl, n.aqueous)])
    rule = cosine_rule(critical, (True,), 48)
    _, t_top = fresnel(rule.cosine, refracted(rule, 0, n.abl, n.aqueous), n.abl, n.aqueous)
    survived = survival(layers.abl_absorption[:, None], rule.cosine[None, :])
    return survived @ (entry_weights(rule) * t_top)
