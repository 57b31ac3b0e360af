"""The optical description that transport works on: the layers between the chambers of the eye."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from irisjax._types import Spectrum
from irisjax.numerics.roots import share_of
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.indices import Order, RefractiveIndices


class Layers(eqx.Module):
    """An absorbing ABL over an absorbing and scattering stroma over the pigment epithelium (IPE).

    The fields are optical depths, not coefficients, because these stay finite when the thickness of
    a layer goes to zero.

    Attributes:
        abl_absorption: μ_a h of the ABL, one value a wavelength.
        stroma_absorption: μ_a h of the stroma.
        stroma_scattering: μ_s h of the stroma.
        indices: Refractive indices of aqueous humour, ABL, stroma and pigment epithelium.
        order: Which layers are denser than their neighbours, known before tracing.
        phase: Phase function of the stroma; `None` for Rayleigh's.
        ipe_absorption: μ_a h of the pigment epithelium, a layer with aqueous humour behind it;
            `None` for LB06's, which is black.
    """

    abl_absorption: Spectrum
    stroma_absorption: Spectrum
    stroma_scattering: Spectrum
    indices: RefractiveIndices
    order: Order
    phase: PhaseMixture | None = None
    ipe_absorption: Spectrum | None = None

    @property
    def extinction(self) -> Spectrum:
        """Optical depth of the stroma, (μ_a + μ_s) h."""
        return self.stroma_absorption + self.stroma_scattering

    @property
    def albedo(self) -> Spectrum:
        """Single-scattering albedo of the stroma, μ_s/(μ_a + μ_s), or 0  [LB06 Eq. 7]."""
        return share_of(self.stroma_scattering, self.extinction, 0.0)

    @property
    def coalbedo(self) -> Spectrum:
        """1 − albedo without cancellation, μ_a/(μ_a + μ_s); 1 without either."""
        return share_of(self.stroma_absorption, self.extinction, 1.0)

    def valid(self) -> Bool[Array, ""]:
        """Check, traced too, that depths are finite and not negative and indices obey `order`."""
        ok = self.indices.agree(self.order)
        depths = self.abl_absorption, self.stroma_absorption, self.stroma_scattering
        for depth in jax.tree.leaves((depths, self.ipe_absorption)):
            ok = ok & (jnp.isfinite(depth) & (depth >= 0)).all()
        return ok if self.phase is None else ok & self.phase.valid()
