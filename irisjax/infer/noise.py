"""How measured values scatter about the model: independent, heavy-tailed, or correlated over
wavelength.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.infer.observation import Observation

_LOG_2PI = float(np.log(2 * np.pi))


def _number(value) -> Any:
    return None if value is None else jnp.asarray(value, jnp.result_type(float))


def _setting(default) -> Any:
    return eqx.field(converter=_number, default=default)


class Noise(eqx.Module):
    """Standard deviation √((relative·model)² + absolute²) where the data state none, and what comes
    beside it.

    - `discrepancy`: relative size of a smooth error of the model itself, correlated over `length`
        (nm); `None` for none. It is marginalised, not fitted.
    - `degrees_of_freedom`: of Student's t in place of the normal, which makes single outliers
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

    def sd(self, observation: Observation, model: Float[Array, " data"], factor=1.0):
        """Standard deviation of every value, given what the model predicts and the factor
        `noise`.
        """
        if observation.sd is not None:
            return factor * observation.sd
        return factor * jnp.sqrt((self.relative * model) ** 2 + self.absolute**2)

    def pointwise(self, observation: Observation, model: Float[Array, " data"], factor=1.0):
        """Log density of every value by itself, shape (data,); of correlated values, one given all
        before it.
        """
        if observation.covariance_root is not None:
            white, log_sd = _whitened(
                observation.covariance_root * factor, observation.values - model
            )
            return _normal(white, log_sd)
        sd = self.sd(observation, model, factor)
        residual = observation.values - model
        if self.discrepancy is not None:
            root = _cholesky(jnp.diag(sd * sd) + self._smooth(observation, model))
            return _normal(*_whitened(root, residual))
        if self.degrees_of_freedom is not None:
            return _student(residual / sd, jnp.log(sd), self.degrees_of_freedom)
        return _normal(residual / sd, jnp.log(sd))

    def whiten(self, observation: Observation, model, factor=1.0):
        """Residuals of unit variance, the weights taken as known: what least squares minimises,
        shape (data,).

        Weights come from the data, so that they do not pull on the model.
        """
        residual = observation.values - model
        if observation.covariance_root is not None:
            return _whitened(observation.covariance_root * factor, residual)[0]
        sd = self.sd(observation, observation.values, factor)
        if self.discrepancy is None:
            return residual / sd
        return _whitened(
            _cholesky(jnp.diag(sd * sd) + self._smooth(observation, observation.values)), residual
        )[0]

    def draw(self, observation: Observation, model, factor, normal, chi_square=None):
        """A measurement of the model, from standard normal numbers (and, for Student's t,
        χ² ones).
        """
        if observation.covariance_root is not None:
            return model + factor * observation.covariance_root @ normal
        sd = self.sd(observation, model, factor)
        if self.discrepancy is not None:
            return model + _cholesky(jnp.diag(sd * sd) + self._smooth(observation, model)) @ normal
        if self.degrees_of_freedom is not None and chi_square is not None:
            normal = normal / jnp.sqrt(chi_square / self.degrees_of_freedom)
        return model + sd * normal

    def _smooth(self, observation, model):
        apart = (observation.wavelengths[:, None] - observation.wavelengths) / self.length
        size = self.discrepancy * model
        return size[:, None] * size * jnp.exp(-0.5 * apart**2)


def _normal(white, log_sd):
    return -0.5 * (white * white + _LOG_2PI) - log_sd


def _student(white, log_sd, nu):
    return (
        gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * jnp.log(nu * jnp.pi)
        - (nu + 1) / 2 * jnp.log1p(white * white / nu) - log_sd
    )  # fmt: skip


# Roots in plain JAX: batches of small LAPACK calls wait for each other on few cores (see
# `elimination`). In blocks, so that most of the work is products of matrices (a twentieth of the
# time at 300 wavelengths); blocks in a loop, so that it compiles fast.
_BLOCK = 16


def _whitened(root, residual):
    """Root⁻¹ residual, and the logarithms of the diagonal."""
    n = residual.shape[0]
    if n <= _BLOCK:
        return _forward(root, residual), jnp.log(jnp.diag(root))
    padded = _padded(root)
    right = jnp.zeros(padded.shape[0], residual.dtype).at[:n].set(residual)

    def step(k, white):
        rows = jax.lax.dynamic_slice_in_dim(padded, k * _BLOCK, _BLOCK)
        corner = jax.lax.dynamic_slice_in_dim(rows, k * _BLOCK, _BLOCK, 1)
        rest = jax.lax.dynamic_slice_in_dim(right, k * _BLOCK, _BLOCK) - rows @ white
        return jax.lax.dynamic_update_slice_in_dim(white, _forward(corner, rest), k * _BLOCK, 0)

    white = jax.lax.fori_loop(0, right.size // _BLOCK, step, jnp.zeros_like(right))
    return white[:n], jnp.log(jnp.diag(root))


def _cholesky(a):
    """Lower root of a positive definite matrix."""
    n = a.shape[0]
    if n <= _BLOCK:
        return _small_cholesky(a)
    padded = _padded(a)
    places = jnp.arange(padded.shape[0])[:, None]

    def step(k, root):
        rows = jax.lax.dynamic_slice_in_dim(root, k * _BLOCK, _BLOCK)
        columns = jax.lax.dynamic_slice_in_dim(padded, k * _BLOCK, _BLOCK, 1) - root @ rows.T
        corner = _small_cholesky(jax.lax.dynamic_slice_in_dim(columns, k * _BLOCK, _BLOCK))
        columns = jnp.where(places < k * _BLOCK, 0.0, _forward(corner, columns.T).T)
        return jax.lax.dynamic_update_slice_in_dim(root, columns, k * _BLOCK, 1)

    return jnp.tril(jax.lax.fori_loop(0, places.size // _BLOCK, step, jnp.zeros_like(padded)))[
        :n, :n
    ]


def _padded(a):
    """With ones added to the diagonal, to whole blocks."""
    n = a.shape[0]
    return jnp.eye(-(-n // _BLOCK) * _BLOCK, dtype=a.dtype).at[:n, :n].set(a)


def _forward(root, b):
    """Root⁻¹ b of a small root, row by row."""

    def step(i, x):
        return x.at[i].set((b[i] - root[i] @ x) / root[i, i])

    return jax.lax.fori_loop(0, b.shape[0], step, jnp.zeros_like(b))


def _small_cholesky(a):
    """Column by column."""
    rows = jnp.arange(a.shape[0])

    def step(k, carry):
        rest, root = carry
        column = jnp.where(rows >= k, rest[:, k], 0.0) / jnp.sqrt(rest[k, k])
        return rest - column[:, None] * column, root.at[:, k].set(column)

    return jax.lax.fori_loop(0, a.shape[0], step, (a, jnp.zeros_like(a)))[1]
