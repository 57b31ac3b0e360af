"""Every experiment runs in its quick form and writes what the figures read."""

import csv
import importlib
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "experiments" / "results"
NAMES = sorted(p.stem for p in (ROOT / "experiments").glob("*.py") if p.stem not in ("__init__", "common"))
# A minute of timing each; the others take seconds.
SLOW = {"bench_accuracy_time", "bench_inversion", "bench_render", "exact_against_montecarlo", "render_figures"}


def columns(path):
    with path.open(encoding="utf-8") as f:
        return next(csv.reader(line for line in f if not line.startswith("#")))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in NAMES])
def test_quick(name, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    module = importlib.import_module(f"experiments.{name}")
    module.main(jax.random.key(0), quick=True, out=tmp_path)
    made = {p.name for p in tmp_path.iterdir()}
    assert made
    for file in made:
        # What is committed has the same names and columns: the figures read it.
        assert (RESULTS / file).is_file()
        if file.endswith(".csv"):
            assert columns(tmp_path / file) == columns(RESULTS / file)
