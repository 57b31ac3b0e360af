"""Models side by side: who is compared, what is said, and that the maker of the data wins."""

import jax
import numpy as np
import pytest

import irisjax as ij
from common import slowly
from irisjax.infer.analysis import reported
from irisjax.infer.analytic import KubelkaMunk
from irisjax.infer.model_comparison import Candidate, candidates_of, compare_models
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import Interval
from irisjax.infer.parameters import OF_POWER_LAW
from irisjax.tissue.scattering import PowerLaw

GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "noise")


@pytest.fixture(scope="module")
def blank():
    with jax.enable_x64(True):
        return ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01), name="eye")


@pytest.mark.parametrize("first", [ij.ILIT_2006, ij.ILIT_CORRECTED, ij.DEPTH_RESOLVED])
def test_the_own_process_comes_first(blank, first):
    own, other, general = candidates_of(ij.problem(blank, free=FREE, process=first))
    assert own.problem.process == first
    assert {own.name, other.name} == {"ILIT", "radiative transfer"}
    assert own.problem.free == other.problem.free
    assert own.problem.priors == other.problem.priors
    assert general.name == "general radiative transfer"
    assert set(general.problem.free) == {*FREE, *OF_POWER_LAW}


def test_a_power_law_comes_first_where_the_problem_has_one(blank):
    problem = ij.problem(blank, free=FREE, process=ij.DEPTH_RESOLVED).under(PowerLaw())
    general, plain, ilit = candidates_of(problem)
    assert general.problem.free == problem.free
    assert (plain.name, ilit.name) == ("radiative transfer", "ILIT")
    assert plain.problem.free == ilit.problem.free == FREE


def test_one_model_is_no_comparison(blank):
    problem = ij.problem(blank, free=FREE, solver=KubelkaMunk())
    for few in ([], [Candidate("A", problem)], [Candidate("A", problem)] * 2):
        with pytest.raises(ValueError, match="two or more models"):
            compare_models(problem, few, key=jax.random.key(0))


@pytest.mark.peer
@pytest.mark.parametrize("maker", [slowly(ij.ILIT_2006), ij.DEPTH_RESOLVED])
def test_the_maker_of_the_data_is_preferred(blank, maker):
    problem = ij.problem(blank, free=FREE, process=maker)
    z = problem.standard({"melanin_load": 0.1, "abl_fraction": 0.4, "noise": 1.0})
    (model,) = problem.predict(z)
    sd = 0.02 * model + 2e-4
    seen = model + sd * jax.random.normal(jax.random.key(1), model.shape)
    problem = problem.with_observations(with_values(blank, seen, sd))
    told = []
    own, other = compare_models(
        problem,
        candidates_of(problem)[:2],
        progress=lambda name, steps: told.append(name),
        key=jax.random.key(2),
    )
    assert own.evidence.log_integral - other.evidence.log_integral > 3
    assert own.score > other.score
    load = own.values["melanin_load"]
    assert load.low < 0.1 < load.high
    assert own.ratios["melanin_load"] == Interval(1.0, 1.0, 1.0)
    ratio = other.ratios["melanin_load"]
    assert ratio.low < other.values["melanin_load"].value / load.value < ratio.high
    assert (ratio.value > 1.5) == (other.name == "ILIT")
    assert np.abs(own.residuals[0]).max() < 4
    assert list(dict.fromkeys(told)) == [own.name, other.name]


@pytest.mark.slow
def test_scattering_of_real_tissue_is_told_from_fibrils():
    """Data of a power law with large scatterers, which the formula of fibrils cannot follow."""
    grid = GRID[::2]  # half the time
    blank = ij.spectrum(grid, np.full(grid.size, 0.05), sd=np.full(grid.size, 0.01), name="eye")
    plain = ij.problem(blank, free=FREE, process=ij.DEPTH_RESOLVED)
    maker = plain.under(PowerLaw())
    true = {"rayleigh_share": 0.1, "scattering_power": 0.8, "anisotropy": 0.85}
    rest = {"melanin_load": 0.1, "abl_fraction": 0.4, "noise": 1.0, "reduced_scattering": 3.0}
    z = maker.standard(rest | true)
    (model,) = maker.predict(z)
    sd = 0.02 * model + 2e-4
    seen = model + sd * jax.random.normal(jax.random.key(1), model.shape)
    plain = plain.with_observations(with_values(blank, seen, sd))
    by_fibrils, by_law = compare_models(
        plain,
        candidates_of(plain)[::2],
        key=jax.random.key(2),
    )
    assert by_law.name == "general radiative transfer"
    assert by_law.evidence.log_integral - by_fibrils.evidence.log_integral > 10
    draws = reported(by_law.candidate.problem, by_law.evidence.samples)
    for name, value in true.items():
        assert draws[name].min() < value < draws[name].max()
