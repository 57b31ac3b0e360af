"""`irisjax fit --compare`: files and one sentence; what does not go with it."""

import numpy as np
import pytest
from refusals import one_line
from stand_ins import Quick

import irisjax as ij
from common import rows_of
from irisjax.cli import compare
from irisjax.cli.sentences import models_sentence
from irisjax.infer.importance import ImportanceSample
from irisjax.infer.model_comparison import Assessment, Interval


def assessment(name, problem, log_evidence, values, ratios=None, models=()):
    found = ImportanceSample(np.zeros((2, 7)), 25.0, log_evidence, 8)
    ratios = {n: Interval(1.0, 0.5, 2.0) for n in values} if ratios is None else ratios
    return Assessment(name, problem, found, 90.0, 4.0, values, ratios, models, models)


@pytest.fixture
def compared(quick, monkeypatch):
    """The command without its sampler; the calls of the comparison."""
    calls = []

    def stand_in(problem, *, progress, key):
        calls.append(problem)
        out = []
        for i, process in enumerate((ij.ILIT_2006, ij.DEPTH_RESOLVED)):
            mine = ij.problem(problem.observations, solver=Quick(process=process))
            names = ("melanin_load", "abl_fraction", "noise")
            values = {n: Interval(0.1 * (i + 1), 0.05, 0.4) for n in names}
            ratios = {n: Interval(1.0 + i, 0.5, 4.0) for n in values}
            if i:  # a parameter that the first model has not
                values["anisotropy"] = Interval(0.8, 0.7, 0.9)
            models = tuple(np.asarray(o.values) for o in problem.observations)
            name = ("ILIT", "radiative transfer")[i]
            progress(name, 8)
            out.append(assessment(name, mine, 100.0 - 20 * i, values, ratios, models))
        return tuple(out)

    monkeypatch.setattr(compare, "compare_models", stand_in)
    return calls


def test_from_file_to_files(irisjax, eye, compared, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    status, out, err = irisjax("fit", eye, "--compare", "-o", folder)
    assert (status, err) == (0, "")
    sentence = out.splitlines()[0]
    assert sentence.startswith("The data (eye.csv) prefer ILIT to radiative transfer by odds of")
    assert {p.name for p in folder.iterdir()} == {"compare.csv", "compare.png"}
    text = (folder / "compare.csv").read_text()
    assert text.splitlines()[0] == f"# {sentence}"
    rows = rows_of(folder / "compare.csv")
    assert [r["model"] for r in rows] == ["ILIT", "radiative transfer"]
    assert [r["process"] for r in rows] == ["ilit-2006", "depth-resolved"]
    assert {r["sampler"] for r in rows} == {"importance sampling"}
    assert [float(r["ln_evidence"]) for r in rows] == [100.0, 80.0]
    assert float(rows[1]["melanin_load_ratio"]) == 2.0
    assert [r["anisotropy"] for r in rows] == ["", "0.8"]
    assert "anisotropy_ratio" not in rows[0]
    assert float(rows[1]["melanin_load_ratio_q97.5"]) == 4.0
    assert (folder / "compare.png").read_bytes().startswith(b"\x89PNG")
    # A second run is refused, or gives the same table.
    one_line(irisjax("fit", eye, "--compare", "-o", folder), "--overwrite starts again")
    monkeypatch.setattr(compare, "_draw", lambda *_: lambda: b"new")
    assert irisjax("fit", eye, "--compare", "-o", folder, "--overwrite")[0] == 0
    assert (folder / "compare.csv").read_text() == text
    assert (folder / "compare.png").read_bytes() == b"new"


def test_without_a_folder_it_is_printed_only(done, eye, compared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out, _ = done("fit", eye, "--compare")
    assert "ln evidence" in out
    assert list(tmp_path.iterdir()) == []


def test_two_spots_and_settings_reach_the_comparison(irisjax, eye, compared, tmp_path):
    said = ("--compare", "--process", "depth-resolved", "--fix", "abl_fraction=0.5")
    said += ("--discrepancy", "0.02:80")
    other = tmp_path / "other.csv"
    other.write_bytes(eye.read_bytes())
    assert irisjax("fit", eye, other, *said)[0] == 0
    (problem,) = compared
    assert len(problem.observations) == 2
    assert problem.process == ij.DEPTH_RESOLVED
    assert "abl_fraction" not in problem.free
    np.testing.assert_allclose(problem.noise.discrepancy, 0.02)


def test_it_takes_neither_samplers_nor_batches(irisjax, eye, compared):
    sampled = irisjax("fit", eye, "--compare", "--walkers", "32", "--max-steps", "9")
    one_line(sampled, "--compare does not go with --walkers, --max-steps")
    many = irisjax("fit", "--batch", eye, "--compare", "--resume")
    one_line(many, "--compare does not go with --batch, --resume")
    assert not compared


@pytest.mark.parametrize(
    ("apart", "said"),
    [
        (10.0, "prefer A to B by odds of 22,000 to 1"),
        (-100.0, "prefer B to A by odds of 1e43 to 1"),
        (3.2, "do not decide between A and B"),  # 20 to 1, but for the errors
        (0.0, "do not decide between"),
    ],
)
def test_the_sentence(apart, said):
    blank = ij.spectrum([500.0, 600.0], [0.1, 0.1], name="eye")
    problem = ij.problem(blank, free=["melanin_load"], solver=Quick())
    first = {"melanin_load": Interval(0.1, 0.05, 0.2)}
    second = {"melanin_load": Interval(0.25, 0.125, 0.5)}
    ratios = {"melanin_load": Interval(2.5, 1.25, 5.0)}
    found = (
        assessment("A", problem, 50.0 + apart, first),
        assessment("B", problem, 50.0, second, ratios),
    )
    sentence = models_sentence(found)
    assert sentence.startswith(f"The data (eye) {said}")
    assert sentence.count(".\n") == 0
    assert sentence.endswith(
        "melanin load, ug/mm2 (95 %): 0.1 (0.05 to 0.2) by A, 0.25 (0.125 to 0.5) by B, "
        "2.5 (1.2 to 5) times that."
    )
