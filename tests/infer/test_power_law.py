"""The inverse problem under a power law of scattering: its parameters, and its ridges."""

import inspect
from types import SimpleNamespace

import numpy as np
import pytest

import irisjax as ij
from irisjax.cli.sentences import information_lines
from irisjax.infer.identifiability import Direction, Information, information
from irisjax.infer.parameters import OF_POWER_LAW, iris_of

GRID = ij.wavelengths(450, 650, 100)
SEEN = ij.spectrum(GRID, np.full(GRID.size, 0.01))


def test_the_problem_under_a_power_law_frees_its_numbers():
    stated = ij.problem(SEEN, free=["melanin_load", "scattering_scale"])
    under = stated.under(ij.PowerLaw())
    assert under.free == ("melanin_load", *OF_POWER_LAW)
    assert under.process == ij.DEPTH_RESOLVED
    assert under.base.power_law is not None
    assert set(under.fixed) == {"scattering_scale", *stated.fixed}
    assert under.by(ij.ILIT_2006).free == ("melanin_load",)
    assert under.by(ij.ILIT_2006).base.power_law is None
    assert under.by(ij.DEPTH_RESOLVED).free == under.free
    back = under.under(None)
    assert back.free == ("melanin_load",) and not {*back.fixed} & {*OF_POWER_LAW}


def test_a_number_that_is_stated_makes_the_law():
    stated = ij.problem(
        SEEN, free=["reduced_scattering"], fixed={"anisotropy": 0.9}, process=ij.DEPTH_RESOLVED
    )
    assert float(stated.fixed["anisotropy"]) == 0.9
    assert float(stated.fixed["rayleigh_share"]) == float(ij.PowerLaw().rayleigh_share)


def test_its_numbers_are_those_of_the_iris():
    law = ij.PowerLaw(1.4, 0.2, 1.1, 0.8)
    stated = ij.problem(
        SEEN, free=OF_POWER_LAW, base=ij.Iris(power_law=ij.PowerLaw()), process=ij.DEPTH_RESOLVED
    )
    values = {n: float(v) for n, v in law.parameters().items()}
    made = iris_of(stated.values(stated.standard(values)), stated.base)
    assert {n: float(v) for n, v in made.power_law.parameters().items()} == pytest.approx(values)


def test_ridges_are_named():
    trades = {
        "reduced_scattering": (0.2, "stroma_thickness", -0.9),
        "anisotropy": (0.98, "gain", 0.1),
    }
    directions = [Direction({"reduced_scattering": 1.0}, 0.1)]
    found = Information(("reduced_scattering",), np.eye(1), directions, {}, trades)
    *_, reduced, anisotropy = information_lines(found)
    assert "reduced scattering: 20 % of its prior's width; trades with stroma thickness" in reduced
    assert anisotropy == "anisotropy: not determined by the data"


def test_the_ridge_of_the_formula_of_fibrils_is_named():
    names = ("melanin_load", "abl_fraction", "scattering_scale")
    covariance = 0.04 * np.array([[1, 0, 0.9], [0, 1, 0], [0.9, 0, 1]])
    values = dict.fromkeys(names, 0.5)
    fit = SimpleNamespace(jacobian=np.eye(3), covariance=covariance, values=values)
    # Unchecked: this is no whole fit.
    found = inspect.unwrap(information)(ij.problem(SEEN, free=names), fit)
    said = "scattering: 20 % of its prior's width; trades with load (correlation +0.90)"
    assert information_lines(found)[-1] == said
