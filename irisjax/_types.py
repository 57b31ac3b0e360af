"""Shape and key aliases shared by every floor (jaxtyping)."""

from typing import TypeAlias

from jaxtyping import Array, Float, Key

Scalar: TypeAlias = Float[Array, ""]
"""A traced number."""

Spectrum: TypeAlias = Float[Array, " wavelengths"]
"""One value a wavelength."""

Cosines: TypeAlias = Float[Array, " angles"]
"""Cosines to the layer normal, in (0, 1]."""

PRNGKey: TypeAlias = Key[Array, ""]
"""A new-style key, `jax.random.key(seed)`."""
