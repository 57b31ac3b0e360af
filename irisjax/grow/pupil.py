"""The edge of an invented pupil, which is not quite round; equal keys give equal edges."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import PRNGKey
from irisjax.numerics.checks import Range, check_range

IRREGULARITY = Range(0, 0.03)
"""Root mean square deviation of a pupil's edge from a circle, relative to its radius."""


def irregular_pupil(
    irregularity: float, *, harmonics: int = 6, key: PRNGKey
) -> Float[Array, "harmonics 2"]:
    """Draw `Eye.pupil_harmonics`: normal amplitudes that fall as one over the harmonic's number.

    Args:
        irregularity: Root mean square deviation from a circle, relative to the radius; usually
            0.01 to 0.02.
        harmonics: Number of harmonics, from the second one (an oval) on.
        key: Random key.

    Raises:
        ValueError: The irregularity is out of range.
    """
    check_range("irregularity", irregularity, IRREGULARITY)
    amplitudes = jax.random.normal(key, (harmonics, 2)) / jnp.arange(2.0, harmonics + 2)[:, None]
    # The mean square of a sine is one half.
    return irregularity * amplitudes / jnp.sqrt(0.5 * jnp.sum(amplitudes**2))
