"""Square roots, shares and small systems whose gradients stay finite."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def safe_sqrt(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """√max(x, 0) whose gradient is 0, not infinite, where x ≤ 0."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def share_of(
    part: Float[Array, "*#s"], whole: Float[Array, "*#s"], of_nothing: float
) -> Float[Array, "*#s"]:
    """part/whole, and `of_nothing` where the whole is not above zero."""
    empty = whole <= 0
    return jnp.where(empty, of_nothing, part / jnp.where(empty, 1.0, whole))


def solve_2x2(a: Float[Array, "2 2 *s"], b: Float[Array, "2 *s"]) -> Float[Array, "2 *s"]:
    """x with a x = b, cheaper than a batch of LAPACK's; 0 where `a` is singular."""
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    x = jnp.stack([a[1, 1] * b[0] - a[0, 1] * b[1], a[0, 0] * b[1] - a[1, 0] * b[0]])
    return jnp.where(det == 0, 0.0, x / jnp.where(det == 0, 1.0, det))
