"""`irisjax fit`: from a file to files, resumed, in batches, and one line for every wrong input."""

import csv
import sys

import pytest
import xarray as xr

from irisjax import cli
from irisjax.infer.parameters import DEFAULT_FREE, PARAMETERS


@pytest.fixture
def irisjax(capsys, monkeypatch):
    """Run the command in this process; gives status, standard output and standard error."""
    monkeypatch.delenv("IRISJAX_DEBUG", raising=False)

    def run(*arguments):
        status = cli.run([str(a) for a in arguments])
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def spectrum(irisjax, tmp_path):
    path = tmp_path / "eye.csv"
    assert irisjax("simulate-measurement", "--level", "low", "--seed", 2, "-o", path)[0] == 0
    return path


QUICK = ("--free", "melanin_load,hemoglobin", "--walkers", 16)


def test_one_eye_from_file_to_files(irisjax, spectrum, tmp_path):
    folder = tmp_path / "out"
    status, out, err = irisjax("fit", spectrum, "-o", folder, *QUICK)
    assert (status, err) == (0, "")
    assert "melanin_load" in out
    assert "load" in out.splitlines()[-1] or "known" in out
    names = {p.name for p in folder.iterdir()}
    assert names == {
        "chain.h5",
        "chain.h5.bak",
        "posterior.nc",
        "summary.csv",
        "corner.png",
        "fit.png",
    }
    with (folder / "summary.csv").open() as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    columns = "parameter,unit,median,sd,q2.5,q16,q84,q97.5,rhat,ess_bulk,ess_tail,contraction"
    assert list(rows["melanin_load"]) == columns.split(",")
    assert set(rows) == {"melanin_load", "hemoglobin", "abl_melanin", "eumelanin", "pheomelanin"}
    # The truth is in the file's header.
    truth = dict(
        p.split(" = ")
        for p in spectrum.read_text().split("# truth: ")[1].splitlines()[0].split(", ")
    )
    for name in ("melanin_load", "hemoglobin"):
        row = rows[name]
        assert abs(float(row["median"]) - float(truth[name])) < 5 * float(row["sd"])
        assert float(row["ess_bulk"]) >= 1000

    before = (folder / "summary.csv").read_bytes()
    status, out, err = irisjax("fit", spectrum, "-o", folder, *QUICK)
    assert (status, out) == (2, "")
    assert "--resume" in err
    assert irisjax("fit", spectrum, "-o", folder, *QUICK, "--resume")[0] == 0
    assert (folder / "summary.csv").read_bytes() == before
    assert irisjax("fit", spectrum, "-o", folder, *QUICK, "--overwrite")[0] == 0
    assert (folder / "summary.csv").read_bytes() == before  # equal seeds, equal bytes
    assert irisjax("fit", spectrum, "-o", folder, *QUICK, "--resume", "--seed", 1)[0] == 2


def test_short_chains_end_with_status_three(irisjax, spectrum, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    status, out, err = irisjax("fit", spectrum, *QUICK, "--max-steps", 40)
    assert status == 3
    assert "NOT CONVERGED: 40 steps" in out
    # A terminal is told at once what takes so long; that nothing else is,
    # `test_one_eye_from_file_to_files` shows.
    assert err.lstrip("\r").startswith("compiling")
    assert err.index("compiling") < err.index("sampling")


@pytest.mark.slow  # several spectra of an eye are also tests/infer's
def test_two_spots_of_one_eye(irisjax, spectrum, tmp_path):
    """They share the blood; each has its own melanin where it is separate."""
    other, folder = tmp_path / "spot.csv", tmp_path / "out"
    changed = ("--melanin-load", 0.1, "--wavelengths", "420:680:10")
    assert (
        irisjax("simulate-measurement", "--level", "low", *changed, "--seed", 3, "-o", other)[0]
        == 0
    )
    both = ("fit", spectrum, other, "--separate", "melanin_load", *QUICK)
    status, out, err = irisjax(*both, "-o", folder, "--max-steps", 60)
    assert (status, err) == (
        3,
        "",
    )  # too short a chain to be called converged; long enough to be near
    assert out.startswith("eye.csv, spot.csv: posterior of one eye")
    with (folder / "summary.csv").open() as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    assert {"melanin_load@1", "melanin_load@2", "hemoglobin", "eumelanin@2"} <= set(rows)
    for name, truth in (("melanin_load@1", 0.0477), ("melanin_load@2", 0.1), ("hemoglobin", 0.084)):
        assert abs(float(rows[name]["median"]) - truth) < 5 * float(rows[name]["sd"])
    with xr.open_dataset(folder / "posterior.nc", group="observed_data", engine="h5netcdf") as seen:
        assert seen["wavelength_nm_1"].size == seen["reflectance_1"].size == 31
        assert seen["wavelength_nm_2"].size == seen["reflectance_2"].size == 27


def test_batch(irisjax, spectrum, tmp_path):
    eyes = tmp_path / "eyes"
    eyes.mkdir()
    for i in range(3):
        (eyes / f"e{i}.csv").write_bytes(spectrum.read_bytes())
    (eyes / "broken.csv").write_text("nm,R\n400,oops\n")
    status, _, err = irisjax("fit", "--batch", eyes, "-o", tmp_path / "out", *QUICK)
    assert status == 3
    assert "1 of 4 eyes failed: broken" in err
    target = tmp_path / "out" / "fits.csv"
    with target.open() as file:
        rows = {row["eye"]: row for row in csv.DictReader(file)}
    assert rows["broken"]["status"].endswith("line 2: 'oops' is not a number")
    assert rows["e0"]["status"] == "ok"
    assert [rows["e0"][n] for n in ("melanin_load", "chi_square")] == [
        rows["e2"][n] for n in ("melanin_load", "chi_square")
    ]
    # The mended eye alone is done again.
    (eyes / "broken.csv").write_bytes(spectrum.read_bytes())
    assert irisjax("fit", "--batch", eyes, "-o", tmp_path / "out", *QUICK)[0] == 2
    assert irisjax("fit", "--batch", eyes, "-o", tmp_path / "out", *QUICK, "--resume")[0] == 0
    with target.open() as file:
        assert all(row["status"] == "ok" for row in csv.DictReader(file))
    # The same eyes as columns of one table.
    x, y = _columns(spectrum)
    lines = ["wavelength_nm,a,b", *(f"{a:g},{b:.12g},{b:.12g}" for a, b in zip(x, y, strict=True))]
    (tmp_path / "table.csv").write_text("\n".join(lines))
    status, out, _ = irisjax("fit", "--batch", tmp_path / "table.csv", *QUICK)
    assert status == 0
    listed = list(csv.DictReader(out.splitlines()))
    assert [row["eye"] for row in listed] == ["a", "b"]
    assert float(listed[0]["melanin_load"]) == pytest.approx(
        float(rows["e0"]["melanin_load"]), rel=1e-4
    )


def _columns(path):
    from irisjax import io

    found = io.read_measured(path)
    return found.wavelengths, found.values


def test_simulated_measurements_say_so_and_repeat(irisjax, tmp_path):
    one = irisjax("simulate-measurement", "--level", "high", "--scans", 3, "--seed", 5)
    assert one == irisjax("simulate-measurement", "--level", "high", "--scans", 3, "--seed", 5)
    assert (
        one[1] != irisjax("simulate-measurement", "--level", "high", "--scans", 3, "--seed", 6)[1]
    )
    assert "not a measurement" in one[1]
    assert "scan_3" in one[1]
    path = tmp_path / "s.csv"
    path.write_text(one[1])
    assert irisjax("simulate-measurement", "--from", path)[1] == one[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give the SPECTRUM of an eye, or --batch"),
        (("{eye}", "--batch", "{eye}"), "give the SPECTRUM of an eye, or --batch"),
        (("{eye}", "{eye}", "--separate", "melanin"), "unknown parameter 'melanin'"),
        (("{eye}", "{eye}", "--separate", "abl_thickness"), "is not free"),
        (("{eye}", "--separate", "melanin_load"), "--separate needs two or more spectra"),
        (("missing.csv",), "missing.csv: No such file"),
        (("{eye}", "--free", "melanin"), "unknown parameter 'melanin'"),
        (("{eye}", "--fix", "gain"), "--fix 'gain': write NAME=VALUE"),
        (("{eye}", "--fix", "gain=-1"), "--fix gain: -1 is outside 0 to inf"),
        (("{eye}", "--fix", "gian=1"), "--fix: unknown 'gian'"),
        (("{eye}", "--prior", "gain=flat"), "'flat' is no prior"),
        (("{eye}", "--walkers", "8"), "8 walkers are too few for 7 free parameters"),
        (("{eye}", "--process", "ilit"), "--process: unknown 'ilit'"),
        (("{eye}", "--relative-noise", "much"), "--relative-noise: 'much' is not a number"),
        (("{eye}", "--discrepancy", "0.02"), "write its size and its length"),
        (("{eye}", "--discrepancy", "0.02:50", "--outliers"), "do not go together"),
        (("{eye}", "--quantity", "colour"), "--quantity: unknown 'colour'"),
        (("{eye}", "--quantity", "radiance", "--illuminant", "sun"), "unknown illuminant 'sun'"),
        (("--batch", "{eye}", "--posteriors"), "--posteriors needs -o"),
    ],
)
def test_wrong_input_is_one_line(irisjax, spectrum, arguments, message):
    status, out, err = irisjax("fit", *(str(spectrum) if a == "{eye}" else a for a in arguments))
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_help_names_every_parameter_and_its_prior(irisjax, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    status, out, _ = irisjax("fit", "--help")
    assert status == 0
    for name, parameter in PARAMETERS.items():
        (line,) = (
            line for line in out.splitlines() if line.startswith((f" * {name}", f" · {name}"))
        )
        assert repr(parameter.prior) in line
        assert ("*" in line) == (name in DEFAULT_FREE)
