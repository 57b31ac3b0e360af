"""Models side by side: who is compared, what is said, and that the maker of the data wins."""

import jax
import numpy as np
import pytest

import irisjax as ij
from common import slowly
from irisjax.infer import model_comparison
from irisjax.infer.analytic import KubelkaMunk
from irisjax.infer.evidence import Evidence
from irisjax.infer.model_comparison import (
    Assessment,
    Candidate,
    candidates_of,
    compare_models,
    comparison_sentence,
)
from irisjax.infer.observation import with_values
from irisjax.infer.other_process import Interval
from irisjax.infer.parameters import OF_POWER_LAW
from irisjax.infer.summary import reported
from irisjax.tissue.scattering import PowerLaw

GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "noise")


@pytest.fixture(scope="module")
def blank():
    with jax.enable_x64(True):
        return ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01), name="eye")


def assessed(name, problem, log_evidence, load):
    found = Evidence(log_evidence, 0.2, np.zeros((2, 3)), 2.0, 8)
    values = {"melanin_load": Interval(load, load / 2, load * 2)}
    ratios = {"melanin_load": Interval(load / 0.1, load / 0.2, load / 0.05)}
    return Assessment(Candidate(name, problem), found, 1.0, 0.1, values, ratios, (), ())


@pytest.mark.parametrize("first", [ij.ILIT_2006, ij.ILIT_CORRECTED, ij.DEPTH_RESOLVED])
def test_the_own_process_comes_first(blank, first):
    own, other, general = candidates_of(ij.problem(blank, free=FREE, process=first))
    assert own.problem.process == first
    assert {own.name, other.name} == {"ILIT", "radiative transfer"}
    assert own.problem.free == other.problem.free
    assert own.problem.priors == other.problem.priors
    assert not (own.by_importance or other.by_importance)
    # A spectrum of a power law takes too long for nesting.
    assert general.by_importance
    assert set(general.problem.free) == {*FREE, *OF_POWER_LAW}


def test_a_power_law_comes_first_where_the_problem_has_one(blank):
    problem = ij.problem(blank, free=FREE, process=ij.DEPTH_RESOLVED).under(PowerLaw())
    general, plain, ilit = candidates_of(problem)
    assert general.problem.free == problem.free
    assert (plain.name, ilit.name) == ("radiative transfer", "ILIT")
    assert plain.problem.free == ilit.problem.free == FREE


@pytest.mark.parametrize(
    ("apart", "said"),
    [
        (10.0, "prefer A to B by odds of 22,000 to 1"),
        (-100.0, "prefer B to A by odds of 1e43 to 1"),
        (3.2, "do not decide between A and B"),  # 20 to 1, but for the errors
        (0.0, "do not decide between"),
    ],
)
def test_what_is_said(blank, apart, said):
    problem = ij.problem(blank, free=FREE, solver=KubelkaMunk())
    found = assessed("A", problem, 50.0 + apart, 0.1), assessed("B", problem, 50.0, 0.25)
    sentence = comparison_sentence(found)
    assert sentence.startswith(f"The data (eye) {said}")
    assert sentence.count(".\n") == 0
    assert sentence.endswith(
        "melanin load, ug/mm2 (95 %): 0.1 (0.05 to 0.2) by A, 0.25 (0.125 to 0.5) by B, "
        "2.5 (1.2 to 5) times that."
    )


def test_one_model_is_no_comparison(blank, monkeypatch):
    monkeypatch.setattr(model_comparison, "check_sampler", lambda: None)
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
        live=200,
        progress=lambda name, steps: told.append(name),
        key=jax.random.key(2),
    )
    assert own.evidence.log_evidence - other.evidence.log_evidence > 3
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
        [c._replace(by_importance=True) for c in candidates_of(plain)[::2]],
        key=jax.random.key(2),
    )
    assert by_law.name == "general radiative transfer"
    assert by_law.evidence.log_evidence - by_fibrils.evidence.log_evidence > 10
    draws = reported(by_law.candidate.problem, by_law.evidence.z)
    for name, value in true.items():
        assert draws[name].min() < value < draws[name].max()
    assert "prefer general radiative transfer" in comparison_sentence([by_fibrils, by_law])
