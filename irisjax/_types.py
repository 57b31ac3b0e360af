"""Shape and key aliases shared by every floor (jaxtyping)."""

from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

Numbers: TypeAlias = Any
"""A number, a list or an array of them, traced or not, or a word that a setting allows."""

Scalar: TypeAlias = Float[Array, ""]
"""A traced number."""

Spectrum: TypeAlias = Float[Array, " wavelengths"]
"""One value a wavelength."""

Cosines: TypeAlias = Float[Array, " angles"]
"""Cosines to the layer normal, in (0, 1]."""

PRNGKey: TypeAlias = Key[Array, ""]
"""A new-style key, `jax.random.key(seed)`."""


def as_float(x: Any) -> Array:
    """A float array of the default precision, or of its own if it is a JAX float array already."""
    if isinstance(x, Array) and jnp.issubdtype(x.dtype, jnp.floating):
        return x
    return jnp.asarray(x, jnp.result_type(float))


def as_float_or_none(x: Any) -> Array | None:
    """`as_float`, with `None` for what is absent."""
    return None if x is None else as_float(x)


def float_field(default: float) -> Any:
    """A field with a number, `as_float`."""
    return eqx.field(default=default, converter=as_float)


def optional_field(default: float | None = None) -> Any:
    """A field with a number or an array, `as_float_or_none`."""
    return eqx.field(default=default, converter=as_float_or_none)
