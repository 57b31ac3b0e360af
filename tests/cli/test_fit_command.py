"""`irisjax fit`: what is asked of the sampler, from a file to files, resumed; wrong input."""

import importlib
import re
import sys
from contextlib import nullcontext

import jax
import numpy as np
import pytest
import xarray as xr
from refusals import one_line
from stand_ins import FREE, truth_of

import irisjax as ij
from common import rows_by
from irisjax import cli
from irisjax.cli import report
from irisjax.infer.parameters import DEFAULT_FREE, PARAMETERS

command = importlib.import_module("irisjax.cli.fit")  # the package holds the command by this name
BY_ILIT = "irisjax: read by ilit-2006, by which irisjax simulated the file\n"
FILES = {"chain.h5", "posterior.nc", "summary.csv", "corner.png", "fit.png"}


def without_header(path):
    return "\n".join(x for x in path.read_text().splitlines() if not x.startswith("#"))


def test_one_eye_from_file_to_files(fitted):
    assert fitted.status == 0
    assert "melanin_load" in fitted.printed
    assert "best known: load, to 10 %" in fitted.printed
    assert "predictive score" in fitted.printed.splitlines()[-1]
    assert {p.name for p in fitted.folder.iterdir()} == FILES
    rows = rows_by("parameter", fitted.folder / "summary.csv")
    columns = "parameter,unit,median,sd,q2.5,q16,q84,q97.5,rhat,ess_bulk,ess_tail,contraction"
    columns += ",process,other_process,other_value,other_q2.5,other_q97.5,differs"
    assert list(rows["melanin_load"]) == columns.split(",")
    assert rows["melanin_load"]["other_process"] == "depth-resolved"
    assert rows["melanin_load"]["process"] == "ilit-2006"
    assert float(rows["melanin_load"]["other_value"]) > 0
    assert rows["eumelanin"]["other_process"] == ""
    assert "by radiative transfer melanin_load is" in fitted.printed.splitlines()[0]
    assert set(rows) == {"melanin_load", "hemoglobin", "abl_melanin", "eumelanin", "pheomelanin"}
    file = fitted.folder / "posterior.nc"
    with xr.open_dataset(file, group="posterior", engine="h5netcdf") as found:
        assert {"melanin_load", "hemoglobin"} <= set(found)
        # The model's name is the same whichever worker wrote the file.
        assert found.attrs["process"] == "ilit-2006"
    for name in ("fit.png", "corner.png"):
        assert (fitted.folder / name).read_bytes().startswith(b"\x89PNG")


def test_wavelengths_of_a_file_can_be_left_out(irisjax, eye, sampled):
    assert irisjax("fit", eye, *FREE, "--wavelengths", "450:650")[0] == 0
    (call,) = sampled
    grid = np.asarray(call.problem.observations[0].wavelengths)
    assert 450 <= grid.min() < grid.max() <= 650
    one_line(irisjax("fit", eye, *FREE, "--wavelengths", "650:450"), "400:700")


def test_results_are_neither_lost_nor_mixed(fitted, irisjax, sampled, monkeypatch):
    written = []
    monkeypatch.setattr(report, "_write", lambda *given: written.append(given) or (1.0, 0.1))
    one_line(irisjax(*fitted.arguments), "--resume continues them, --overwrite starts again")
    assert not sampled
    for how in ("--resume", "--overwrite"):
        assert irisjax(*fitted.arguments, how)[0] == 0
        assert (sampled[-1].resume, sampled[-1].went_on) == (how == "--resume",) * 2
    assert len(written) == 2


def test_what_the_sampler_is_asked(irisjax, eye, sampled):
    said = ("--free", "melanin_load,gain", "--fix", "abl_fraction=0.25")
    said += ("--prior", "gain=normal(1, 0.1)", "--process", "depth-resolved", "--outliers")
    said += ("--relative-noise", "0.05", "--absolute-noise", "1e-3", "--no-first-surface")
    said += ("--cos-incidence", "0.5", "--walkers", "12", "--max-steps", "200", "--seed", "7")
    assert irisjax("fit", eye, *said)[0] == 0
    (call,) = sampled
    assert (call.walkers, call.max_steps, call.resume) == (12, 200, False)
    assert (jax.random.key_data(call.key) == jax.random.key_data(jax.random.key(7))).all()
    problem = call.problem
    assert problem.free == ("melanin_load", "gain")
    assert float(problem.fixed["abl_fraction"]) == 0.25
    assert "normal(1, 0.1)" in repr(problem.priors[1])
    assert problem.process == ij.DEPTH_RESOLVED
    (seen,) = problem.observations
    instrument = seen.instrument
    assert (float(instrument.cos_incidence), instrument.first_surface) == (0.5, False)
    np.testing.assert_allclose(problem.noise.relative, 0.05)
    np.testing.assert_allclose(problem.noise.absolute, 1e-3)
    assert float(problem.noise.degrees_of_freedom) == 4


def test_a_measurement_is_read_by_radiative_transfer(irisjax, eye, sampled, tmp_path):
    """Unless it says that irisjax simulated it by another process, or an option does."""
    bare = tmp_path / "bare.csv"
    bare.write_text(without_header(eye))
    for path, said, process in (
        (bare, (), ij.DEPTH_RESOLVED),
        (bare, ("--process", "ilit-2006"), ij.ILIT_2006),
        (eye, (), ij.ILIT_2006),
        (eye, ("--process", "depth-resolved"), ij.DEPTH_RESOLVED),
    ):
        status, _, err = irisjax("fit", path, *FREE, *said)
        assert (status, sampled[-1].problem.process) == (0, process)
        assert (BY_ILIT in err) == (path == eye and not said)


@pytest.fixture
def seen(done, sampled):
    """Fit a spectrum; returns the observation as the sampler gets it, and what is said of it."""

    def fit(path, *options):
        _, err = done("fit", path, *FREE, *options)
        return sampled[-1].problem.observations[0], err

    return fit


def test_what_the_instrument_averages_is_stated(seen, eye, tmp_path):
    path = tmp_path / "eye.csv"
    path.write_text("# bandwidth: 20 [nm]\n" + without_header(eye))
    slit = ij.Passbands.slit(ij.wavelengths(400, 700, 10), 20.0)
    for file, said in ((eye, ("--bandwidth", "20")), (path, ())):
        found, err = seen(file, *said)
        np.testing.assert_allclose(found.instrument.bands.weights, slit.weights, atol=1e-12)
        assert ("bandwidth of 20 nm, as the file says" in err) == (not said)
    grid, values = np.arange(500.0, 520), np.linspace(3, 4, 20)
    rows = "\n".join(f"{x}\t{y}" for x, y in zip(grid, values, strict=True))
    path.write_text(f"Boxcar width: 3\n>>>>>Begin Spectral Data<<<<<\n{rows}\n")
    of_file = "noise correlated over 7 nm (7 pixels), as the file's boxcar of 3 says"
    for said, smoothed in (((), False), (("--boxcar", "7"), True)):
        found, err = seen(path, *said)
        assert np.asarray(found.correlation_root)[1, 0] == pytest.approx(6 / 7, rel=1e-6)
        assert (found.instrument.bands is not None) == smoothed and of_file in err
    np.save(tmp_path / "c.npy", np.diag(np.full(20, 1e-6)) + 1e-7)
    path.write_text(rows)
    found, _ = seen(path, "--covariance", tmp_path / "c.npy")
    np.testing.assert_allclose(found.sd, np.sqrt(1.1e-6), rtol=1e-6)


def test_a_covariance_is_in_the_order_of_the_file(seen, irisjax, tmp_path):
    """Of a file with falling wavelengths it was applied in the reverse order."""
    path, c = tmp_path / "eye.csv", tmp_path / "c.npy"
    path.write_text("nm,R (fraction),sd\n600,0.03,1\n550,,1\n500,0.04,1\n450,0.05,1\n")
    np.save(c, np.diag([4e-6, 9e-6, 16e-6, 25e-6]))
    found, err = seen(path, "--covariance", c, "--relative-noise", "0.1")
    np.testing.assert_allclose(found.wavelengths, [450, 500, 600])
    np.testing.assert_allclose(found.sd, [5e-3, 4e-3, 2e-3])
    assert f"{path}: has noise of its own; --relative-noise not used" in err
    np.save(c, np.eye(3))
    said = "the covariance is 3 by 3; it must be 4 by 4, a row for each wavelength of the file"
    status, _, err = irisjax("fit", path, "--covariance", c)
    assert status == 2 and said in err


def test_bands_cornea_and_aperture_are_stated(seen, irisjax, tmp_path):
    path, bands = tmp_path / "eye.csv", tmp_path / "bands.csv"
    bands.write_text("centre,fwhm\n450,20\n550,20\n650,30\n")
    path.write_text("nm,R (fraction)\n450,0.03\n550,0.02\n650,0.02\n")
    single = "are read as light of single wavelengths"
    found, err = seen(path, "--bands", bands)
    np.testing.assert_allclose(found.wavelengths, [450, 550, 650])
    assert single not in err
    found, err = seen(path, "--cornea", "round-trip", "--no-first-surface")
    assert (found.instrument.cornea, found.instrument.first_surface) == ("round-trip", False)
    assert single in err
    found, _ = seen(path, "--cos-incidence", "0.7", "--aperture", "0")
    assert float(found.instrument.aperture) == 0
    diffuse = ("--aperture", "0.2", "--cos-incidence", "diffuse")
    one_line(irisjax("fit", path, *diffuse), "diffuse light and an aperture: by reciprocity")
    both = ("--bands", bands, "--bandwidth", "20")
    one_line(irisjax("fit", path, *both), "--bandwidth or --bands, not both")
    empty = tmp_path / "empty.npy"
    empty.touch()  # "interrupted", it said
    one_line(irisjax("fit", path, "--covariance", empty), "empty.npy: No data left in file")
    of_files = f"{path}: column 'R (fraction)' (reflectance) is of a"
    one_line(irisjax("fit", path, "--bands", path), of_files)
    bands.write_text("centre,fwhm\n450,20\n550,20\n")
    said = f"{bands}, bands for {path}: 3 values for 2 bands, centred at 450, 550 nm; need a value"
    one_line(irisjax("fit", path, "--bands", bands), said)


def test_two_spots_of_one_eye(irisjax, eye, sampled, tmp_path, monkeypatch):
    """They share the blood; each has its own melanin where it is separate."""
    other = tmp_path / "spot.csv"
    lines = eye.read_text().splitlines()
    other.write_text("\n".join(lines[:-3]))  # another grid
    monkeypatch.setattr(command, "beside", lambda: nullcontext(lambda *_: lambda: b"figure"))
    both = ("fit", eye, other, "--separate", "melanin_load", *FREE, "-o", tmp_path)
    status, out, err = irisjax(*both)
    assert (status, err) == (0, BY_ILIT)
    assert out.splitlines()[1].startswith("eye.csv, spot.csv: posterior of one eye")
    assert {"melanin_load@1", "melanin_load@2", "hemoglobin", "eumelanin@2"} <= set(out.split())
    sizes = [o.values.size for o in sampled[0].problem.observations]
    assert sizes == [31, 28]
    file = tmp_path / "posterior.nc"
    with xr.open_dataset(file, group="observed_data", engine="h5netcdf") as seen:
        assert [seen[f"wavelength_nm_{i}"].size for i in (1, 2)] == sizes
        assert [seen[f"reflectance_{i}"].size for i in (1, 2)] == sizes


def test_nothing_is_done_for_what_cannot_be_sampled(irisjax, eye, quick, monkeypatch, tmp_path):
    """Too few walkers and priors that no iris has: refused before a file is touched."""
    monkeypatch.setattr(
        report, "report_eye", lambda *given, **settings: pytest.fail("work was done")
    )
    chain = tmp_path / "chain.h5"
    chain.write_text("mine")
    said = ("fit", eye, "-o", tmp_path, "--overwrite")
    for wrong, message in (
        (("--walkers", "8"), "8 walkers are too few for 7 free parameters; give at least 16"),
        (("--prior", "abl_fraction=normal(3, 0.1)"), "lies outside the parameter's range, 0 to 1"),
        (("--prior", "abl_fraction=uniform(0, 2)"), "reaches outside"),
    ):
        one_line(irisjax(*said, *wrong), message)
        assert chain.read_text() == "mine"


def test_fewer_values_than_parameters_is_said(done, sampled, tmp_path):
    path = tmp_path / "one.csv"
    path.write_text("nm,R (%)\n550,4\n")
    _, err = done("fit", path)
    assert "1 value for 6 parameters: at least 5 of them keep their priors" in err


@pytest.mark.parametrize("width", [None, 60])
def test_numbers_are_never_cut(irisjax, eye, sampled, monkeypatch, width):
    """A pipe takes lines of any length; a narrow terminal gets fewer columns."""
    if width is not None:
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    out = irisjax("fit", eye, *FREE)[1]
    assert "…" not in out
    lines = out.splitlines()
    assert "parameter" in lines[2]
    if width is None:
        assert lines[2].split()[-1] == "contraction"
    else:
        plain = [re.sub(r"\x1b\[\d*m", "", line) for line in lines[2:7]]
        assert max(map(len, plain)) <= width


def test_short_chains_end_with_status_three(irisjax, eye, sampled, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    status, out, err = irisjax("fit", eye, *FREE, "--max-steps", 40)
    assert status == 3
    assert "NOT CONVERGED: 40 steps" in out
    assert "nan" not in out
    # A terminal is told at once what takes so long; without one nothing is said.
    assert err.lstrip("\r").startswith("compiling")
    assert err.index("compiling") < err.index("sampling")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give the SPECTRUM of an eye, or --batch"),
        (("{eye}", "--batch", "{eye}"), "give the SPECTRUM of an eye, or --batch"),
        (("{eye}", "{eye}", "--separate", "melanin"), "--separate: unknown parameter 'melanin'"),
        (("{eye}", "{eye}", "--separate", "abl_thickness"), "is not free"),
        (("{eye}", "--separate", "melanin_load"), "--separate needs two or more spectra"),
        (("missing.csv",), "missing.csv: No such file"),
        ((".",), ".: is a folder; --batch fits all spectra in it"),
        (("{eye}", "--free", "melanin"), "--free: unknown parameter 'melanin'"),
        (("{eye}", "--fix", "gain"), "--fix: 'gain': write NAME=VALUE"),
        (("{eye}", "--fix", "gain=-1"), "gain = -1 is outside (0, 1e+06]"),
        (("{eye}", "--fix", "gian=1"), "--fix: unknown 'gian'"),
        (("{eye}", "--fix", "gain=1", "--fix", "gain=2"), "--fix: gain is there twice"),
        (("{eye}", "--free", "gain,gain"), "--free: gain is there twice"),
        (("{eye}", "{eye}"), "given twice; it would count as two measurements"),
        (("{eye}", "--flows", "flows"), "--flows means something only with --batch"),
        (("{eye}", "--resume"), "--resume means something only with -o FOLDER"),
        (
            ("{eye}", "-o", "fits", "--resume", "--overwrite"),
            "--resume continues a run, --overwrite starts again: give one of them",
        ),
        (("{eye}", "--illuminant", "A"), "--illuminant means something only with --quantity"),
        (("{eye}", "--prior", "gain=flat"), "'flat' is no prior"),
        (("{eye}", "--walkers", "3"), "--walkers: 3 is outside [4, 4096]"),
        (("{eye}", "--process", "ilit"), "--process: unknown 'ilit'"),
        (("{eye}", "--discrepancy", "0.02"), "write its size and its length"),
        (("{eye}", "--discrepancy", "0.02:50", "--outliers"), "do not go together"),
        (("{eye}", "--quantity", "radiance", "--illuminant", "sun"), "unknown illuminant 'sun'"),
        (("--batch", "{eye}", "--posteriors", "emcee"), "--posteriors needs -o"),
        (
            ("--batch", "{eye}", "--flows", "flows", "-o", "fits"),
            "--flows means something only with --posteriors amortised",
        ),
        (("{eye}", "-o", "{eye}"), "is a file, not a folder"),
    ],
)
def test_wrong_input_is_one_line(irisjax, quick, eye, arguments, message):
    one_line(irisjax("fit", *(str(eye) if a == "{eye}" else a for a in arguments)), message)


def test_help_names_every_parameter_and_its_prior(done, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    out, _ = done("fit", "--help")
    for name, parameter in PARAMETERS.items():
        (line,) = (
            line for line in out.splitlines() if line.startswith((f" * {name}", f" · {name}"))
        )
        assert repr(parameter.prior) in line
        assert ("*" in line) == (name in DEFAULT_FREE)


@pytest.fixture(scope="module")
def spectrum(tmp_path_factory):
    """A spectrum of the model itself."""
    path = tmp_path_factory.mktemp("eye") / "eye.csv"
    assert cli.run(["simulate-measurement", "--level", "low", "--seed", "2", "-o", str(path)]) == 0
    return path


@pytest.mark.peer  # search and sampler are tests/infer's
def test_one_eye_by_the_model_itself(irisjax, spectrum, tmp_path):
    folder = tmp_path / "out"
    arguments = ("fit", spectrum, "-o", folder, *FREE)
    status, out, err = irisjax(*arguments)
    assert (status, err) == (0, BY_ILIT)
    assert "load" in out.splitlines()[-1] or "known" in out
    assert {p.name for p in folder.iterdir()} == FILES
    rows, truth = rows_by("parameter", folder / "summary.csv"), truth_of(spectrum)
    for name in ("melanin_load", "hemoglobin"):
        row = rows[name]
        assert abs(float(row["median"]) - truth[name]) < 5 * float(row["sd"])
        assert float(row["ess_bulk"]) >= 1000
    before = (folder / "summary.csv").read_bytes()
    for how in ("--resume", "--overwrite"):
        assert irisjax(*arguments, how)[0] == 0
        assert (folder / "summary.csv").read_bytes() == before
    status, _, err = irisjax(*arguments, "--resume", "--seed", 1)
    assert status == 2 and "it cannot be resumed with these" in err
