"""Shape and key aliases shared by every floor (jaxtyping)."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float, Key

Numbers: TypeAlias = Any
"""A number, a list or an array of them, traced or not, or a word that a setting allows."""

Real: TypeAlias = Array | float
"""A number, or an array of them to compute with."""

AnyReals: TypeAlias = Float[Array | np.ndarray, "..."] | float
"""The same, of NumPy too."""

Reals: TypeAlias = ArrayLike | Sequence[float]
"""A number, a list or an array of them, traced or not, to be converted by `as_float`."""

Scalar: TypeAlias = Float[Array, ""]
"""A traced number."""

Spectrum: TypeAlias = Float[Array, " wavelengths"]
"""One value a wavelength."""

PRNGKey: TypeAlias = Key[Array, ""]
"""A new-style key, `jax.random.key(seed)`."""


def as_float(x: object) -> Array:
    """A float array of the default precision, or of its own if it is a JAX float array already."""
    if isinstance(x, Array) and jnp.issubdtype(x.dtype, jnp.floating):
        return x
    return jnp.asarray(x, jnp.result_type(float))


def as_float_or_none(x: object) -> Array | None:
    """`as_float`, with `None` for what is absent."""
    return None if x is None else as_float(x)


def float_field(default: float) -> Any:
    """A field with a number, `as_float`."""
    return eqx.field(default=default, converter=as_float)


def optional_field(default: float | None = None) -> Any:
    """A field with a number or an array, `as_float_or_none`."""
    return eqx.field(default=default, converter=as_float_or_none)
