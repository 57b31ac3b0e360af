"""Every experiment runs in its quick form and writes what the figures read."""

import csv
import importlib
from pathlib import Path

import jax
import pytest

from common import rows_of

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "experiments" / "results"
ELSEWHERE = {
    "simulated_photographs": ROOT / "data" / "photographs",
    "mitsuba_photographs": ROOT / "data" / "photographs" / "volumetric",
}
NAMES = sorted(
    p.stem
    for p in (ROOT / "experiments").glob("*.py")
    if "\ndef main(key" in p.read_text(encoding="utf-8")  # the others are what these share
)
# A minute each, of timing or of compiling; the others take seconds.
SLOW = {
    "amortised",
    "bench_accuracy_time",
    "bench_device",
    "bench_inversion",
    "bench_render",
    "clone_coverage",
    "clone_light",
    "clone_presets",
    "clone_search",
    "clone_thickness",
    "clone_uneven",
    "exact_against_montecarlo",
    "cube_posteriors",
    "cubes",
    "eye_colours",
    "f09_findings",
    "groups",
    "iris_over_white",
    "mitsuba_truth",
    "painted_irides",
    "polarisation",
    "render_figures",
    "wrong_model",
}


def columns(path):
    with path.open(encoding="utf-8") as f:
        return next(csv.reader(line for line in f if not line.startswith("#")))


@pytest.mark.peer
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in NAMES]
)
def test_quick(name, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.delenv("XLA_FLAGS", raising=False)  # commands run as users run them
    module = importlib.import_module(f"experiments.{name}")
    module.main(jax.random.key(0), quick=True, out=tmp_path)
    made, results = {p.name for p in tmp_path.iterdir()}, ELSEWHERE.get(name, RESULTS)
    assert made
    for file in made:
        # What is committed has the same names and columns: the figures read it.
        assert (results / file).is_file()
        if file.endswith(".csv"):
            assert columns(tmp_path / file) == columns(results / file)


@pytest.mark.slow
def test_posteriors_are_as_wide_as_they_should_be(tmp_path, monkeypatch):
    """Simulation-based calibration of 40 eyes: no parameter's ranks are far from uniform.

    Fourteen p-values (two tests of seven parameters) above 0.001 each: by Bonferroni right
    posteriors fail for at most 1.4 % of seeds, and this seed is fixed. Of posteriors twice or half
    as wide as they should be 98 % fail, and as many with one parameter a standard deviation off.
    """
    monkeypatch.syspath_prepend(str(ROOT))
    importlib.import_module("experiments.calibration").main(
        jax.random.key(0), quick=True, out=tmp_path, eyes=40
    )
    rows = rows_of(tmp_path / "calibration_summary.csv")
    assert len(rows) == 7
    found = {
        f"{row['parameter']} {test}": float(row[test])
        for row in rows
        for test in ("p_chi_square", "p_kolmogorov")
    }
    assert {name: p for name, p in found.items() if not p > 0.001} == {}
