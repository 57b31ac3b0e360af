"""At which few wavelengths must a picture be computed? Nodes and the matrix that fills in the rest.

A thousand irides drawn widely; nodes moved one by one until the largest colour difference under D65
and A is smallest; the matrix is least squares. The error is then measured on a thousand other
irides, also under FL11. The table that ships with the package is `rendering_bands.csv` of this run.
"""

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.measure.colour import OBSERVER, tristimulus_matrix
from irisjax.tissue.pigments import extinction

GRID = 380 + 5.0 * np.arange(81)
LIGHTS = ("D65", "A", "FL11")


def main(key, quick=False, out=RESULTS):
    """Write nodes with their matrix, and colour differences by illuminant (quick: 12 irides, 4
    nodes).
    """
    from colour.difference import delta_E_CIE2000

    count, n = (12, 4) if quick else (1000, 10)
    made, other = (_spectra(jax.random.fold_in(key, i), count) for i in range(2))
    weights = [np.asarray(tristimulus_matrix(GRID, "XYZ", light, OBSERVER)[0]) for light in LIGHTS]
    scaled = made / (
        np.linalg.norm(made, axis=1, keepdims=True) + 1e-3
    )  # dark irides count as much as bright ones

    def matrix(nodes):
        return np.linalg.lstsq(scaled[:, nodes], scaled, rcond=None)[0]

    def differences(nodes, spectra, light):
        found = spectra[:, nodes] @ matrix(nodes)
        return delta_E_CIE2000(
            *(_lab(s @ weights[light].T, weights[light].sum(1)) for s in (spectra, found))
        )

    def worst(nodes):
        return max(differences(nodes, made, light).max() for light in (0, 1))

    nodes = np.round(np.linspace(4, 58, n)).astype(int)
    best, better = worst(nodes), True
    while better:
        better = False
        for i in range(n):
            for step in (-2, -1, 1, 2):
                moved = np.sort(np.where(np.arange(n) == i, nodes + step, nodes))
                if len(set(moved)) == n and (found := worst(moved)) < best - 1e-4:
                    best, nodes, better = found, moved, True
    header = (
        f"least squares of {count} simulated irides of process ilit-2006 (drawn widely around "
        f"LB06's): reflectance at",
        "each wavelength of the columns is the sum over rows of reflectance at the row's "
        "wavelength times the entry",
    )
    columns = ("wavelength_nm", *(f"to_{x:g}" for x in GRID))
    rows = [(float(GRID[j]), *map(float, row)) for j, row in zip(nodes, matrix(nodes), strict=True)]
    write(out / "rendering_bands.csv", header, columns, rows)
    errors = []
    for i, light in enumerate(LIGHTS):
        d = differences(nodes, other, i)
        errors.append((light, count, float(d.mean()), float(np.percentile(d, 99)), float(d.max())))
    write(
        out / "rendering_bands_error.csv",
        (
            f"colour differences of {n} wavelengths against 81, on irides the nodes were not "
            f"chosen from",
        ),
        ("illuminant", "irides", "mean_dE2000", "p99_dE2000", "max_dE2000"),
        errors,
    )


def _spectra(key, count):
    """Reflectances (count, 81) of irides drawn widely."""

    def between(i, low, high):
        u = jax.random.uniform(jax.random.fold_in(key, i), (count,))
        return jnp.exp(jnp.log(low) + u * (jnp.log(high) - jnp.log(low)))

    eumelanin = between(0, 1e-3, 8.0)
    drawn = {
        "eumelanin": eumelanin,
        "pheomelanin": eumelanin * between(1, 0.05, 1.5),
        "abl_fraction": jax.random.uniform(jax.random.fold_in(key, 2), (count,)),
        "oxyhemoglobin": between(3, 1e-3, 0.3),
        "deoxyhemoglobin": between(4, 1e-3, 0.3),
        "stroma_thickness": between(5, 0.05, 0.6),
        "lutein": between(6, 1e-5, 1e-3),
    }
    table = extinction(GRID)

    def reflectance(fields):
        layers = ij.Iris().replace(**fields).layers(table)
        return ij.IlitExact(24).solve(layers, ij.Light(1.0)).reflectance

    return np.asarray(jax.jit(jax.vmap(reflectance))(drawn))


def _lab(xyz, white):
    ratio = xyz / white
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=-1
    )


if __name__ == "__main__":
    start(main, __doc__)
