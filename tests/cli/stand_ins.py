"""What stands in for the solver and the sampler where a test looks at files and messages only."""

import importlib
import sys
from contextlib import nullcontext
from types import SimpleNamespace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from irisjax.cli import model, report
from irisjax.infer import draws
from irisjax.infer.analysis import Analysis, PredictiveCheck, summarise
from irisjax.infer.identifiability import Direction, Information
from irisjax.infer.model_comparison import COMPARED, Interval, Moved, ProcessComparison
from irisjax.infer.parameters import kind
from irisjax.infer.posterior import Chains, ChainStatus
from irisjax.plot.beside import here
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import RESULTS, Absorbed
from irisjax.transport.solver import AbstractSolver

FREE = ("--free", "melanin_load,hemoglobin", "--walkers", "16")


def truth_of(path):
    """Read the parameters that a simulated measurement was made with."""
    line = path.read_text().split("# truth: ")[1].splitlines()[0]
    pairs = (pair.split(" = ") for pair in line.split(", "))
    return {name: float(value) for name, value in pairs}


class Quick(AbstractSolver):
    """No light transport: a formula that tells all layers, switches and directions apart."""

    name: str = eqx.field(static=True, default="quick")
    process: AbstractProcess = eqx.field(default=ij.ILIT_2006, kw_only=True)

    def solve(self, layers, light, *, key=None):
        n = layers.indices
        said = self.process.describe()
        switches = (
            said.get("phase") == "rayleigh",
            said.get("rescatter") == "retest",
            said.get("perturb_on_reflection", False),
            not said,
        )
        cosine = 0.3 if light.cosine is None else light.cosine
        bent = cosine * n.aqueous / (n.abl * n.stroma * n.ipe)
        factor = 1 + 0.01 * sum(on / 2**i for i, on in enumerate(switches)) + 0.1 * bent
        back = 0.3 * factor * layers.albedo * jnp.exp(-2 * layers.abl_absorption)
        back = back * -jnp.expm1(-layers.extinction)
        mirrored = 0.01 * cosine * jnp.ones_like(back)
        rest, ipe = 1 - back - mirrored, layers.ipe_absorption
        behind = None if ipe is None else rest * jnp.exp(-ipe)
        brdf = None
        if light.exits is not None:
            cosine, azimuth = light.exits.cosine, light.exits.azimuth
            brdf = back[:, None] * cosine * (1 + 0.1 * jnp.cos(azimuth)) / jnp.pi
        return ij.Solution(
            reflectance=back,
            mirrored=mirrored,
            absorbed=Absorbed(
                abl=0 * back, stroma=0 * back, ipe=rest if behind is None else rest - behind
            ),
            transmitted=behind,
            standard_error=None,
            total_error=None,
            brdf=brdf,
            brdf_error=None,
            status=RESULTS.where(layers.valid(), RESULTS.successful, RESULTS.invalid_input),
        )


def with_quick(monkeypatch):
    true = ij.problem
    # Figures in this process; corner would load ArviZ, for seconds.
    if "arviz" not in sys.modules:
        monkeypatch.setitem(sys.modules, "arviz", None)
    command = importlib.import_module("irisjax.cli.fit")
    monkeypatch.setattr(command, "beside", lambda: nullcontext(here))
    monkeypatch.setattr(model, "exact_solver", lambda p, iris=None, **how: Quick(process=p))

    def problem(*given, process=ij.ILIT_2006, solver=None, **stated):
        process = process if solver is None else solver.process
        return true(*given, **stated, solver=Quick(process=process))

    monkeypatch.setattr(ij, "problem", problem)


class Sampled(NamedTuple):
    """What `report.analyse` was called with."""

    problem: ij.Problem
    walkers: int
    key: jax.Array
    max_steps: int
    resume: bool
    went_on: bool  # there was a chain already


def without_search(monkeypatch):
    """Neither search nor sampler nor checks: a cloud of samples. Returns the list of calls."""
    calls = []

    def analyse(problem, *, store, resume, progress, key, **settings):
        went_on = store is not None and store.exists()
        calls.append(Sampled(problem, **settings, key=key, resume=resume, went_on=went_on))
        if store is not None:
            store.write_text("chain")
        progress(10, "sampling")
        free, steps = len(problem.free), settings["max_steps"]
        shape = (50, settings["walkers"])
        z = np.random.default_rng(np.asarray(jax.random.key_data(key))).normal(
            0, 0.1, (*shape, free)
        )
        each = np.full(free, 1000.0)
        reason = "" if steps > 100 else f"{steps} steps are not enough"
        ended = ChainStatus.successful if not reason else ChainStatus.few_autocorrelation_times
        chains = Chains(
            z, z[..., 0], 1, steps, 0.5, each / 100, each, each, each / 1000, ended, reason
        )
        rows = summarise(problem, chains)
        moved = {
            r.parameter: Moved(
                Interval(r.median, r.q2_5, r.q97_5), Interval(r.median / 2, r.median / 3, r.median)
            )
            for r in rows
            if r.parameter in problem.free and kind(r.parameter) in COMPARED
        }
        known = [Direction({"melanin_load": 1.0}, 0.1)]
        return Analysis(
            problem=problem,
            fit=SimpleNamespace(converged=True),
            chains=chains,
            rows=rows,
            check=PredictiveCheck(0.5, 0.5, 1.0),
            information=Information(("melanin_load",), np.eye(1), known, {}, {}),
            other=ProcessComparison(ij.DEPTH_RESOLVED, moved, -1.0),
        )

    def predictive(problem, chains, count=20, *, key):
        values = tuple(np.tile(np.asarray(o.values), (count, 1)) for o in problem.observations)
        return values, values

    def predicted(problem, z, key):
        random = np.random.default_rng(0)
        sizes = [o.values.size for o in problem.observations]
        # arviz asks for tails that vary.
        drawn = tuple(random.normal(size=(len(z), size)) for size in sizes)
        return drawn, drawn, drawn, drawn, np.asarray(z)

    monkeypatch.setattr(report, "analyse", analyse)
    monkeypatch.setattr(report, "predictive", predictive)
    monkeypatch.setattr(draws, "predicted", predicted)
    return calls
