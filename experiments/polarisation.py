"""What polarisation changes in the light of irides, and what a crossed polariser leaves of it.

Beside the size of that change stands what ILIT makes of the same irides.
"""

import jax
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.transport.defaults import exact_solver

PROCESSES = (ij.ILIT_2006, ij.DEPTH_RESOLVED, ij.POLARISED)
LEVELS = ("low", "moderate", "high")
FRACTIONS = (0.2, 0.5, 0.8)
_SAID = "simulated by irisjax; radiative transfer in LB06's irides, light along the normal"


def main(key, quick=False, out=RESULTS):
    """Write spectra by scalar and by polarised theory with what two analysers pass, spectra by
    these and by ILIT, and the degree of polarisation over the exit angle. No key is used.
    """
    del key
    grid = ij.wavelengths(400, 700, 150 if quick else 10)
    write(
        out / "polarised_spectra.csv",
        (
            _SAID,
            "reflectance with the first surface, pi L/E along the normal without it; shares that "
            "pass a crossed analyser, of polarised light: along the normal, and of all directions "
            "without the first surface",
        ),
        (
            "level", "abl_fraction", "wavelength_nm", "reflectance_scalar",
            "reflectance_polarised", "radiance_factor_scalar", "radiance_factor_polarised",
            "crossed_share_normal", "crossed_share_hemisphere",
        ),
        [row for level in LEVELS for f in FRACTIONS for row in _spectra(level, f, grid)],
    )  # fmt: skip
    fine = ij.wavelengths(400, 700, 150 if quick else 5)
    write(
        out / "three_processes.csv",
        (
            "simulated by irisjax; LB06's irides, light along the normal, ABL fraction 0.5",
            "reflectance with the first surface: ILIT (ilit-2006), scalar and polarised radiative "
            "transfer",
        ),
        (
            "level", "wavelength_nm", "reflectance_ilit", "reflectance_scalar",
            "reflectance_polarised",
        ),
        [row for level in LEVELS for row in _three(level, fine)],
    )  # fmt: skip
    angles = np.linspace(0, 85, 6 if quick else 86)
    write(
        out / "polarised_angles.csv",
        (_SAID, "ABL fraction 0.5; light unpolarised; what the first surface mirrors left out"),
        ("level", "wavelength_nm", "exit_deg", "degree_of_linear_polarisation", "radiance_factor"),
        [row for level in LEVELS for row in _over_angles(level, angles)],
    )


def _spectra(level, fraction, grid):
    iris = ij.Iris.of_level(level).replace(abl_fraction=fraction)
    normal = ij.Goniophotometer(grid, cos_exit=1.0)
    columns = []
    for process in (ij.DEPTH_RESOLVED, ij.POLARISED):
        solver = ij.RadiativeExact(process=process)
        columns.append(ij.reflectance(iris, grid, solver=solver).values)
    for process in (ij.DEPTH_RESOLVED, ij.POLARISED):
        solver = ij.RadiativeExact(process=process)
        columns.append(np.pi * ij.observe(iris, normal, solver).values[:, 0])
    for where in (1.0, ij.HEMISPHERE):
        crossed, parallel = (
            ij.observe(
                iris,
                ij.Analyser(grid, setting, cos_exit=where, first_surface=False),
                ij.RadiativeExact(process=ij.POLARISED),
            ).values
            for setting in ("crossed", "parallel")
        )
        columns.append(crossed / (crossed + parallel))
    for i, nm in enumerate(grid):
        yield level, fraction, float(nm), *(float(c[i]) for c in columns)


def _three(level, grid):
    iris = ij.Iris.of_level(level).replace(abl_fraction=0.5)
    columns = [ij.reflectance(iris, grid, solver=exact_solver(p)).values for p in PROCESSES]
    for i, nm in enumerate(grid):
        yield level, float(nm), *(float(c[i]) for c in columns)


def _over_angles(level, angles):
    grid = np.array([450.0, 550.0, 650.0])
    iris = ij.Iris.of_level(level).replace(abl_fraction=0.5)
    layers = iris.layers(ij.extinction(grid))
    light = ij.Light(1.0, ij.Directions(np.cos(np.radians(angles))))
    solver = ij.RadiativeExact(process=ij.POLARISED).prepare(layers, light)
    found = jax.jit(lambda x: solver.solve(x, light))(layers)
    sent = np.pi * np.asarray(found.polarisation.brdf)[..., 0]
    degree = np.hypot(sent[..., 1], sent[..., 2]) / sent[..., 0]
    for i, nm in enumerate(grid):
        for j, angle in enumerate(angles):
            yield level, float(nm), float(angle), float(degree[i, j]), float(sent[i, j, 0])


if __name__ == "__main__":
    start(main, __doc__)
