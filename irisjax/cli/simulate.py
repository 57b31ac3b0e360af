"""`irisjax simulate-measurement`: a spectrum with errors, and its truth."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.cli import model
from irisjax.cli.files import TableFile, check_files, settings, write_table
from irisjax.cli.light import NoisyLight
from irisjax.cli.options import grouped
from irisjax.infer.parameters import of_iris
from irisjax.transport.process import AbstractProcess


@grouped
def simulate_measurement_command(
    iris: model.IrisOptions, process: model.ProcessOptions, light: NoisyLight, files: TableFile
) -> None:
    """Simulate a noisy spectrum of an iris, with its truth in the header, to try `irisjax fit`."""
    check_files(files.output)
    eye, rules = model.modelled(iris, process)
    truth = {n: float(v) for n, v in of_iris(eye).items() if n != "noise"}
    truth["gain"] = light.gain
    lines = {
        "irisjax": ij.__version__,
        "simulated": "noisy reflectance of a modelled human iris, not a measurement",
        "command": "simulate-measurement",
        **settings(eye, rules, iris, process, light),
        "truth": ", ".join(f"{name} = {value:.6g}" for name, value in truth.items()),
    }
    scans = _scans(eye, rules, light, truth)
    names = ["reflectance"] if len(scans) == 1 else [f"scan_{i + 1}" for i in range(len(scans))]
    columns = {"wavelength_nm": light.wavelengths.values, **dict(zip(names, scans, strict=True))}
    write_table(files, lines, columns)


def _scans(
    iris: ij.Iris, process: AbstractProcess, light: NoisyLight, truth: dict[str, float]
) -> list[np.ndarray]:
    """Scans of the iris's reflectance, each of shape (wavelengths,)."""
    grid = light.wavelengths.values
    levels: Any = light.relative_noise, light.absolute_noise
    seen = ij.spectrum(grid, np.zeros(grid.size), **light.before_the_iris())
    problem = ij.problem(
        seen,
        free=["noise"],
        fixed={"gain": light.gain},
        base=iris,
        solver=model.exact_solver(process, iris),
        noise=ij.Noise(*levels),
    )
    key = jax.random.key(light.seed, impl="threefry2x32")
    draw = jax.jit(lambda k: problem.simulate(jnp.zeros(1), k)[0])
    return [np.asarray(draw(jax.random.fold_in(key, i))) for i in range(light.scans)]
