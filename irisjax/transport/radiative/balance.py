"""A slab's balance of energy, in place of one row of the equations for its moments."""

import jax.numpy as jnp
import numpy as np

from irisjax.numerics import linear
from irisjax.transport.radiative.directions import Directions, Roof
from irisjax.transport.radiative.slab import Bounded


def energy_balance(slab, strength, f, b: Bounded, d: Directions, roof: Roof, coalbedo):
    """What each unknown takes from the light in the slab: absorbed by it, or sent out of it."""
    top, bottom = slab.leaving_each(b, 1)
    flux, above, below = (
        x[None, :] for x in (d.weight * d.cosine, roof.passed + roof.absorbed, d.bottom[1])
    )
    leaving = (flux * f) @ (top * above + bottom * below).T
    return (strength[:, None] * leaving).at[0, :: slab.n_depths].add(coalbedo * slab.widths).ravel()


def solve_balanced(slab, system, right, balance, lost_beam):
    """Solve with the slab's balance of energy, balance·x = lost_beam, in place of one row.

    `right` has a column, `lost_beam` a number for each beam. The balance is a sum of the rows, so
    nothing changes mathematically; in a thick slab that hardly absorbs, the rows' own sum would be
    lost in rounding. What rounding is left is scaled away.
    """
    empty = slab.depth <= 0
    scale = 1 / jnp.where(empty, 1.0, slab.depth)
    which = slab.n_panels // 2 * slab.n_depths  # the mean over the thickest panel
    system = system.at[which].set(jnp.where(empty, system[which], balance * scale))
    right = right.at[which].set(jnp.where(empty, right[which], lost_beam * scale))
    # Eliminated last, where a small pivot is the small loss of light that it stands for.
    order = np.append(np.delete(np.arange(right.shape[0]), which), which)
    x = linear.solve(system[order][:, order], right[order])[np.argsort(order)]
    spent = balance @ x
    # Of less light the quotient's derivative would underflow.
    dark = spent <= jnp.finfo(spent.dtype).tiny ** 0.5
    return x * jnp.where(dark, 1.0, lost_beam / jnp.where(dark, 1.0, spent))[None, :]
