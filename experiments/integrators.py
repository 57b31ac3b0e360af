"""The two integrators of the renderer against radiative transfer in the same layers, over thickness
and exit angle.

`Separable` is ILIT, `SingleScattering` is F09's. Depth-resolved transport is the yardstick, itself
checked here by a Monte Carlo that shares no code with the package.
"""

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.anatomy.eye import Eye
from irisjax.measure.colour import OBSERVER, tristimulus_matrix
from irisjax.render.bands import Bands
from irisjax.render.project import IrisPixels
from irisjax.render.single_scattering import MarchedScene, SingleScattering
from irisjax.tissue.maps import Scales, texel_layers
from irisjax.transport.solution import raise_failure

GRID = 380 + 20.0 * np.arange(21)
SHOWN = (460.0, 540.0, 620.0)
THICKNESS = (0.05, 0.1, 0.15, 0.2, 0.2855, 0.35, 0.45, 0.6)  # mm; F09's map runs from crypts to 0.6
USUAL = 0.2855
CELLS = np.linspace(0, 1, 11)
NEAR = 0.95  # cosine of the exit over thickness: the middle of the Monte Carlo's last cell


def main(key, quick=False, out=RESULTS):
    """Write BRDFs of every integrator by level, wavelength, thickness, incidence and exit (quick:
    2·10⁴ photons).
    """
    exits = jnp.append((CELLS[1:] + CELLS[:-1]) / 2, 1.0)
    thickness = (0.1, USUAL) if quick else THICKNESS
    luminance = np.asarray(tristimulus_matrix(GRID, "XYZ", "D65", OBSERVER)[0])[1]
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    rows = []
    for level in ("low", "moderate", "high"):
        iris = ij.Iris.of_level(level)
        for degrees in (0, 60):
            models, status = _models(
                iris, jnp.asarray(thickness), jnp.cos(jnp.radians(float(degrees))), exits
            )
            models = raise_failure(models, status)
            models = [np.asarray(m) for m in models]
            for t, mm in enumerate(thickness):
                for e, cosine in enumerate(exits):
                    if mm != USUAL and not np.isclose(cosine, NEAR):
                        continue
                    angle = float(np.degrees(np.arccos(cosine)))
                    for name in (*SHOWN, "luminance"):
                        row = luminance / luminance.sum() if name == "luminance" else name == GRID
                        values = [float(row @ m[t, :, e]) for m in models]
                        rows.append([level, name, mm, degrees, angle, *values, "", ""])
        photons = 20_000 if quick else 500_000
        for mm in (0.1, USUAL) if quick else (0.1, USUAL, 0.6):
            made = _layers(iris, ij.extinction(SHOWN), mm / USUAL)
            for i, name in enumerate(SHOWN):
                mean, error = _monte_carlo(made, i, photons, rng)
                for e in range(len(mean)):
                    angle = float(np.degrees(np.arccos(exits[e])))
                    for row in rows:
                        if row[:4] == [level, name, mm, 0] and np.isclose(row[4], angle):
                            row[-2:] = [float(mean[e]), float(error[e])]
    # The cell next to grazing is left out: the BRDF bends over it, and its middle is not its mean.
    seen = [(row[6], row[8], row[9]) for row in rows if row[8] != "" and row[4] < 85]
    z = np.asarray([(mc - exact) / error for exact, mc, error in seen if error > 0])
    print(
        f"Monte Carlo against depth-resolved, {z.size} values: |z| ≤ {np.abs(z).max():.2f}, mean "
        f"z² {np.mean(z**2):.2f}"
    )
    write(
        out / "integrators.csv",
        (
            "simulated by irisjax; BRDF (1/sr) in the chamber, ABL fraction 0.5, exits on the "
            "light's far side;",
            "stroma_mm: thickness at constant concentrations; luminance: D65, relative to a white "
            "of BRDF 1;",
            f"ilit: process ilit-2006; single_scattering: as F09, layers of the chamber's index; "
            f"{photons} photons in",
            "cells of the cosine 0.1 wide, radiative transfer with Fresnel's interfaces",
        ),
        (
            "level",
            "wavelength_nm",
            "stroma_mm",
            "incidence_deg",
            "exit_deg",
            "ilit",
            "depth_resolved",
            "single_scattering",
            "monte_carlo",
            "standard_error",
        ),
        rows,
    )


def _layers(iris, table, scale):
    return texel_layers(iris, ij.Eye().aqueous_index, table, Scales(stroma=scale))


@jax.jit
def _models(iris, thickness, mu, exits):
    """ILIT, depth-resolved, single scattering, shapes (thicknesses, wavelengths, exits); and the
    solver's status.
    """
    table, scales = ij.extinction(GRID), thickness / USUAL

    def solved(solver):
        def one(scale):
            found = solver.solve(_layers(iris, table, scale), ij.Light(mu, ij.Directions(exits)))
            return found.brdf, found.status

        return jax.lax.map(one, scales)

    bands = Bands(
        tuple(GRID.tolist()), jnp.eye(GRID.size), jnp.ones(GRID.size), tuple(map(str, GRID))
    )
    response = SingleScattering().response(iris, ij.Eye().aqueous_index, bands, Scales())
    towards = jnp.stack([jnp.sqrt(1 - mu**2), jnp.zeros(()), mu])
    n = exits.size
    here, zero = jnp.full(n, 3.0), jnp.zeros(n)
    # Lines of sight against light that goes on along x.
    sight = -jnp.sqrt(1 - exits**2), zero, exits
    pixels = IrisPixels(None, (here, zero, zero), sight, exits, jnp.ones(n))

    def marched(scale):
        maps = {"stroma_depth": jnp.full((2, 2), scale * iris.stroma_thickness)}
        light = jnp.broadcast_to(towards[:, None, None], (1, 3, 2, 2))
        data = MarchedScene(maps, light, jnp.ones((len(light), 1)), Eye(cornea=None, sclera=None))
        return response.shade(pixels, None, (data, None)) / mu

    ilit, _ = solved(ij.IlitExact(24))
    deep, status = solved(ij.RadiativeExact(24, n_panels=2))
    return (ilit, deep, jax.lax.map(marched, scales)), status


def _monte_carlo(layers, i, photons, rng):
    """BRDF in cells of the exit cosine and its standard error: normal incidence, photons weighted
    by absorption.
    """
    n_out, n_abl, n_stroma, n_ipe = (float(x) for x in jax.tree.leaves(layers.indices))
    abl, tau, albedo = (
        float(np.asarray(x)[i]) for x in (layers.abl_absorption, layers.extinction, layers.albedo)
    )

    def passes(mu, here, ahead):
        """Whether each photon is refracted, and its cosine beyond."""
        square = 1 - (here / ahead) ** 2 * (1 - mu**2)
        beyond = np.sqrt(np.maximum(square, 0))
        s = (here * mu - ahead * beyond) / (here * mu + ahead * beyond)
        p = (ahead * mu - here * beyond) / (ahead * mu + here * beyond)
        return (square > 0) & (rng.random(mu.size) >= (s * s + p * p) / 2), beyond

    entered = 1 - ((n_out - n_abl) / (n_out + n_abl)) ** 2
    mu, weight = np.ones(photons), np.full(photons, entered)  # mu > 0: downwards
    z, in_abl, scattered = np.zeros(photons), np.ones(photons, bool), np.zeros(photons, bool)
    total, square = np.zeros(CELLS.size - 1), np.zeros(CELLS.size - 1)
    while mu.size:
        down, size = mu > 0, np.abs(mu)
        weight = np.where(in_abl, weight * np.exp(-abl / size), weight)
        z = np.where(in_abl, z, z + mu * rng.exponential(size=mu.size))
        hit = ~in_abl & (z > 0) & (z < tau)
        here = np.where(in_abl, n_abl, n_stroma)
        ahead = np.where(in_abl, np.where(down, n_stroma, n_out), np.where(down, n_ipe, n_abl))
        crossed, beyond = passes(size, here, ahead)
        crossed &= ~hit
        # Rayleigh: the root of c³ + 3c = 4(2u − 1), about a direction of any azimuth.
        h = 2 * (2 * rng.random(mu.size) - 1)
        root = np.cbrt(h + np.sqrt(1 + h * h))
        c = root - 1 / root
        turned = mu * c + np.sqrt((1 - mu**2) * np.maximum(1 - c * c, 0)) * np.cos(
            2 * np.pi * rng.random(mu.size)
        )
        out = crossed & in_abl & ~down
        leaving = out & scattered
        cell = np.minimum((beyond[leaving] * (CELLS.size - 1)).astype(int), CELLS.size - 2)
        total += np.bincount(cell, weight[leaving], CELLS.size - 1)
        square += np.bincount(cell, weight[leaving] ** 2, CELLS.size - 1)
        weight = np.where(hit, weight * albedo, weight)
        scattered |= hit
        mu = np.where(hit, turned, np.where(crossed, np.sign(mu) * beyond, -mu))
        z = np.where(hit, z, np.where(in_abl, 0.0, np.clip(z, 0, tau)))
        gone = out | (crossed & ~in_abl & down) | (weight < 1e-9)
        in_abl = in_abl ^ crossed
        mu, weight, z, in_abl, scattered = (x[~gone] for x in (mu, weight, z, in_abl, scattered))
    scale = np.pi * (CELLS[1:] ** 2 - CELLS[:-1] ** 2) * photons
    return total / scale, np.sqrt(square) / scale


if __name__ == "__main__":
    start(main, __doc__)
