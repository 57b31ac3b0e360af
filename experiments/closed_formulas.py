"""Closed-form reflectance models, as solvers: what an inversion by the textbook would use.

They share ILIT's layers and optical depths, so the same parameters can be fitted with each and the
difference is the transport alone. What they do not send back they book as absorbed in the stroma.
"""

import abc

import equinox as eqx
import jax.numpy as jnp

from irisjax._types import PRNGKey, Spectrum
from irisjax.optics.fresnel import fresnel_at
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import ILIT_2006, Ilit
from irisjax.transport.solution import Flux, Solution, outcome
from irisjax.transport.solver import AbstractSolver, check_layers


class AbstractAnalytic(AbstractSolver):
    """A closed formula for the light that comes back from inside."""

    process: Ilit = eqx.field(default=ILIT_2006, init=False)

    @abc.abstractmethod
    def inner(self, layers: Layers) -> Spectrum:
        """Share of the light that entered which leaves again, one value a wavelength."""

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        """See `AbstractSolver.solve`; light is taken to fall along the normal."""
        check_layers(self, layers)
        if light.exits is not None:
            raise ValueError("closed formulas give no BRDF")
        mirror, passed = fresnel_at(jnp.ones(()), layers.indices.aqueous, layers.indices.abl)
        reflected = passed * self.inner(layers)
        mirrored = jnp.broadcast_to(mirror, reflected.shape)
        none = jnp.zeros_like(reflected)
        flux = Flux(reflected, mirrored, none, 1 - reflected - mirrored, none)
        return flux.solution(outcome(layers.valid()))


class BeerLambert(AbstractAnalytic):
    """R = ρ exp(−p (τ_ABL + τ_stroma)): a grey reflector of reflectance ρ behind the pigments.

    The path factor p and the melanin load, or ρ and the instrument's gain, cannot be told apart.
    """

    path_factor: float = eqx.field(static=True, default=2.0)
    reflector: float = eqx.field(static=True, default=0.05)

    def inner(self, layers: Layers) -> Spectrum:
        return self.reflector * jnp.exp(
            -self.path_factor * (layers.abl_absorption + layers.stroma_absorption)
        )


class KubelkaMunk(AbstractAnalytic):
    """An absorbing layer over a Kubelka–Munk stroma, K = 2 μ_a, S = ¾ μ_s, on black [Kubelka 1948].

    For diffuse light R = e^{−2·2τ_ABL} sinh(bSh) / (a sinh(bSh) + b cosh(bSh)), a = (S + K)/S,
    b = √(a² − 1).
    """

    def inner(self, layers: Layers) -> Spectrum:
        k, s = 2 * layers.stroma_absorption, 0.75 * layers.stroma_scattering
        root = jnp.sqrt(k * (k + 2 * s))  # bSh
        # tanh x / x by its own limit, so that nothing is 0/0 without pigment or scatterers.
        small = root < 1e-4
        x = jnp.where(small, 1.0, root)
        ratio = jnp.where(small, 1 - root**2 / 3, jnp.tanh(x) / x)
        return jnp.exp(-4 * layers.abl_absorption) * s * ratio / (1 + (s + k) * ratio)


class FirstOrder(AbstractAnalytic):
    """Light scattered once, half of it upwards, leaving along the mean slant m = 2 of diffuse
    light.

    R = e^{−(1+m)τ_ABL} (ω/2) (1 − e^{−(1+m)τ})/(1+m), τ the stroma's extinction.
    """

    def inner(self, layers: Layers) -> Spectrum:
        paths = 3.0
        back = -jnp.expm1(-paths * layers.extinction) / paths
        return jnp.exp(-paths * layers.abl_absorption) * 0.5 * layers.albedo * back
