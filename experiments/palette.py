"""Colour of the simulated iris over melanin load and ABL fraction."""

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write


def main(key, quick=False, out=RESULTS):
    """Write XYZ and linear sRGB (D65, 2° observer) on a grid of loads and fractions. No key is
    used.
    """
    del key
    loads = np.geomspace(0.01, 0.5, 5 if quick else 25)
    fractions = np.linspace(0.0, 1.0, 3 if quick else 21)
    iris = ij.Iris.of_level("low")

    def one(load, fraction):
        c = ij.colour(iris.replace(melanin_load=load, abl_fraction=fraction), first_surface=False)
        return jnp.concatenate([c.xyz, c.srgb_linear])

    table = jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))(
        jnp.asarray(loads), jnp.asarray(fractions)
    )
    rows = [
        (float(a), float(f), *map(float, table[i, j]))
        for i, a in enumerate(loads)
        for j, f in enumerate(fractions)
    ]
    write(
        out / "palette.csv",
        (
            "simulated by irisjax; process ilit-2006, pheomelanin share of the low "
            "level, D65, CIE 1931 2 degree,",
            "first surface left out; melanin load in ug/mm2",
        ),
        ("melanin_load", "abl_fraction", "X", "Y", "Z", "r_linear", "g_linear", "b_linear"),
        rows,
    )


if __name__ == "__main__":
    start(main, __doc__)
