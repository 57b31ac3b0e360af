"""`irisjax compare-groups`: groups of a batch's results, twice-measured eyes, wrong input."""

from unittest.mock import Mock

import numpy as np
import pytest
from refusals import one_line

from common import rows_by
from irisjax.cli import groups as command
from irisjax.cli import many
from irisjax.infer.priors import LogNormal, Uniform
from irisjax.io.fits import COVARIANCES, LIKELIHOOD, covariance_rows
from irisjax.io.posterior import write_posterior

PRIORS = {"melanin_load": LogNormal(0.15, 1.2), "abl_fraction": Uniform(0, 1)}


def write(folder, load, eyes=12, seed=0, priors=PRIORS, process="ilit-2006", status="ok", off=0.0):
    """Results of a batch whose eyes are known to 10 %; their loads scatter by 20 %."""
    random = np.random.default_rng(seed)
    folder.mkdir()
    rows, long = [], []
    for i in range(eyes):
        values = load * np.exp(0.2 * random.standard_normal()), random.uniform(0.3, 0.6)
        values = np.array(values) * np.exp(off * np.random.default_rng(i).standard_normal(2))
        sd = 0.1 * values[: len(priors)]
        names = [c for n in priors for c in (n, f"{n}_sd")]
        numbers = [f"{x:.6g}" for pair in zip(values, sd, strict=False) for x in pair]
        of = status if i == 0 else "ok"
        rows.append(dict(zip(["eye", "status", *names], [f"e{i}", of, *numbers], strict=True)))
        rows[-1]["process"] = process
        long += covariance_rows(f"e{i}", priors, np.diag(sd**2))
    table = [list(rows[0]), *(list(r.values()) for r in rows)]
    (folder / "fits.csv").write_text(many.csv_of(table))
    covariances = [COVARIANCES, *(list(r.values()) for r in long)]
    (folder / "fits-covariance.csv").write_text(many.csv_of(covariances))
    return folder


def test_two_groups_differ_by_what_their_eyes_do(irisjax, done, tmp_path):
    a = write(tmp_path / "a", 0.2, status="doubtful")
    b, out = write(tmp_path / "b", 0.4, seed=1), tmp_path / "groups.csv"
    printed, err = done("compare-groups", a, b / "fits.csv", "-o", out)
    assert err == f"irisjax: {a}: 1 eyes are left out: e0 (doubtful)\n"
    method = "likelihood of each eye: normal, the fit divided by its prior"
    for said in ("11 eyes in a, 12 in b", method, "half-normal", "lognormal(0.15, 1.2)"):
        assert said in printed and said in out.read_text()
    rows = rows_by("parameter", out)
    assert set(rows) == {*PRIORS, "abl_melanin"}
    load = {n: float(x) for n, x in rows["melanin_load"].items() if n not in ("parameter", "unit")}
    assert load["mean_a_q2.5"] < 0.2 < load["mean_a_q97.5"]
    assert load["mean_b_q2.5"] < 0.4 < load["mean_b_q97.5"]
    assert 0.1 < load["difference_q2.5"] < load["difference"] < 0.3
    assert load["p_b_above_a"] == 1
    assert load["spread_a"] / load["mean_a"] == pytest.approx(0.2, abs=0.08)
    assert 0 < load["shrinkage_a"] < 0.5
    assert float(rows["abl_fraction"]["difference_q2.5"]) < 0
    assert irisjax("compare-groups", a, b)[1] == printed  # draws repeat
    assert "12 eyes in a" in irisjax("compare-groups", a, b, "--doubtful")[1]


def test_draws_replace_fits_where_every_eye_has_them(irisjax, done, tmp_path, monkeypatch):
    a, b = write(tmp_path / "a", 0.2, eyes=4), write(tmp_path / "b", 0.4, eyes=4, seed=1)
    random = np.random.default_rng(0)
    for folder, load in ((a, 0.1), (b, 0.3)):  # other loads than the fits'
        head, *table = (folder / "fits.csv").read_text().splitlines()
        table = [f"{head},posterior", *(f"{x},converged" for x in table)]
        (folder / "fits.csv").write_text("\n".join(table))
        for i in range(4):
            (folder / f"e{i}").mkdir()
            loads = load * np.exp(0.1 * random.standard_normal((4, 100)))
            drawn = {"melanin_load": loads, "abl_fraction": random.uniform(0.3, 0.6, (4, 100))}
            arrays = {n: (("chain", "draw"), x) for n, x in drawn.items()}
            write_posterior(folder / f"e{i}" / "posterior.nc", {"posterior": arrays}, {}, {})
            if folder is b:  # these take their place: of loads twice as large
                known = {n: PRIORS[n].standard(np.resize(x, 1024)) for n, x in drawn.items()}
                known["melanin_load"] += np.log(2) / 1.2
                np.savez(folder / f"e{i}" / LIKELIHOOD, **known)
    printed, _ = done("compare-groups", a, b, "-o", tmp_path / "groups.csv")
    assert "a mixture fitted to 1024 draws" in printed and "WARNING" not in printed
    load = rows_by("parameter", tmp_path / "groups.csv")["melanin_load"]
    assert float(load["mean_a"]) == pytest.approx(0.1, rel=0.1)
    assert float(load["mean_b"]) == pytest.approx(0.6, rel=0.1)
    text = (b / "fits.csv").read_text()
    (b / "fits.csv").write_text(text.replace("converged", "not long enough", 1))
    without = Mock(side_effect=ValueError("enough"))
    monkeypatch.setattr(command, "population", without)
    one_line(irisjax("compare-groups", a, b), "enough")
    assert without.call_args.args[2] is None


def test_eyes_measured_twice_are_matched_by_name(irisjax, done, tmp_path):
    a, b, out = write(tmp_path / "a", 0.2), tmp_path / "b", tmp_path / "pairs.csv"
    write(b, 0.2, eyes=14, off=0.02)  # the same eyes, and two others
    text = (b / "fits.csv").read_text().splitlines()
    (b / "fits.csv").write_text("\n".join([text[0], *text[:0:-1]]))
    printed, _ = done("compare-groups", a, b, "--paired", "-o", out)
    assert "12 eyes measured twice" in printed and "Shrout & Fleiss 1979" in printed
    row = rows_by("parameter", out)["melanin_load"]
    assert 0.97 < float(row["icc_agreement"]) < 1
    assert float(row["bias_q2.5"]) < 0 < float(row["bias_q97.5"])
    assert float(row["upper_limit"]) == pytest.approx(1.96 * np.sqrt(2) * 0.02 * 0.2, rel=0.6)
    one_line(irisjax("compare-groups", a, a, "--paired"), "repeat exactly")
    one_line(irisjax("compare-groups", a, write(tmp_path / "c", 0.2, eyes=2), "--paired"), "2 eyes")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"eyes": 1}, "1 of 1 eyes can be used; a group needs two or more with status ok"),
        ({"process": "depth-resolved"}, "different processes, ilit-2006 and depth-resolved"),
        ({"priors": {"melanin_load": PRIORS["melanin_load"]}}, "different free parameters: "),
        ({"priors": PRIORS | {"abl_fraction": Uniform(0, 0.9)}}, "different priors of abl_frac"),
    ],
)
def test_groups_that_cannot_be_compared(irisjax, tmp_path, given, message):
    a, b = write(tmp_path / "a", 0.2), write(tmp_path / "b", 0.2, **given)
    one_line(irisjax("compare-groups", a, b), message)


def test_tables_of_other_kinds(irisjax, tmp_path):
    a, b = write(tmp_path / "a", 0.2), write(tmp_path / "b", 0.2)
    one_line(irisjax("compare-groups", a, tmp_path / "none"), "none: No such file")
    beside, table = b / "fits-covariance.csv", b / "fits.csv"
    covariances = beside.read_text()
    beside.write_text("\n".join(covariances.splitlines()[:-1]))
    one_line(irisjax("compare-groups", a, b), "an eye lacks some covariances")
    beside.unlink()
    one_line(irisjax("compare-groups", a, b), "irisjax fit --batch -o writes it")
    beside.write_text(covariances)
    table.write_text(table.read_text().replace("melanin_load_sd", "other"))
    one_line(irisjax("compare-groups", a, b), "e0 has no number in a column melanin_load_sd")
    table.write_text("eye,load\n1,2\n")
    one_line(irisjax("compare-groups", a, b), "is no table of irisjax fit --batch")
    a.joinpath("fits-covariance.csv").write_text(covariances)
    one_line(irisjax("compare-groups", a, a, "-o", tmp_path), "is a folder")
