"""LB06 Fig. 8: BRDF at 550 nm in the principal plane, at 0° and 60°, low and high pigmentation.

Beside it the depth-resolved transport of the same layers, whose BRDF does depend on the azimuth.
"""

import jax
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write


def main(key, quick=False, out=RESULTS):
    """Write angle, exact BRDF, Monte Carlo BRDF (10⁷ photons; quick:
    10⁴) and depth-resolved BRDF.
    """
    angle, cosine, azimuth = ij.principal_plane(13 if quick else 37)
    rows = []
    for level in ("low", "high"):
        iris = ij.Iris.of_level(level)
        for degrees in (0, 60):
            key, k = jax.random.split(key)
            mu = float(np.cos(np.radians(degrees)))
            plane = {"cos_incidence": mu, "cos_exit": cosine, "azimuth": azimuth}
            exact = ij.brdf(iris, [550.0], **plane)
            mc = ij.brdf(
                iris, [550.0], **plane, solver=ij.MonteCarlo(10_000 if quick else 10_000_000), key=k
            )
            deep = ij.brdf(iris, [550.0], **plane, solver=ij.RadiativeExact())
            values = (
                np.degrees(angle),
                exact.values[0],
                mc.values[0],
                mc.standard_error[0],
                deep.values[0],
            )
            rows += [
                (level, degrees, *map(float, row))
                for row in zip(*map(np.asarray, values), strict=True)
            ]
    write(
        out / "fig8_brdf.csv",
        (
            "simulated by irisjax; process ilit-2006 (and depth-resolved), 550 nm, ABL fraction "
            "0.5, 1/sr,",
            "in the aqueous humour, light mirrored by the first surface left out; negative angles "
            "lie on the",
            "light's side; Monte Carlo values are averages over cells half-way to the next cosine",
        ),
        (
            "level",
            "incidence_deg",
            "exit_deg",
            "exact",
            "monte_carlo",
            "standard_error",
            "depth_resolved",
        ),
        rows,
    )


if __name__ == "__main__":
    start(main, __doc__)
