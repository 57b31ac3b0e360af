"""Files that run again by `--from`."""

from pathlib import Path

import numpy as np
import pytest
from refusals import one_line

DATA = Path(__file__).parents[2] / "data"
F09_FIG_1 = (
    *("--abl-eumelanin-percent", "7.56", "--abl-pheomelanin-percent", "5.84"),
    *("--stroma-eumelanin-percent", "4.61", "--stroma-pheomelanin-percent", "2.11"),
)
POWER_LAW = ("--reduced-scattering", "1.5", "--anisotropy", "0.8")
GRID = ("--wavelengths", "400:700:100")


@pytest.mark.parametrize(
    "arguments",
    [
        ("spectrum", "--melanin-load", "0.3", "--abl-index", "1.44", "--no-first-surface"),
        ("spectrum", "--process", "ilit-corrected", "--rescatter", "retest"),
        ("spectrum", "--process", "depth-resolved", "--scattering", "rayleigh-spheres"),
        ("spectrum", *F09_FIG_1),
        ("spectrum", "--polarised"),
        ("spectrum", "--instrument", "radiance", "--illuminant", "FL3.1", "--cornea", "round-trip"),
        ("spectrum", "--cos-incidence", "diffuse", "--perturb-on-reflection"),
        ("spectrum", "--solver", "monte-carlo", "--photons", "2e3", "--seed", "7"),
        ("brdf", "--incidence-deg", "37", "--plane", "hemisphere", "--angles", "4"),
        ("simulate-measurement", "--gain", "1.1", "--scans", "2", "--seed", "3", "--no-perturb"),
        ("simulate-measurement", "--process", "depth-resolved", *POWER_LAW),
    ],
    ids=" ".join,
)
def test_a_file_runs_again_to_the_same_bytes(irisjax, quick, tmp_path, arguments):
    path = tmp_path / "first.csv"
    status, out, err = irisjax(*arguments, *GRID, "-o", path)
    assert (status, out, err) == (0, "", "")
    assert irisjax(arguments[0], "--from", path) == (0, path.read_text(), "")


_SPECTRA = sorted(p.stem for p in DATA.glob("spectra/*.csv"))


@pytest.mark.parametrize("name", ["iris_low", *_SPECTRA])
def test_data_that_ship_run_again(irisjax, printed, name):
    """To the same settings and, platforms' last digits aside, to the same values."""
    path = DATA / ("." if name == "iris_low" else "spectra") / f"{name}.csv"
    shipped = printed(path.read_text(encoding="utf-8"))
    status, out, err = irisjax(shipped.header["command"], "--from", path)
    assert (status, err) == (0, "")
    made = printed(out)
    assert made.header == shipped.header | {"irisjax": made.header["irisjax"]}
    assert list(made.columns) == list(shipped.columns)
    for column, values in shipped.columns.items():
        np.testing.assert_allclose(made.columns[column], values, rtol=1e-9, atol=0)


def test_options_change_what_a_file_says(irisjax, quick, tmp_path, printed):
    path = tmp_path / "first.csv"
    irisjax("spectrum", "--level", "low", "--phase", "rayleigh", "--lutein", "0", *GRID, "-o", path)
    changes = ("--level", "high", "--process", "ilit-2006", "--incidence-deg", "10")
    header = printed(irisjax("spectrum", "--from", path, *changes)[1]).header
    assert header["eumelanin"] == "1.008"
    assert header["phase"] == "lb06"
    assert header["lutein"] == "0.0"
    assert header["wavelengths"] == "400:700:100"
    assert header["cos_incidence"].startswith("0.98480775")
    # The order does not matter, and a file's values yield to typed ones only.
    header = printed(irisjax("spectrum", "--eumelanin", "0.7", "--from", path)[1]).header
    assert (header["eumelanin"], header["pheomelanin"]) == ("0.7", "0.0194")
    assert (header["phase"], header["cos_incidence"]) == ("rayleigh", "1.0")
    # Another command takes iris and process from the file, not its grid.
    _, out, err = irisjax("colour", "--from", path)
    assert "is of another command; not taken from it: wavelengths" in err
    assert "# eumelanin: 0.1201 [mg/ml]" in out
    assert "# phase: rayleigh" in out
    assert "# wavelengths: 380:780:5" in out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "no header of settings"),
        ("# eumelanin: 0.1\n# eumelanine: 0.2\n", "unknown setting 'eumelanine'"),
        ("# eumelanin: lots\n", "old.csv: eumelanin: 'lots' is not a number"),
        ("# eumelanin: -2\n", "eumelanin = -2"),
        ("# wavelengths: 300:400:10 [nm]\n", "old.csv: wavelengths: 300 nm is outside"),
        ("# first_surface: maybe\n", "old.csv: first_surface: "),
        ("# solver: oracle\n", "old.csv: solver: unknown 'oracle'; known: exact, monte-carlo"),
        ("# output: other.csv\n# lutein: 0\n", "unknown setting 'output'"),
    ],
)
def test_wrong_headers_are_one_line(irisjax, quick, tmp_path, text, message):
    path = tmp_path / "old.csv"
    path.write_text(text)
    one_line(irisjax("spectrum", "--from", path), message)
