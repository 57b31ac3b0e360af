"""LB06 Figs. 5, 6 and 7: simulated radiance and reflectance, exact and by analogue Monte Carlo.

The measured curves of LB06 Fig. 5 are not available; only the model is drawn.
"""

import jax
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write

LEVELS = ("low", "moderate", "high")
HEADER = (
    "simulated by irisjax; process ilit-2006, normal incidence, ABL fraction 0.5 unless said",
)


def main(key, quick=False, out=RESULTS):
    """Write the three figures' data; the Monte Carlo column follows 10⁶ photons a wavelength
    (quick: 2000).
    """
    grid = ij.wavelengths(400, 700, 20 if quick else 5)
    sampled = ij.MonteCarlo(2_000 if quick else 1_000_000)
    key5, key6, key7 = jax.random.split(key, 3)

    def rows(label, iris, key, measure):
        exact, mc = measure(iris, grid), measure(iris, grid, solver=sampled, key=key)
        columns = (grid, exact.values, mc.values, mc.standard_error)
        return [(label, *map(float, row)) for row in zip(*map(np.asarray, columns), strict=True)]

    columns = ("wavelength_nm", "exact", "monte_carlo", "standard_error")
    data = [
        row
        for level, k in zip(LEVELS, jax.random.split(key5, 3), strict=True)
        for row in rows(
            level,
            ij.Iris.of_level(level),
            k,
            lambda *a, **kw: ij.radiance(*a, illuminant="D65", **kw),
        )
    ]
    write(
        out / "fig5_radiance.csv",
        (
            *HEADER,
            "radiance under D65, relative to the illuminant at 560 nm, per sr, light dimmed by the "
            "cornea inward;",
            "first surface counted, tear film's mirror dropped",
        ),
        ("level", *columns),
        data,
    )
    data = [
        row
        for level, k in zip(LEVELS, jax.random.split(key6, 3), strict=True)
        for row in rows(level, ij.Iris.of_level(level), k, ij.reflectance)
    ]
    write(
        out / "fig6_levels.csv",
        (*HEADER, "reflectance, first surface counted"),
        ("level", *columns),
        data,
    )
    data = [
        row
        for fraction, k in zip((0.2, 0.5, 0.8), jax.random.split(key7, 3), strict=True)
        for row in rows(
            fraction, ij.Iris.of_level("moderate").replace(abl_fraction=fraction), k, ij.reflectance
        )
    ]
    write(
        out / "fig7_abl_fraction.csv",
        (*HEADER, "moderate level, reflectance, first surface counted"),
        ("abl_fraction", *columns),
        data,
    )


if __name__ == "__main__":
    start(main, __doc__)
