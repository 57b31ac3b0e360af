"""How measured values scatter about the model: independently, with heavy tails, or correlated over
wavelength.
"""

from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import t
from jaxtyping import Array, Float

from irisjax._types import Scalar, optional_field
from irisjax.infer.observation import Observation
from irisjax.numerics.linear import cholesky, whiten

_Values: TypeAlias = Float[Array, " data"]

_Factor: TypeAlias = float | Scalar
_LOG_2PI = float(np.log(2 * np.pi))


class Noise(eqx.Module):
    """Standard deviation √((relative·model)² + absolute²) where the data state none, and additions.

    Attributes:
        discrepancy: Relative size of a smooth error of the model itself; `None` for none. It is
            marginalised, not fitted.
        length: Its correlation length, nm.
        degrees_of_freedom: Of Student's t in place of the normal, which makes single outliers
            harmless; `None` for the normal. Not together with `discrepancy`.
    """

    relative: Scalar = optional_field(0.02)
    absolute: Scalar = optional_field(2e-4)
    discrepancy: Scalar | None = optional_field()
    length: Scalar | None = optional_field()
    degrees_of_freedom: Scalar | None = optional_field()

    def __check_init__(self) -> None:
        if self.discrepancy is not None and self.degrees_of_freedom is not None:
            raise ValueError("a discrepancy and Student's t do not go together; choose one")
        if (self.discrepancy is None) != (self.length is None):
            raise ValueError("a discrepancy needs its length (nm), and a length its discrepancy")

    def stated(self, observation: Observation, model: _Values, factor: _Factor = 1.0) -> _Values:
        """Return the standard deviation of every value, a discrepancy included."""
        spread = self._spread(observation, model, factor)
        # A marginalised discrepancy is part of what the residuals may be.
        return spread if spread.ndim == 1 else jnp.sqrt((spread**2).sum(axis=1))

    def pointwise(self, observation: Observation, model: _Values, factor: _Factor = 1.0) -> _Values:
        """Return the log density of every value, of correlated ones given those before."""
        spread = self._spread(observation, model, factor)
        white, log_sd = _standardise(spread, observation.values - model)
        if self.degrees_of_freedom is not None and observation.correlation_root is None:
            return t.logpdf(white, self.degrees_of_freedom) - log_sd
        return -0.5 * (white * white + _LOG_2PI) - log_sd

    def whiten(self, observation: Observation, model: _Values) -> _Values:
        """Return residuals of unit variance; weights from the data do not pull on the model."""
        values = observation.values
        return _standardise(self._spread(observation, values), values - model)[0]

    def draw(
        self,
        observation: Observation,
        model: _Values,
        factor: _Factor,
        normal: _Values,
        chi_square: _Values | None = None,
    ) -> _Values:
        """Return a measurement of the model, from standard normal numbers (and χ² ones for t)."""
        spread = self._spread(observation, model, factor)
        if spread.ndim == 2:
            return model + spread @ normal
        if self.degrees_of_freedom is not None and chi_square is not None:
            normal = normal / jnp.sqrt(chi_square / self.degrees_of_freedom)
        return model + spread * normal

    def _spread(self, observation: Observation, model: _Values, factor: _Factor = 1.0) -> Array:
        """Standard deviations (data,), or Cholesky's root (data, data) of a covariance."""
        unscaled = observation.sd
        if unscaled is None:
            unscaled = jnp.sqrt((self.relative * model) ** 2 + self.absolute**2)
        sd = factor * unscaled
        root = observation.correlation_root
        if self.discrepancy is None or self.length is None or observation.is_colour:
            return sd if root is None else sd[:, None] * root
        independent = jnp.diag(sd * sd) if root is None else (sd[:, None] * root) @ (root.T * sd)
        separation = (observation.wavelengths[:, None] - observation.wavelengths) / self.length
        size = self.discrepancy * model
        smooth = size[:, None] * size * jnp.exp(-0.5 * separation**2)
        return cholesky(independent + smooth)


def _standardise(spread: Array, residual: _Values) -> tuple[_Values, _Values]:
    """Residuals of unit variance, and logarithms of what they were divided by."""
    if spread.ndim == 2:
        return whiten(spread, residual)
    return residual / spread, jnp.log(spread)
