"""`irisjax spectrum` of polarised light: its instruments, its header, what it refuses."""

import numpy as np
import pytest
from refusals import one_line

import irisjax as ij
from irisjax.cli import model

GRID = ("--wavelengths", "450,620", "--level", "low")


def solver(process, iris=None, **how):
    return ij.RadiativeExact(12, 6, 2, process=process)


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(model, "exact_solver", solver)


def test_instruments_are_the_librarys(irisjax, coarse, printed):
    iris, grid = ij.Iris.of_level("low"), [450.0, 620.0]
    for arguments, instrument, column in (
        (
            ("--instrument", "cross-polarised"),
            ij.Analyser(grid, "crossed"),
            "cross_polarised_reflectance_factor",
        ),
        (
            ("--instrument", "co-polarised", "--exit-deg", "hemisphere", "--polariser-deg", "30"),
            ij.Analyser(grid, "parallel", cos_exit="hemisphere", polariser=np.radians(30)),
            "co_polarised_reflectance",
        ),
        (
            ("--instrument", "degree-of-polarisation"),
            ij.Polarimeter(grid, cos_exit=np.sqrt(0.5)),
            "degree_of_linear_polarisation",
        ),
    ):
        status, out, err = irisjax("spectrum", *arguments, *GRID)
        assert (status, err) == (0, "")
        header, columns = printed(out)
        assert (header["process"], header["polarised"]) == ("depth-resolved", "yes")
        assert "photographs" in header["approximation"]
        expected = ij.observe(iris, instrument, solver(ij.POLARISED)).values
        np.testing.assert_allclose(columns[column], expected, rtol=1e-9)


def test_a_file_says_what_scalar_theory_leaves_out(irisjax, coarse, printed, tmp_path):
    _, out, _ = irisjax("spectrum", "--process", "depth-resolved", *GRID)
    assert "values 0.4 to 0.6 % low" in printed(out).header["approximation"]
    path = tmp_path / "polarised.csv"
    assert irisjax("spectrum", "--polarised", *GRID, "-o", path)[0] == 0
    again = irisjax("spectrum", "--from", path)[1]
    assert again == path.read_text()
    assert "polarised: yes" in again


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--process", "ilit-2006", "--polarised"), "only with --process depth-resolved"),
        (("--process", "ilit-2006", "--instrument", "co-polarised"), "needs --process depth"),
        (("--scalar", "--process", "depth-resolved", "--instrument", "cross-polarised"), "needs"),
        (("--exit-deg", "30"), "means something only with --instrument cross-polarised"),
        (("--instrument", "cross-polarised", "--exit-deg", "95"), "outside [0, 90]"),
        (("--instrument", "cross-polarised", "--cornea", "inward"), "bare iris"),
        (("--instrument", "cross-polarised", "--cos-incidence", "diffuse"), "one direction"),
    ],
)
def test_refusals(irisjax, arguments, said):
    one_line(irisjax("spectrum", *arguments, *GRID), said)
