"""Refractive indices of the iridal layers, scattering of the stroma's fibrils [LB06 Section 4]."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from irisjax._types import Numbers, Scalar, Spectrum
from irisjax.numerics.checks import is_known

FIBROBLAST_FRACTION = 1 / 3
"""Volume fraction of fibroblasts in the ABL [LB06 Section 4]."""

COLLAGEN_FRACTION = 0.9068996821171089
"""π/(4 sin(π/3)): fibrils of 30 nm radius in a hexagonal array of 60 nm pitch [LB06 Section 4]."""


def gladstone_dale(n_component: Numbers, fraction: Numbers, n_base: Numbers) -> Numbers:
    """Compute the index of a mixture, n_component·f + n_base·(1 − f)  [LB06 Eqs. 8, 9]."""
    return n_base + fraction * (n_component - n_base)


def scatterer_density(radius: Numbers, fraction: Numbers) -> Numbers:
    """Compute spheres per volume, N = f/(4πr³/3)  [LB06 Eq. 4] [F09 Eq. 11].

    A radius in mm gives mm⁻³.
    """
    return fraction / (4 / 3 * jnp.pi * radius**3)


def scattering_lb06(
    wavelengths: Spectrum, radius: Numbers, fraction: Numbers, n_collagen: Numbers, n_base: Numbers
) -> Spectrum:
    """Compute the scattering coefficient (mm⁻¹) of LB06, 8π³/(3N)·(m² − 1)²·λ⁻⁴  [LB06 Eq. 5]
    [F09 Eq. 12].

    N is in the denominator as in Strutt's formula of a gas of dipoles, where m² − 1 itself grows
    with N; for spheres of a given index see `scattering_rayleigh_spheres`. Wavelengths and radius
    are in nm.
    """
    density = scatterer_density(radius, fraction)  # nm⁻³
    contrast = (n_collagen - n_base) * (n_collagen + n_base) / n_base**2
    # In nm everywhere: λ⁻⁴/N then stays inside float32's range.
    return 8 * jnp.pi**3 / 3 * (contrast**2 / density) / wavelengths**4 * 1e6


def scattering_rayleigh_spheres(
    wavelengths: Spectrum, radius: Numbers, fraction: Numbers, n_collagen: Numbers, n_base: Numbers
) -> Spectrum:
    """Compute the scattering coefficient (mm⁻¹) of independent small spheres.

    It is 24π³ n_b⁴ f V λ⁻⁴ ((m²−1)/(m²+2))² [Bohren & Huffman 1983, Section 5.1], with vacuum
    wavelengths and the radius in nm.
    """
    volume = 4 / 3 * jnp.pi * radius**3
    contrast = (n_collagen - n_base) * (n_collagen + n_base) / (n_collagen**2 + 2 * n_base**2)
    return 24 * jnp.pi**3 * n_base**4 * fraction * volume * contrast**2 / wavelengths**4 * 1e6


Scattering = Literal["lb06", "rayleigh-spheres"]

SCATTERING = {"lb06": scattering_lb06, "rayleigh-spheres": scattering_rayleigh_spheres}
"""Scattering formulas by their names in `Iris.scattering`."""


class Order(eqx.Module):
    """Which layers may be optically denser than their neighbours, known before tracing.

    It determines which critical angles can exist, hence how many quadrature panels are compiled. If
    an index is traced, all of them can; towards the aqueous humour they always can.
    """

    abl_over_stroma: bool = eqx.field(static=True, default=True)
    stroma_over_abl: bool = eqx.field(static=True, default=True)
    stroma_over_ipe: bool = eqx.field(static=True, default=True)


class RefractiveIndices(eqx.Module):
    """Refractive indices of aqueous humour, ABL, stroma and pigment epithelium."""

    aqueous: Scalar
    abl: Scalar
    stroma: Scalar
    ipe: Scalar

    def order(self) -> Order:
        """Return the order of the layers; all is possible if an index is traced or an array."""
        layers = (self.abl, self.stroma, self.ipe)
        if not is_known(layers) or any(map(jnp.ndim, layers)):
            return Order()
        abl, stroma, ipe = map(float, layers)
        return Order(abl > stroma, stroma > abl, stroma > ipe)

    def same(self, other: "RefractiveIndices") -> Bool[Array, ""]:
        """Check that another set equals this one up to rounding; either may be traced."""
        result = jnp.asarray(True)
        for ours, theirs in zip(jax.tree.leaves(self), jax.tree.leaves(other), strict=True):
            tolerance = 4 * jnp.finfo(theirs.dtype).eps * theirs
            result = result & (jnp.abs(ours - theirs) <= tolerance)
        return result

    def agree(self, order: Order) -> Bool[Array, ""]:
        """Check that the (possibly traced) indices have no critical angle that `order` excludes."""
        result = jnp.asarray(True)
        if not order.abl_over_stroma:
            result = result & ~(self.abl > self.stroma)
        if not order.stroma_over_abl:
            result = result & ~(self.stroma > self.abl)
        if not order.stroma_over_ipe:
            result = result & ~(self.stroma > self.ipe)
        return result
