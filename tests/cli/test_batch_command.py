"""`irisjax fit --batch` and `irisjax simulate-measurement`."""

import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stand_ins import FREE, truth_of

from common import rows_by, rows_of
from irisjax import io
from irisjax.cli import batch, report
from irisjax.infer.fit import Fit, FitStatus
from irisjax.infer.importance import Start


@pytest.fixture
def searched(quick, monkeypatch):
    """The search of a batch replaced by means of the spectra; the sizes of its chunks."""
    sizes = []

    def fit_all(problem, values, sds, key):
        count, free = len(values), len(problem.free)
        sizes.append(count)
        mean = jnp.asarray(np.asarray(values).mean(axis=1))
        ones, good = jnp.asarray(np.ones(count, int)), np.asarray(mean) <= 0.3

        def status(*items):
            return jax.tree.map(lambda a, b: jnp.asarray(np.where(good, a, b)), *items)

        return Fit(
            values={n: mean for n in problem.free},
            sd={n: (1 + k) * mean for k, n in enumerate(problem.free)},
            z=jnp.asarray(np.zeros((count, free))),
            jacobian=jnp.asarray(np.zeros((count, 1, free))),
            covariance=jnp.asarray(np.stack([np.eye(free)] * count)),
            predicted=(),
            cost=mean,
            chi_square=mean,
            degrees=29,
            agreeing=ones,
            steps=ones,
            status=status(FitStatus.successful, FitStatus.misfit),
        )

    monkeypatch.setattr(batch, "_fit_all", fit_all)
    return sizes


def columns(path):
    found = io.read_measured(path)
    return found.wavelengths, found.values


def test_batch(irisjax, done, eye, copies, searched, tmp_path):
    eyes, out = copies("e0", "e1", "e2"), tmp_path / "out"
    (eyes / "broken.csv").write_text("nm,R\n400,oops\n")
    status, _, err = irisjax("fit", "--batch", eyes, "-o", out, *FREE)
    assert status == 3
    assert "1 of 4 eyes failed: broken" in err
    rows = rows_by("eye", out / "fits.csv")
    assert rows["broken"]["status"] == "failed"
    assert rows["broken"]["warnings"] == f"{eyes / 'broken.csv'}, line 2: 'oops' is not a number"
    assert (rows["e0"]["status"], rows["e0"]["warnings"]) == ("ok", "")
    covariances = rows_of(out / "fits-covariance.csv")
    long = [(r["eye"], r["parameter"], r["other"], r) for r in covariances]
    free = ("melanin_load", "hemoglobin")
    every = [(f"e{i}", one, other) for i in range(3) for one in free for other in free]
    assert [place for *place, _ in long] == [[*place] for place in every]
    assert long[0][3]["prior"] == "lognormal(0.15, 1.2)"
    spread = {name: float(rows["e0"][f"{name}_sd"]) for name in free}
    assert spread["hemoglobin"] == pytest.approx(2 * spread["melanin_load"], rel=1e-4)
    for _, name, other, row in long[:4]:
        wanted = spread[name] ** 2 if name == other else 0.0
        assert float(row["covariance"]) == pytest.approx(wanted, rel=1e-4)
    names = ("melanin_load", "chi_square")
    assert [rows["e0"][n] for n in names] == [rows["e2"][n] for n in names]
    # The mended eye alone is done again.
    (eyes / "broken.csv").write_bytes(eye.read_bytes())
    assert irisjax("fit", "--batch", eyes, "-o", out, *FREE)[0] == 2
    done("fit", "--batch", eyes, "-o", out, *FREE, "--resume")
    assert all(row["status"] == "ok" for row in rows_by("eye", out / "fits.csv").values())
    wrong = tmp_path / "two.csv"  # a file for all eyes is named in what is said of each
    wrong.write_text("centre,fwhm\n450,20\n550,20\n")
    _, printed, _ = irisjax("fit", "--batch", eyes, *FREE, "--bands", wrong)
    assert f"{wrong}: {columns(eye)[0].size} values for 2 bands" in printed
    # The same eyes as columns of one table.
    x, y = columns(eye)
    lines = ["wavelength_nm,a,b", *(f"{a:g},{b:.12g},{b:.12g}" for a, b in zip(x, y, strict=True))]
    (tmp_path / "table.csv").write_text("\n".join(lines))
    # Unlike the files, the table does not say by which process it was simulated.
    by = "--process", "ilit-2006"
    printed, _ = done("fit", "--batch", tmp_path / "table.csv", *FREE, *by)
    listed = list(csv.DictReader(printed.splitlines()))
    assert [row["eye"] for row in listed] == ["a", "b"]
    assert float(listed[0]["melanin_load"]) == pytest.approx(
        float(rows["e0"]["melanin_load"]), rel=1e-5
    )
    # Each chunk is searched by either process, and fitted whole again: its numbers are then those
    # of a run that never stopped. Three eyes share the program of four.
    assert searched == [4, 4, 4, 4, 2, 2]


def test_a_covariance_stands_for_the_noise_of_the_files(done, searched, monkeypatch, tmp_path):
    """The sd of each file replaced that of the covariance."""
    eyes, noise = tmp_path / "eyes", []
    eyes.mkdir()
    for name, order in (("a", (0, 1, 2)), ("b", (2, 1, 0))):
        rows = [("450,0.05,1", "500,0.04,1", "600,0.03,1")[i] for i in order]
        (eyes / f"{name}.csv").write_text("\n".join(["nm,R (fraction),sd", *rows]))
    np.save(tmp_path / "c.npy", np.diag([4e-6, 9e-6, 16e-6]))
    search = batch._fit_all

    def searching(problem, values, sds, key):
        noise.append((sds, problem.observations[0].sd.tolist()))
        return search(problem, values, sds, key)

    monkeypatch.setattr(batch, "_fit_all", searching)
    done("fit", "--batch", eyes, "--covariance", tmp_path / "c.npy", *FREE)
    rising, falling = [2e-3, 3e-3, 4e-3], [4e-3, 3e-3, 2e-3]
    assert [sds for sds, _ in noise] == [None] * 4
    np.testing.assert_allclose([sd for _, sd in noise], [rising, rising, falling, falling])


def test_two_files_do_not_name_one_eye(irisjax, copies, quick):
    eyes = copies("left")
    (eyes / "left.txt").write_bytes((eyes / "left.csv").read_bytes())
    status, _, err = irisjax("fit", "--batch", eyes)
    assert status == 2 and "another file names an eye 'left'; rename one of them" in err


def test_eyes_of_another_run_stay_in_the_table(done, eye, copies, searched, tmp_path):
    eyes, out = copies("a", "b", "c"), tmp_path / "out"
    done("fit", "--batch", eyes, "-o", out, *FREE)
    before = rows_by("eye", out / "fits.csv")
    (eyes / "a.csv").unlink()
    (eyes / "c.csv").rename(eyes / "d.csv")
    done("fit", "--batch", eyes, "-o", out, *FREE, "--resume")
    after = rows_by("eye", out / "fits.csv")
    assert [*after] == ["a", "b", "c", "d"] and before.items() <= after.items()
    assert [*rows_by("eye", out / "fits-covariance.csv")] == [*after]


@pytest.mark.peer
def test_a_batch_is_searched_by_the_library(irisjax, eye, copies, quick, tmp_path):
    eyes, out = copies("a", "b"), tmp_path / "out"
    assert irisjax("fit", "--batch", eyes, "-o", out, *FREE)[0] == 0
    rows = rows_by("eye", out / "fits.csv")
    assert rows["a"] == rows["b"] | {"eye": "a"}
    found, sd = (float(rows["a"][name]) for name in ("melanin_load", "melanin_load_sd"))
    assert abs(found - truth_of(eye)["melanin_load"]) < 3 * sd


def test_another_table_is_not_gone_on_with(irisjax, copies, searched, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "fits.csv").write_text("eye,status,melanin_load\ne0,ok,0.1\n")
    status, _, err = irisjax("fit", "--batch", copies("e0"), "-o", out, *FREE, "--resume")
    assert (status, searched) == (2, [])
    assert "is no table of --batch; --overwrite starts again" in err


def test_doubtful_eyes_are_marked_and_counted(done, searched, tmp_path):
    """Searched and found, but no model of these data: not "ok"."""
    x = np.arange(400, 701, 10)
    lines = ["nm,fair (%),bright (%)", *(f"{a},{3 + a / 1e3:g},{40 + a / 1e2:g}" for a in x)]
    (tmp_path / "table.csv").write_text("\n".join(lines))
    out = tmp_path / "out"
    _, err = done("fit", "--batch", tmp_path / "table.csv", "-o", out, *FREE)
    assert "1 of 2 eyes are doubtful: bright (%)" in err
    rows = rows_by("eye", out / "fits.csv")
    assert rows["fair (%)"]["status"] == "ok"
    assert rows["bright (%)"]["status"] == "doubtful"
    assert "brighter than any iris" in rows["bright (%)"]["warnings"]
    assert "the model does not produce these data" in rows["bright (%)"]["warnings"]
    assert float(rows["fair (%)"]["p_value"]) == 1


def test_posteriors_of_a_batch(irisjax, copies, searched, monkeypatch, tmp_path):
    sampled = []

    def one(problem, folder, sampler, bar, **how):
        sampled.append((folder.name, sampler.walkers, how))
        (folder / "chain.h5").write_text("chain")
        return folder.name != "b"

    def draws(problem, found, names, *, key):
        return np.arange(6.0).reshape(3, 2)

    monkeypatch.setattr(report, "report_eye", one)
    monkeypatch.setattr(batch, "likelihood_draws", draws)
    monkeypatch.setattr(batch, "tails", lambda problem, z, names: None)
    monkeypatch.setattr(batch, "fit", lambda problem, *, key: Start(np.zeros(2), np.eye(2)))
    eyes, out = copies("a", "b"), tmp_path / "out"
    arguments = ("fit", "--batch", eyes, "-o", out, "--posteriors", "emcee", *FREE)
    assert irisjax(*arguments)[0] == 3
    how = {"resume": False, "quiet": True}
    assert sampled == [("a", 16, how), ("b", 16, how)]
    found = {n: (r["status"], r["posterior"]) for n, r in rows_by("eye", out / "fits.csv").items()}
    assert found == {"a": ("ok", "converged"), "b": ("failed", "not long enough")}
    assert {n: [*x] for n, x in np.load(out / "a" / "likelihood.npz").items()} == {
        "melanin_load": [0, 2, 4],
        "hemoglobin": [1, 3, 5],
    }
    # Only what is not done yet goes on.
    assert irisjax(*arguments, "--resume")[0] == 3
    assert sampled[2:] == [("b", 16, how | {"resume": True})]


def test_simulated_measurements_say_so_and_have_their_seeds(irisjax, quick):
    same = ("simulate-measurement", "--level", "high", "--scans", 3, "--wavelengths", "500")
    one = irisjax(*same, "--seed", 5)
    assert one[::2] == (0, "")
    assert "not a measurement" in one[1]
    assert "scan_3" in one[1]
    other = irisjax(*same, "--seed", 6)[1]
    assert other != one[1].replace("seed: 5", "seed: 6")


def test_melanin_of_the_abl_is_their_product(irisjax, eye, searched, tmp_path):
    """The stand-in finds the same value and deviation for both, which are independent."""
    path, out = tmp_path / "eyes.csv", tmp_path / "out"
    path.write_text("nm,left,left_sd\n400,0.04,0.001\n450,0.02,0.001\n")
    said = ("--free", "melanin_load,abl_fraction", "-o", out)
    assert irisjax("fit", "--batch", path, *said)[0] == 0
    rows = rows_by("eye", out / "fits.csv")
    assert list(rows) == ["left"]
    row = {name: float(rows["left"][name]) for name in ("melanin_load", "abl_melanin")}
    assert row["abl_melanin"] == pytest.approx(row["melanin_load"] ** 2, rel=1e-5)
    spread = float(rows["left"]["abl_melanin_sd"])
    assert spread == pytest.approx(np.sqrt(1 + 2**2) * row["abl_melanin"], rel=1e-5)
    assert rows["left"]["status"] == "doubtful"
    assert "are read as light of single wavelengths" in rows["left"]["warnings"]
