"""The optical description that transport works on: two layers between aqueous humour and IPE."""

import math

import equinox as eqx
import jax.numpy as jnp

from irisjax._types import Spectrum
from irisjax.numerics.checks import Range, check_range
from irisjax.optics.mixture import PhaseMixture
from irisjax.tissue.indices import Order, RefractiveIndices


class Layers(eqx.Module):
    """An absorbing ABL over an absorbing and scattering stroma over the black IPE.

    Optical depths, not coefficients: they stay finite when a layer's thickness goes to zero.

    **Fields:**

    - `abl_absorption`: μ_a h of the ABL, one value a wavelength.
    - `stroma_absorption`, `stroma_scattering`: μ_a h and μ_s h of the stroma.
    - `indices`: refractive indices of aqueous humour, ABL, stroma, IPE.
    - `order`: which neighbour is denser, known before tracing (see `tissue.indices.Order`).
    - `phase`: phase function of the stroma where it is not Rayleigh's; `None` costs nothing.
    """

    abl_absorption: Spectrum
    stroma_absorption: Spectrum
    stroma_scattering: Spectrum
    indices: RefractiveIndices
    order: Order
    phase: PhaseMixture | None = None

    @classmethod
    def from_coefficients(
        cls,
        mu_a_abl,
        mu_a_stroma,
        mu_s_stroma,
        *,
        abl_thickness,
        stroma_thickness,
        indices: RefractiveIndices,
    ) -> "Layers":
        """Layers from coefficients in mm⁻¹ (scalars or one value a wavelength) and thicknesses in
        mm.

        **Raises:** `ValueError` for negative or non-finite concrete values.
        """
        depths = jnp.broadcast_arrays(
            *(
                jnp.atleast_1d(jnp.asarray(mu, jnp.result_type(float)) * h)
                for mu, h in (
                    (mu_a_abl, abl_thickness),
                    (mu_a_stroma, stroma_thickness),
                    (mu_s_stroma, stroma_thickness),
                )
            )
        )
        for name, depth in zip(("mu_a_abl", "mu_a_stroma", "mu_s_stroma"), depths, strict=True):
            check_range(f"{name} times its thickness", depth, Range(0, math.inf))
        return cls(*depths, indices=indices, order=indices.order())

    @property
    def extinction(self) -> Spectrum:
        """Optical depth of the stroma, (μ_a + μ_s) h."""
        return self.stroma_absorption + self.stroma_scattering

    @property
    def albedo(self) -> Spectrum:
        """Single-scattering albedo of the stroma, μ_s/(μ_a + μ_s); 0 where there is neither.  [LB06
        Eq. 7]
        """
        total = self.extinction
        empty = total <= 0
        return jnp.where(empty, 0.0, self.stroma_scattering / jnp.where(empty, 1.0, total))

    @property
    def coalbedo(self) -> Spectrum:
        """1 − albedo without cancellation, μ_a/(μ_a + μ_s); 1 where there is neither."""
        total = self.extinction
        empty = total <= 0
        return jnp.where(empty, 1.0, self.stroma_absorption / jnp.where(empty, 1.0, total))

    def valid(self):
        """Whether every depth is finite and not negative and the indices keep to `order`
        (traced).
        """
        ok = self.indices.agree(self.order)
        for depth in (self.abl_absorption, self.stroma_absorption, self.stroma_scattering):
            ok = ok & (jnp.isfinite(depth) & (depth >= 0)).all()
        return ok if self.phase is None else ok & self.phase.valid()
