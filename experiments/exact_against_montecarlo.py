"""Every switch and level: the exact solver against 10⁷ analogue photons a wavelength.

Two independent codes of one process must agree within the sampling error of the second, for the
reflectance and for every place light can end. |z| < 4 is asked of each of the comparisons.
"""

import itertools

import jax
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.transport.defaults import exact_solver

VARIANTS = {
    f"{phase} {rescatter}{' perturbed' if perturb else ''}": ij.Ilit(
        phase=phase, rescatter=rescatter, perturb_on_reflection=perturb
    )
    for phase, rescatter, perturb in itertools.product(
        ("lb06", "rayleigh"), ("to-interface", "retest"), (False, True)
    )
} | {
    "rayleigh spheres": ij.ILIT_2006,
    "depth-resolved": ij.DEPTH_RESOLVED,
}
GRID = (400.0, 450.0, 500.0, 550.0, 600.0, 700.0)


def main(key, quick=False, out=RESULTS):
    """Write z-scores of five fates at six wavelengths for every variant,
    level and two incidences.
    """
    n = 100_000 if quick else 10_000_000
    rows = []
    for (name, process), level, mu in itertools.product(
        VARIANTS.items(), ("low", "moderate", "high"), (1.0, 0.5)
    ):
        key, k = jax.random.split(key)
        spheres = name == "rayleigh spheres"
        iris = ij.Iris.of_level(level).replace(scattering="rayleigh-spheres" if spheres else "lb06")
        exact, mc = (
            ij.reflectance(iris, GRID, cos_incidence=mu, first_surface=False, solver=solver, key=k)
            for solver in (exact_solver(process), ij.MonteCarlo(n, process=process))
        )
        for fate in ("reflected", "mirrored", "abl", "stroma", "ipe"):
            p, seen = (np.asarray(_fate(m, fate)) for m in (exact, mc))
            z = (seen - p) / np.sqrt(np.maximum(p * (1 - p), 1e-12) / n)
            rows += [
                (name, level, mu, fate, *map(float, row))
                for row in zip(GRID, p, seen, z, strict=True)
            ]
    worst = max(abs(row[-1]) for row in rows)
    print(
        f"{len(rows)} comparisons, largest |z| {worst:.2f}, mean z² "
        f"{np.mean([r[-1] ** 2 for r in rows]):.3f}"
    )
    write(
        out / "exact_against_montecarlo.csv",
        (
            f"exact against {n} analogue photons a wavelength; largest |z| {worst:.2f} of "
            f"{len(rows)}",
        ),
        ("process", "level", "cos_incidence", "fate", "wavelength_nm", "exact", "monte_carlo", "z"),
        rows,
    )
    return worst


def _fate(m, fate):
    return (
        {"reflected": m.values, "mirrored": m.mirrored}.get(fate)
        if fate in ("reflected", "mirrored")
        else getattr(m.absorbed, fate)
    )


if __name__ == "__main__":
    start(main, __doc__)
