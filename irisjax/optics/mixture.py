"""A phase function for tissue: a share of Rayleigh's law, the rest Henyey and Greenstein's."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from irisjax._types import AnyReals, Real, Spectrum
from irisjax.optics.phase import PHASES, rayleigh

_MEANS = 7  # arithmetic–geometric means; each doubles the digits


class PhaseMixture(eqx.Module):
    """p(Θ) = s p_R + (1 − s) p_HG, one value a wavelength; each is 4π over the sphere.

    p_HG = (1 − g²)/(1 + g² − 2g cos Θ)^{3/2} with the mean cosine g, whose Legendre moments are
    g^l.  [Henyey & Greenstein 1941, Eq. 2]

    Attributes:
        rayleigh: Share s of the scattering that follows Rayleigh's law.
        anisotropy: g of the rest.
    """

    rayleigh: Spectrum
    anisotropy: Spectrum

    def valid(self) -> Bool[Array, ""]:
        """Whether every share lies in [0, 1] and every g in (−1, 1) (traced)."""
        s, g = self.rayleigh, self.anisotropy
        return ((s >= 0) & (s <= 1) & (jnp.abs(g) < 1)).all()

    def value(self, cosine: Real) -> Array:
        """p at cosines of the scattering angle."""
        s = self.rayleigh
        return s * rayleigh(cosine) + (1 - s) * henyey_greenstein(cosine, self.anisotropy)

    def mean_over_azimuth(self, centre: Real, reach: Real) -> Array:
        """Mean of p over azimuth φ where the cosine of the scattering angle is `centre` + `reach`
        cos φ, `reach` ≥ 0.
        """
        s = self.rayleigh
        of_rayleigh = rayleigh(centre) + 0.375 * reach * reach
        return s * of_rayleigh + (1 - s) * mean_henyey_greenstein(centre, reach, self.anisotropy)

    def moments(self, count: int) -> Array:
        """Legendre moments χ_0 to χ_{count − 1} along a new last axis: p = Σ (2l + 1) χ_l P_l."""
        of_rayleigh = np.zeros(count)
        of_rayleigh[: min(count, 3)] = (1.0, 0.0, 0.1)[:count]
        powers = [jnp.ones_like(self.anisotropy)]
        for _ in range(count - 1):
            powers.append(powers[-1] * self.anisotropy)
        s, of_rayleigh = self.rayleigh[..., None], jnp.asarray(of_rayleigh, self.anisotropy.dtype)
        return jnp.multiply.outer(self.rayleigh, of_rayleigh) + (1 - s) * jnp.stack(powers, -1)

    def truncated(self, count: int) -> tuple[Array, Array]:
        """The first moments without the forward peak, and the peak's share f: δ-M.

        f is the first moment left out, and χ'_l = (χ_l − f)/(1 − f); a phase function that peaks
        backwards has none.  [Wiscombe 1977, Eqs. 14, 15]
        """
        g = jnp.maximum(self.anisotropy, 0.0)
        peak = (1 - self.rayleigh) * g**count
        f = peak[..., None]
        return (self.moments(count) - f) / (1 - f), peak

    def sample_cosine(self, u: Real) -> Array:
        """Cosine of the scattering angle from a uniform number in [0, 1]."""
        s = self.rayleigh
        of_rayleigh = PHASES["rayleigh"].sample_cosine(jnp.clip(u / jnp.maximum(s, 1e-30), 0, 1))
        v = jnp.clip((u - s) / jnp.maximum(1 - s, 1e-30), 0.0, 1.0)
        return jnp.where(u < s, of_rayleigh, sample_henyey_greenstein(v, self.anisotropy))


def henyey_greenstein(cosine: AnyReals, g: Real) -> Array:
    """(1 − g²)/(1 + g² − 2g cos Θ)^{3/2}  [Henyey & Greenstein 1941, Eq. 2]."""
    base = _base(cosine, g)
    return (1 - g) * (1 + g) / (base * jnp.sqrt(base))


def _base(cosine: AnyReals, g: Real) -> Array:
    """1 + g² − 2g cos Θ, written round the peak, where that cancels."""
    size = jnp.where(g < 0, -g, g)  # whose derivative at 0 is that from above, as `towards` is
    towards = jnp.where(g < 0, 1 + cosine, 1 - cosine)
    return (1 - size) ** 2 + 2 * size * towards


def mean_henyey_greenstein(centre: Real, reach: Real, g: Real) -> Array:
    """Over azimuth: ∫ (a − b cos φ)^{−3/2} dφ/2π = (2/π) E(m)/((a − b) √(a + b)), m = 2b/(a + b)
    [DLMF 19.2.8 with 19.4].
    """
    towards = jnp.where(g < 0, -reach, reach)
    smallest, largest = _base(centre + towards, g), _base(centre - towards, g)
    return (1 - g) * (1 + g) * _elliptic_e(smallest / largest) / (smallest * jnp.sqrt(largest))


def _elliptic_e(complement):
    """(2/π) E(m), the complete elliptic integral of the second kind of 1 − m, by the
    arithmetic–geometric mean  [DLMF 19.8.6].
    """
    a, b, total = jnp.ones_like(complement), jnp.sqrt(complement), (1 - complement) / 2
    for n in range(_MEANS):
        a, b, half = (a + b) / 2, jnp.sqrt(a * b), (a - b) / 2
        total = total + 2.0**n * half * half
    return (1 - total) / a


def sample_henyey_greenstein(u: Real, g: Real) -> Array:
    """The inverse distribution function of the cosine, without the division by g of its usual form.

    [Henyey & Greenstein 1941, Eq. 2]
    """
    v = 2 * u - 1
    numerator = v + 0.5 * g * (3 + v * v) + g * g * v - 0.5 * g**3 * (1 - v * v)
    return jnp.clip(numerator / jnp.square(1 + g * v), -1.0, 1.0)
