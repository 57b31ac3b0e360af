"""From settings to a measurement: the iris, the solver, photons in blocks, and what the header says
of it.
"""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.cli.settings import header
from irisjax.infer.parameters import of_iris
from irisjax.tissue.iris import LIMITS
from irisjax.transport.montecarlo import Counts, MonteCarlo
from irisjax.transport.process import PROCESSES
from irisjax.transport.solver import AbstractSolver

_BLOCK = (
    1 << 22
)  # photons of all wavelengths together between two looks at the progress bar and at Ctrl-C


def problem(values: Mapping[str, Any]) -> tuple[ij.Iris, np.ndarray, dict[str, Any]]:
    """Iris, wavelengths, and the options every instrument takes."""
    fields = {name: values[name] for name in (*LIMITS, "melanin_load") if values[name] is not None}
    iris = ij.Iris.preset(values["level"]).replace(**fields)
    process = process_of(values)
    options: dict[str, Any] = {
        "process": process,
        "cos_incidence": values["cos_incidence"],
        "solver": ij.Exact(),
    }
    if values["solver"] == "monte-carlo":
        options["solver"] = MonteCarlo(values["photons"], estimator=values["estimator"])
        # The kind of key is fixed, whatever the environment prefers.
        options["key"] = jax.random.key(values["seed"], impl="threefry2x32")
    return iris, values["wavelengths"].values, options


def process_of(values: Mapping[str, Any]) -> ij.Process:
    """The process that the settings name."""
    changed = {
        name: values[name]
        for name in ("phase", "rescatter", "scattering")
        if values[name] is not None
    }
    if values["perturb_on_reflection"]:
        changed["perturb_on_reflection"] = True
    if values.get("cornea", "auto") != "auto":
        changed["cornea"] = values["cornea"]
    return dataclasses.replace(PROCESSES[values["process"]], **changed)


def simulated_measurement(values: Mapping[str, Any]):
    """Iris, wavelengths, process, and noisy scans (scans, wavelengths) of its reflectance."""
    fields = {name: values[name] for name in (*LIMITS, "melanin_load") if values[name] is not None}
    iris, process = ij.Iris.preset(values["level"]).replace(**fields), process_of(values)
    grid = values["wavelengths"].values
    observation = ij.spectrum(
        grid,
        np.zeros(grid.size),
        cos_incidence=values["cos_incidence"],
        first_surface=values["first_surface"],
    )
    held = {n: float(v) for n, v in of_iris(iris).items()}
    held |= {n: values[n] for n in ("scattering_scale", "gain")}
    solver = ij.Exact()
    stated = ij.problem(
        observation,
        free=["noise"],
        fixed={n: v for n, v in held.items() if n != "noise"},
        base=iris,
        process=process,
        solver=solver,
        noise=ij.Noise(values["relative_noise"], values["absolute_noise"]),
    )
    key = jax.random.key(values["seed"], impl="threefry2x32")
    draw = jax.jit(lambda k: stated.simulate(jnp.zeros(1), k)[0])
    return (
        iris,
        grid,
        process,
        [np.asarray(draw(jax.random.fold_in(key, i))) for i in range(values["scans"])],
    )


def truth(iris: ij.Iris, values: Mapping[str, Any]) -> str:
    """The parameters of an inversion that made a simulated measurement."""
    known = {n: float(v) for n, v in of_iris(iris).items() if n != "noise"}
    known |= {n: values[n] for n in ("scattering_scale", "gain")}
    return ", ".join(f"{n} = {v:.6g}" for n, v in known.items())


def measured(
    instrument: Callable[..., Any], iris: ij.Iris, grid: np.ndarray, options: Mapping[str, Any]
):
    """What the instrument reads; photons followed one by one are followed in blocks, with a
    progress bar.
    """
    solver = options["solver"]
    if not isinstance(solver, MonteCarlo) or solver.estimator != "analog":
        return instrument(iris, grid, **options)
    from tqdm import tqdm

    # `delay`: runs of less than a second need no bar.
    bar = tqdm(
        total=solver.n_photons,
        unit="photon",
        unit_scale=True,
        delay=1,
        disable=not sys.stderr.isatty(),
    )
    with bar, jax.disable_jit():  # the blocks are a loop in Python, so that Ctrl-C gets through
        return instrument(
            iris,
            grid,
            **{**options, "solver": _InBlocks(solver, max(1, _BLOCK // grid.size), bar.update)},
        )


class _InBlocks(AbstractSolver):
    """A Monte Carlo solver that follows its photons `block` at a time and says so.

    Counts of blocks add, so the result does not depend on their size.
    """

    solver: MonteCarlo
    block: int = eqx.field(static=True)
    progress: Callable[[int], Any] = eqx.field(static=True)

    def prepare(self, layers, process) -> "_InBlocks":
        return dataclasses.replace(self, solver=self.solver.prepare(layers, process))

    def solve(
        self, layers, process, cos_incidence, *, cos_exit=None, azimuth=None, key=None, rays=None
    ):
        with jax.disable_jit(False):
            total: Counts | None = None
            for first in range(0, self.solver.n_photons, self.block):
                last = min(first + self.block, self.solver.n_photons)
                counts = self.solver.count(
                    layers,
                    process,
                    cos_incidence,
                    cos_exit=cos_exit,
                    key=key,
                    rays=rays,
                    first=first,
                    last=last,
                )
                total = counts if total is None else jax.tree.map(lambda a, b: a + b, total, counts)
                jax.block_until_ready(total)
                self.progress(last - first)
            assert total is not None  # there is at least one photon
            return self.solver.summarise(total, layers, process, cos_exit)


def directions(plane: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Exit angles from the normal and azimuths, radians; n over 180 degrees, grazing left out."""
    if plane == "principal":
        signed, _, azimuth = (np.asarray(a) for a in ij.principal_plane(n))
        return np.abs(signed), azimuth
    polar = (np.arange(n // 2) + 0.5) / (n // 2) * np.pi / 2
    azimuth = np.arange(n) / n * 2 * np.pi
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    return polar.ravel(), azimuth.ravel()


def head(
    command: str, quantity: str, values, iris: ij.Iris, options: Mapping[str, Any]
) -> dict[str, str]:
    """Header of a file: what it is, how far to trust it, and every setting."""
    process, solver = options["process"], options["solver"]
    return {
        "irisjax": ij.__version__,
        "simulated": f"{quantity} of a modelled human iris, not a measurement",
        "command": command,
        "approximation": _approximation(process),
        **header(command, values, iris, process),
        "transport": process.transport,
        "solver settings": ", ".join(
            f"{field.name} = {value}"
            for field in dataclasses.fields(solver)
            if (value := getattr(solver, field.name)) is not None
        ),
    }


def _approximation(process: ij.Process) -> str:
    """What a reader of the numbers must know about the process that made them."""
    if process.depth_resolved:
        return (
            "scalar theory, no polarisation: about 1.7 % low for a thin slab of Rayleigh scatterers"
        )
    ours, theirs = (
        ("0.0148", "darker than")
        if process.rescatter == "retest"
        else ("0.0405", "about twice as bright as")
    )
    return (
        f"ILIT tests whole layers at once: in the blue, light eyes come out {theirs} by "
        f"depth-resolved "
        f"transport of the same layers ({ours} against 0.0202 at 450 nm, low pigmentation, "
        f"rescatter = "
        f"{process.rescatter})"
    )
