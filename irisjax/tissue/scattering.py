"""Scattering as in tissue optics: a power law of the wavelength with a share of Rayleigh's.

LB06's formula (`tissue.indices`) is for fibrils of one size, far below the wavelength.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from irisjax._types import Scalar, Spectrum
from irisjax.numerics.checks import Range, check_fields
from irisjax.optics.mixture import PhaseMixture

REFERENCE = 500.0
"""Wavelength, nm, at which a power law's reduced scattering is stated [Jacques 2013, Eq. 2]."""

POWER_LAW_LIMITS: dict[str, Range] = {
    "reduced_scattering": Range(0, 100, "1/mm", "reduced scattering of the stroma at 500 nm, a'"),
    "rayleigh_share": Range(0, 1, "", "share of it that is Rayleigh scattering, f_Ray"),
    "scattering_power": Range(0, 4, "", "power of the wavelength by which the rest falls, b"),
    "anisotropy": Range(-0.9, 0.95, "", "mean cosine of the rest's scattering angle, g"),
}
"""Every number of `PowerLaw` with its allowed range and unit."""


def _number(default: float) -> Any:
    def convert(value):
        if isinstance(value, bool | str) or value is None:
            raise ValueError(f"a power law is made of numbers, got {value!r}")
        return jnp.asarray(value, jnp.result_type(float))

    return eqx.field(default=default, converter=convert)


class PowerLaw(eqx.Module):
    """A power law of scattering that replaces LB06's formula  [Jacques 2013, Eq. 2].

    The reduced scattering coefficient is μ_s′(λ) = a′ [f_Ray (λ/500 nm)⁻⁴ + (1 − f_Ray)
    (λ/500 nm)^−b]. The first part scatters by Rayleigh's law, the rest by Henyey and Greenstein's
    with the mean cosine g, so that its μ_s is μ_s′/(1 − g). The defaults are typical of soft
    tissue.

    Attributes:
        reduced_scattering: a′, mm⁻¹.
        rayleigh_share: f_Ray, at 500 nm.
        scattering_power: b.
        anisotropy: g.

    Raises:
        ValueError: For a concrete value out of range, with its field, value and range.
    """

    reduced_scattering: Scalar = _number(1.0)
    rayleigh_share: Scalar = _number(0.3)
    scattering_power: Scalar = _number(1.0)
    anisotropy: Scalar = _number(0.85)

    def __check_init__(self) -> None:
        check_fields(self, POWER_LAW_LIMITS)

    def parameters(self) -> dict[str, Scalar]:
        """Return its numbers by name."""
        return dict(vars(self))

    def reduced(self, wavelengths: Spectrum) -> Spectrum:
        """Compute μ_s′ in mm⁻¹ at wavelengths in nm  [Jacques 2013, Eq. 2]."""
        small, large = self._parts(wavelengths)
        return self.reduced_scattering * (small + large)

    def coefficient(self, wavelengths: Spectrum) -> Spectrum:
        """Compute μ_s in mm⁻¹ at wavelengths in nm."""
        small, large = self._parts(wavelengths)
        return self.reduced_scattering * (small + large / (1 - self.anisotropy))

    def phase(self, wavelengths: Spectrum) -> PhaseMixture:
        """Compute the phase function, a mixture by each part's share of μ_s."""
        small, large = self._parts(wavelengths)
        large = large / (1 - self.anisotropy)
        g = jnp.broadcast_to(self.anisotropy, small.shape)
        return PhaseMixture(small / (small + large), g)

    def _parts(self, wavelengths: Spectrum) -> tuple[Spectrum, Spectrum]:
        """Return Rayleigh's part and the rest, relative to a′."""
        ratio = wavelengths / REFERENCE
        rest = (1 - self.rayleigh_share) * jnp.exp(-self.scattering_power * jnp.log(ratio))
        return self.rayleigh_share / ratio**4, rest
