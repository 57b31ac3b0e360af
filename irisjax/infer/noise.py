"""How measured values scatter about the model: independently, with heavy tails, or correlated over
wavelength.
"""

from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.infer.observation import Observation
from irisjax.numerics.linear import cholesky, whitened

Values: TypeAlias = Float[Array, " data"]
"""One number for each measured value."""
Factor: TypeAlias = float | Float[Array, ""]
_LOG_2PI = float(np.log(2 * np.pi))


def _number(value) -> Any:
    return None if value is None else jnp.asarray(value, jnp.result_type(float))


def _setting(default) -> Any:
    return eqx.field(converter=_number, default=default)


class Noise(eqx.Module):
    """Standard deviation √((relative·model)² + absolute²) where the data state none, and additions.

    Attributes:
        relative: Part that is proportional to the model.
        absolute: Part that does not depend on it.
        discrepancy: Relative size of a smooth error of the model itself; `None` for none. It is
            marginalised, not fitted.
        length: Its correlation length, nm.
        degrees_of_freedom: Of Student's t in place of the normal, which makes single outliers
            harmless; `None` for the normal. Not together with `discrepancy`.
    """

    relative: Scalar = _setting(0.02)
    absolute: Scalar = _setting(2e-4)
    discrepancy: Scalar | None = _setting(None)
    length: Scalar | None = _setting(None)
    degrees_of_freedom: Scalar | None = _setting(None)

    def __check_init__(self):
        if self.discrepancy is not None and self.degrees_of_freedom is not None:
            raise ValueError(
                "a correlated discrepancy and Student's t do not go together; choose one"
            )
        if (self.discrepancy is None) != (self.length is None):
            raise ValueError("a discrepancy needs its length (nm), and a length its discrepancy")

    def sd(self, observation: Observation, model: Values, factor: Factor = 1.0) -> Values:
        """Return the standard deviation of every value, given what the model predicts and the
        factor `noise`.
        """
        if observation.sd is not None:
            return factor * observation.sd
        return factor * jnp.sqrt((self.relative * model) ** 2 + self.absolute**2)

    def pointwise(self, observation: Observation, model: Values, factor: Factor = 1.0) -> Values:
        """Return the log density of every value, of correlated ones given those before."""
        residual = observation.values - model
        if observation.covariance_root is not None:
            return _normal(*whitened(observation.covariance_root * factor, residual))
        sd = self.sd(observation, model, factor)
        if self.discrepancy is not None:
            return _normal(*whitened(self._root(observation, model, sd), residual))
        if self.degrees_of_freedom is not None:
            return _student(residual / sd, jnp.log(sd), self.degrees_of_freedom)
        return _normal(residual / sd, jnp.log(sd))

    def whiten(self, observation: Observation, model: Values, factor: Factor = 1.0) -> Values:
        """Return residuals of unit variance, which least squares minimise.

        Their weights come from the data, so that they do not pull on the model.
        """
        residual = observation.values - model
        if observation.covariance_root is not None:
            return whitened(observation.covariance_root * factor, residual)[0]
        sd = self.sd(observation, observation.values, factor)
        if self.discrepancy is None:
            return residual / sd
        return whitened(self._root(observation, observation.values, sd), residual)[0]

    def draw(
        self,
        observation: Observation,
        model: Values,
        factor: Factor,
        normal: Values,
        chi_square: Values | None = None,
    ) -> Values:
        """Return a measurement of the model, from standard normal numbers (and, for Student's t,
        χ² ones).
        """
        if observation.covariance_root is not None:
            return model + factor * observation.covariance_root @ normal
        sd = self.sd(observation, model, factor)
        if self.discrepancy is not None:
            return model + self._root(observation, model, sd) @ normal
        if self.degrees_of_freedom is not None and chi_square is not None:
            normal = normal / jnp.sqrt(chi_square / self.degrees_of_freedom)
        return model + sd * normal

    def _root(self, observation: Observation, model: Values, sd: Values) -> Array:
        """Cholesky's root of the covariance of independent noise and the smooth error."""
        assert self.length is not None
        assert self.discrepancy is not None
        apart = (observation.wavelengths[:, None] - observation.wavelengths) / self.length
        size = self.discrepancy * model
        smooth = size[:, None] * size * jnp.exp(-0.5 * apart**2)
        return cholesky(jnp.diag(sd * sd) + smooth)


def _normal(white, log_sd):
    return -0.5 * (white * white + _LOG_2PI) - log_sd


def _student(white, log_sd, nu):
    return (
        gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * jnp.log(nu * jnp.pi)
        - (nu + 1) / 2 * jnp.log1p(white * white / nu) - log_sd
    )  # fmt: skip
