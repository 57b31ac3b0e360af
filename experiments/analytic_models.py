"""Can simple absorption produce an iris's spectra? Closed formulas fitted to ILIT and to
depth-resolved spectra.

LB06 says that it cannot. Every formula is fitted by maximum likelihood (optimistix), with load,
fraction, pheomelanin share, haemoglobin, saturation, the scatterers' strength and the gain all
free, without priors that could hold it back. Residuals are given in per cent of the spectrum.
"""

import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.closed_formulas import BeerLambert, FirstOrder, KubelkaMunk
from experiments.common import RESULTS, start, write
from irisjax.infer.fit import fit
from irisjax.infer.noise import Noise
from irisjax.infer.observation import with_values
from irisjax.infer.priors import LogNormal

MODELS = {
    "Beer-Lambert": BeerLambert(),
    "Kubelka-Munk, two layers": KubelkaMunk(),
    "single scattering": FirstOrder(),
    "ILIT (LB06)": None,
    "depth-resolved": ij.RadiativeExact(16, 8),
}
FREE = (
    "melanin_load",
    "abl_fraction",
    "pheomelanin_share",
    "hemoglobin",
    "saturation",
    "scattering_scale",
    "gain",
)
WIDE = {
    "gain": LogNormal(1.0, 1.0),
    "scattering_scale": LogNormal(1.0, 1.0),
    "hemoglobin": LogNormal(0.084, 1.5),
}


def main(key, quick=False, out=RESULTS):
    """Write residuals by wavelength and their root mean squares (quick: one formula and one
    level, coarse).
    """
    grid = ij.wavelengths(400, 700, 50 if quick else 10)
    rows, summary = [], []
    targets = {"ilit-2006": ij.IlitExact(), "depth-resolved": ij.RadiativeExact()}
    if quick:
        del targets["depth-resolved"]
    truths = {}
    for target, solver in targets.items():
        for level in ("low",) if quick else ("low", "moderate", "high"):
            truths[target, level] = ij.reflectance(
                ij.Iris.of_level(level), grid, solver=solver
            ).values
    for model, solver in list(MODELS.items())[: 1 if quick else None]:
        blank = ij.spectrum(grid, np.ones(grid.size))
        problem = ij.problem(
            blank,
            free=FREE,
            priors=WIDE,
            noise=Noise(0.01, 1e-6),
            solver=solver,
            base=ij.Iris.of_level("moderate"),
        )
        for (target, level), truth in truths.items():
            o = with_values(problem.observations[0], jnp.asarray(truth))
            found = fit(
                problem.with_observations(o), use_priors=False, starts=2 if quick else 12, key=key
            )
            residual = 100 * np.asarray(found.predicted[0] / truth - 1)
            rows += [
                (model, target, level, float(x), float(r), float(t), float(m))
                for x, r, t, m in zip(
                    grid, residual, np.asarray(truth), np.asarray(found.predicted[0]), strict=True
                )
            ]
            worst = int(np.abs(residual).argmax())
            numbers = (
                float(np.sqrt((residual**2).mean())),
                float(residual[worst]),
                float(grid[worst]),
            )
            values = [float(found.values[n]) for n in FREE]
            summary.append((model, target, level, str(bool(found.converged)), *numbers, *values))
    header = (
        "simulated spectra, closed formulas fitted by least squares on 1 % relative noise; no "
        "priors",
    )
    columns = (
        "model",
        "target",
        "level",
        "wavelength_nm",
        "residual_percent",
        "target_reflectance",
        "fitted",
    )
    write(out / "analytic_residuals.csv", header, columns, rows)
    write(
        out / "analytic_summary.csv",
        header,
        (
            "model",
            "target",
            "level",
            "converged",
            "rms_percent",
            "worst_percent",
            "worst_at_nm",
            *FREE,
        ),
        summary,
    )


if __name__ == "__main__":
    start(main, __doc__)
