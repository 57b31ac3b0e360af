"""Models side by side: who is compared, what is said, and that the maker of the data wins."""

import inspect
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import irisjax as ij
from experiments.closed_formulas import KubelkaMunk
from irisjax.cli.sentences import process_lines
from irisjax.infer.analysis import reported
from irisjax.infer.model_comparison import (
    Interval,
    Moved,
    ProcessComparison,
    candidates_of,
    compare_models,
    noise_left,
)
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import OF_POWER_LAW
from irisjax.tissue.scattering import PowerLaw

GRID = np.arange(400.0, 701.0, 20.0)
FREE = ("melanin_load", "abl_fraction", "noise")


@pytest.fixture(scope="module")
def blank():
    with jax.enable_x64(True):
        return ij.spectrum(GRID, np.full(GRID.size, 0.05), sd=np.full(GRID.size, 0.01), name="eye")


def measured(problem, truth, blank, other=None):
    """A problem with noisy data that one, or another, makes of its true values."""
    (model,) = problem.predict(problem.standard(truth))
    sd = 0.02 * model + 2e-4
    seen = model + sd * jax.random.normal(jax.random.key(1), model.shape)
    return (other or problem).with_observations(with_values(blank, seen, sd))


@pytest.mark.parametrize("first", [ij.ILIT_CORRECTED, ij.DEPTH_RESOLVED])
def test_the_own_process_comes_first(blank, first):
    how = {"process": first}
    if first == ij.ILIT_CORRECTED:  # has no table in the package
        how = {"solver": ij.IlitExact(12, process=first)}
    found = candidates_of(ij.problem(blank, free=FREE, **how))
    names, (own, other, general) = list(found), found.values()
    assert own.process == first
    assert {*names[:2]} == {"ILIT", "radiative transfer"}
    assert (own.free, own.priors) == (other.free, other.priors)
    assert names[2] == "general radiative transfer"
    assert set(general.free) == {*FREE, *OF_POWER_LAW}
    # And a power law where the problem has one.
    found = candidates_of(general)
    assert list(found) == [names[2], "radiative transfer", "ILIT"]
    assert [p.free for p in found.values()] == [general.free, FREE, FREE]


def test_one_model_is_no_comparison(blank):
    problem = ij.problem(blank, free=FREE, solver=KubelkaMunk())
    for few in ({}, {"A": problem}):
        with pytest.raises(ValueError, match="two or more models"):
            compare_models(problem, few, key=jax.random.key(0))


@pytest.mark.peer
def test_the_maker_of_the_data_is_preferred(blank):
    problem = ij.problem(blank, free=FREE, process=ij.DEPTH_RESOLVED)
    problem = measured(problem, {"melanin_load": 0.1, "abl_fraction": 0.4, "noise": 1.0}, blank)
    told = []
    own, other = compare_models(
        problem,
        dict(list(candidates_of(problem).items())[:2]),
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
    assert other.name == "ILIT" and ratio.value > 1.5
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
    plain = measured(maker, rest | true, blank, plain)
    by_fibrils, by_law = compare_models(
        plain, dict(list(candidates_of(plain).items())[::2]), key=jax.random.key(2)
    )
    assert by_law.name == "general radiative transfer"
    assert by_law.evidence.log_integral - by_fibrils.evidence.log_integral > 10
    draws = reported(by_law.problem, by_law.evidence.samples)
    for name, value in true.items():
        assert draws[name].min() < value < draws[name].max()


@pytest.mark.parametrize(
    ("other", "differs", "said"),
    [
        ((0.2, 0.15, 0.25), True, "2 times less"),
        ((0.8, 0.7, 0.9), True, "2 times more"),
        ((0.41, 0.3, 0.5), False, "about the same"),
        ((0.2, 0.15, 0.45), False, "2 times less"),
    ],
)
def test_what_is_said(other, differs, said):
    moved = {"melanin_load": Moved(Interval(0.4, 0.35, 0.45), Interval(*other))}
    assert moved["melanin_load"].differs == differs
    (line,) = process_lines(ProcessComparison(ij.DEPTH_RESOLVED, moved, -5.0))
    assert line.startswith("WARNING") == differs
    assert line.endswith(said)


def test_noise_is_no_less_than_stated():
    def left(*chi_squares):
        fits = (SimpleNamespace(chi_square=c, degrees=10) for c in chi_squares)
        # Unchecked: these are no fits.
        return inspect.unwrap(noise_left)(*fits)

    assert left(5.0, 90.0) == 1
    assert left(90.0, 40.0) == pytest.approx(2)
    assert np.isfinite(left(0.0, 0.0))
