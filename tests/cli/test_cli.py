"""The command: results as the library gives them, files that run again, one line for every wrong
input.
"""

import os
import signal
import subprocess
import sys

import jax
import numpy as np
import pytest

import irisjax as ij
from irisjax import cli, io
from irisjax.__main__ import main as door
from irisjax.cli import jobs

from irisjax.tissue.iris import LIMITS

GRID = ("--wavelengths", "400:700:100")


@pytest.fixture(autouse=True)
def _precision_kept():
    # The command switches x64 on; the tests that share this process must not notice.
    before = jax.config.read("jax_enable_x64")
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def irisjax(capsys, monkeypatch):
    """Run the command in this process; gives status, standard output and standard error."""
    monkeypatch.setenv("TERMINAL_WIDTH", "200")
    monkeypatch.delenv("IRISJAX_DEBUG", raising=False)

    def run(*arguments):
        status = cli.run([str(a) for a in arguments])
        return status, *capsys.readouterr()

    return run


def table(tmp_path, text):
    path = tmp_path / "printed.csv"
    path.write_text(text)
    return io.read_table(path)


def test_spectrum_is_the_librarys(irisjax, tmp_path):
    status, out, err = irisjax("spectrum", "--level", "low", "--abl-fraction", "0.2", *GRID)
    assert (status, err) == (0, "")
    header, columns = table(tmp_path, out)
    assert list(columns) == ["wavelength_nm", "reflectance"]
    assert header["abl_fraction"] == "0.2"
    assert "not a measurement" in header["simulated"]
    assert "twice as bright" in header["approximation"]
    iris = ij.Iris.of_level("low").replace(abl_fraction=0.2)
    expected = ij.reflectance(iris, ij.wavelengths(400, 700, 100))
    np.testing.assert_allclose(columns["reflectance"], expected.values, rtol=1e-11)


def test_radiance_brdf_and_monte_carlo_columns(irisjax, tmp_path):
    sampled = ("--solver", "monte-carlo", "--photons", "2000")
    _, out, _ = irisjax(
        "spectrum", "--instrument", "radiance", "--illuminant", "A", *GRID, *sampled
    )
    header, columns = table(tmp_path, out)
    assert list(columns) == ["wavelength_nm", "radiance", "standard_error"]
    assert header["illuminant"] == "A"
    status, out, _ = irisjax("brdf", "--angles", "6", "--incidence-deg", "60", *sampled)
    assert status == 0
    header, columns = table(tmp_path, out)
    assert list(columns) == [
        "wavelength_nm",
        "angle_deg",
        "azimuth_deg",
        "brdf_per_sr",
        "standard_error",
    ]
    np.testing.assert_allclose(columns["angle_deg"], [75, 45, 15, 15, 45, 75])
    np.testing.assert_allclose(columns["azimuth_deg"], [180, 180, 180, 0, 0, 0])
    assert float(header["cos_incidence"]) == pytest.approx(0.5)


def test_brdf_over_the_hemisphere(irisjax, tmp_path):
    status, out, _ = irisjax(
        "brdf", "--plane", "hemisphere", "--angles", "8", "--wavelengths", "450,650"
    )
    assert status == 0
    columns = table(tmp_path, out).columns
    assert columns["brdf_per_sr"].size == 2 * 4 * 8
    assert columns["angle_deg"].max() < 90
    at_450 = columns["wavelength_nm"] == 450
    # ILIT's BRDF does not know the azimuth.
    per_angle = columns["brdf_per_sr"][at_450].reshape(4, 8)
    np.testing.assert_allclose(per_angle, per_angle[:, :1].repeat(8, 1), rtol=1e-10)


@pytest.mark.parametrize(
    "arguments",
    [
        ("spectrum", "--melanin-load", "0.3", "--abl-index", "1.44", "--no-first-surface"),
        (
            "spectrum",
            "--process",
            "ilit-corrected",
            "--rescatter",
            "retest",
            "--scattering",
            "rayleigh-spheres",
        ),
        (
            "spectrum",
            "--instrument",
            "radiance",
            "--illuminant",
            "FL3.1",
            "--cornea",
            "round-trip",
        ),
        ("spectrum", "--cos-incidence", "diffuse", "--perturb-on-reflection"),
        ("spectrum", "--solver", "monte-carlo", "--photons", "2e3", "--seed", "7"),
        ("spectrum", "--solver", "monte-carlo", "--photons", "2000", "--estimator", "quasi"),
        ("brdf", "--incidence-deg", "37", "--plane", "hemisphere", "--angles", "4"),
    ],
)
def test_a_file_runs_again_to_the_same_bytes(irisjax, tmp_path, arguments):
    path = tmp_path / "first.csv"
    status, out, err = irisjax(*arguments, *GRID, "-o", path)
    assert (status, out, err) == (0, "", "")
    status, out, err = irisjax(arguments[0], "--from", path)
    assert (status, err) == (0, "")
    assert out == path.read_text()


def test_options_change_what_a_file_says(irisjax, tmp_path):
    path = tmp_path / "first.csv"
    irisjax("spectrum", "--level", "low", "--phase", "rayleigh", "--lutein", "0", *GRID, "-o", path)
    changes = ("--level", "high", "--process", "ilit-2006", "--incidence-deg", "10")
    header = table(tmp_path, irisjax("spectrum", "--from", path, *changes)[1]).header
    assert header["eumelanin"] == "1.008"
    assert header["phase"] == "lb06"
    assert header["lutein"] == "0.0"
    assert header["wavelengths"] == "400:700:100"
    # Another command takes iris and process from the file, not its grid.
    _, out, err = irisjax("colour", "--from", path)
    assert "is of another command; not taken from it: wavelengths" in err
    assert "# eumelanin: 0.1201 [mg/ml]" in out
    assert "# phase: rayleigh" in out
    assert "# wavelengths: 380:780:5" in out


def test_every_parameter_and_switch_is_in_the_header(irisjax, tmp_path):
    header = table(tmp_path, irisjax("spectrum", *GRID)[1]).header
    optional = {"abl_index", "stroma_index"}
    assert set(LIMITS) - optional <= set(header)
    assert {
        "irisjax",
        "process",
        "phase",
        "rescatter",
        "perturb_on_reflection",
        "scattering",
        "cornea",
    } <= set(header)
    assert header["irisjax"] == ij.__version__


def test_equal_seeds_give_equal_bytes_whatever_the_block(irisjax, monkeypatch):
    arguments = ("spectrum", "--solver", "monte-carlo", "--photons", "3000", *GRID)
    first = irisjax(*arguments, "--seed", "5")[1]
    monkeypatch.setattr(jobs, "_BLOCK", 4 * 700)
    assert irisjax(*arguments, "--seed", "5")[1] == first
    other = irisjax(*arguments, "--seed", "6")[1]
    assert other != first.replace("seed: 5", "seed: 6")


def test_colour_and_swatch(irisjax, tmp_path):
    import matplotlib.image

    path = tmp_path / "swatch.png"
    status, out, err = irisjax("colour", "--level", "low", "--swatch", path)
    assert (status, err) == (0, "")
    assert "inside sRGB" in out
    row = next(line for line in out.splitlines() if line.startswith("sRGB 8 bit")).split()
    pixels = np.rint(255 * matplotlib.image.imread(path)[..., :3]).astype(int)
    assert np.unique(pixels.reshape(-1, 3), axis=0).tolist() == [[int(v) for v in row[3:6]]]
    assert row[6] == "#" + "".join(f"{int(v):02x}" for v in row[3:6])


def test_colours_out_of_gamut_are_reported(irisjax, monkeypatch, tmp_path):
    import equinox as eqx

    true = ij.colour

    def shifted(*arguments, **options):
        result = true(*arguments, **options)
        bad = eqx.tree_at(lambda c: c.srgb, result, result.srgb.at[0].set(-0.2))
        return eqx.tree_at(lambda c: c.in_gamut, bad, np.asarray(False))

    monkeypatch.setattr(ij, "colour", shifted)
    status, out, _ = irisjax("colour", "--swatch", tmp_path / "swatch.png")
    assert status == 0
    assert "outside sRGB's gamut: the 8-bit values are clipped" in out


@pytest.mark.parametrize(
    ("arguments", "magic"),
    [
        (("spectrum", "--plot", "f.png", *GRID), b"\x89PNG"),
        (
            ("spectrum", "--plot", "f.pdf", "--solver", "monte-carlo", "--photons", "500", *GRID),
            b"%PDF",
        ),
        (("brdf", "--plot", "f.svg", "--angles", "6"), b"<?xml"),
        (("brdf", "--plot", "f.png", "--angles", "6", "--plane", "hemisphere"), b"\x89PNG"),
    ],
)
def test_plots(irisjax, tmp_path, monkeypatch, arguments, magic):
    monkeypatch.chdir(tmp_path)
    assert irisjax(*arguments)[0] == 0
    (path,) = tmp_path.iterdir()
    first = path.read_bytes()
    assert first.startswith(magic)
    assert irisjax(*arguments)[0] == 0
    assert path.read_bytes() == first


WRONG = [
    (("--level", "middling"), "--level: unknown 'middling'; known: low, moderate, high"),
    (("--eumelanin", "-1"), "eumelanin = -1 mg/ml is outside [0, inf) mg/ml"),
    (("--eumelanin", "nan"), "eumelanin = nan mg/ml is outside"),
    (("--lutein", "much"), "--lutein: 'much' is not a number"),
    (("--abl-fraction", "1.5"), "abl_fraction = 1.5 is outside [0, 1]"),
    (("--melanin-load", "-0.1"), "melanin_load = -0.1"),
    (("--pupil-radius", "7"), "pupil_radius = 7 mm exceeds iris_radius = 5.5 mm"),
    (
        ("--wavelengths", "300:700:10"),
        "--wavelengths: 300 nm is outside the pigment tables (350 to 800 nm)",
    ),
    (("--wavelengths", "550,nan"), "--wavelengths: nan nm is outside the pigment tables"),
    (("--wavelengths", "700:400:10"), "need start <= stop"),
    (("--wavelengths", "400:700:0"), "step > 0"),
    (("--wavelengths", "400:700:11"), "does not divide the range"),
    (("--wavelengths", "400:700:nan"), "--wavelengths: "),
    (("--wavelengths", "400:700:1e-9"), "more than 1000000 wavelengths"),
    (("--wavelengths", "500,450"), "wavelengths must increase; 500 nm is followed by 450 nm"),
    (("--wavelengths", "400:700"), "'400:700' is not a grid; give start:stop:step"),
    (("--wavelengths", "blue"), "'blue' is not a grid"),
    (("--wavelengths", ""), "'' is not a grid"),
    (("--solver", "monte-carlo", "--photons", "0"), "--photons: 0 is outside 1 to 2146435072"),
    (("--solver", "monte-carlo", "--photons", "-5"), "--photons: -5 is outside 1 to"),
    (("--solver", "monte-carlo", "--photons", "1.5"), "--photons: 1.5 is not a whole number"),
    (("--solver", "monte-carlo", "--photons", "inf"), "--photons: inf is not a whole number"),
    (("--photons", "100"), "--photons means something only with --solver monte-carlo"),
    (("--solver", "monte-carlo", "--seed", "1.5"), "--seed: 1.5 is not a whole number"),
    (("--solver", "monte-carlo", "--seed", "luck"), "--seed: 'luck' is not a number"),
    (("--solver", "monte-carlo", "--seed", "-1"), "--seed: -1 is outside 0 to 4294967295"),
    (("--solver", "monte-carlo", "--estimator", "guess"), "--estimator: unknown 'guess'"),
    (
        ("--solver", "monte-carlo", "--estimator", "quasi", "--process", "depth-resolved"),
        "use estimator",
    ),
    (("--solver", "oracle"), "--solver: unknown 'oracle'; known: exact, monte-carlo"),
    (("--process", "ilit-2007"), "--process: unknown 'ilit-2007'"),
    (("--process", "depth-resolved", "--phase", "lb06"), 'takes phase="rayleigh" only'),
    (
        ("--process", "depth-resolved", "--rescatter", "retest"),
        "--rescatter means something only with",
    ),
    (("--illuminant", "D65"), "--illuminant means something only with --instrument radiance"),
    (("--instrument", "radiance", "--illuminant", "moon"), "unknown illuminant 'moon'"),
    (("--instrument", "radiance", "--cos-incidence", "diffuse"), "diffuse"),
    (("--cos-incidence", "1.1"), "--cos-incidence: 1.1 is outside 0 to 1"),
    (("--cos-incidence", "1", "--incidence-deg", "0"), "not both"),
    (("-o", "missing/file.csv"), "missing: no such folder"),
    (("-o", "."), ".: is a folder"),
    (("--plot", "figure.doc"), "figure.doc: a picture's name must end in .png or .pdf or .svg"),
    (("--plot", "figure"), "figure: a picture's name must end in"),
    (("--plot", "same.png", "-o", "same.png"), "same file"),
    (("--from", "missing.csv"), "missing.csv: No such file"),
    (("--eumelanine", "1"), "--eumelanine"),
    (("--eumelanin",), "--eumelanin"),
    (("stray",), "stray"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG, ids=[" ".join(a) for a, _ in WRONG])
def test_wrong_input_is_one_line(irisjax, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    extra = () if "-o" in arguments else ("-o", "out.csv")
    status, out, err = irisjax("spectrum", *extra, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("irisjax: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert message in err
    assert not list(tmp_path.iterdir())


def test_wrong_command_and_wrong_swatch(irisjax, tmp_path):
    for arguments in (
        ("spectra",),
        ("colour", "--swatch", tmp_path / "swatch.jpg"),
        ("colour", "--observer", "x"),
    ):
        status, out, err = irisjax(*arguments)
        assert (status, out, err.count("\n")) == (2, "", 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "no header of settings"),
        ("# eumelanin: 0.1\n# eumelanine: 0.2\n", "unknown setting 'eumelanine'"),
        ("# eumelanin: lots\n", "old.csv: eumelanin: 'lots' is not a number"),
        ("# eumelanin: -2\n", "eumelanin = -2"),
    ],
)
def test_wrong_headers_are_one_line(irisjax, tmp_path, text, message):
    path = tmp_path / "old.csv"
    path.write_text(text)
    status, out, err = irisjax("spectrum", "--from", path)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_a_fault_of_our_own_is_one_line(irisjax, monkeypatch):
    def broken(*_, **__):
        raise TypeError("two\nlines")

    monkeypatch.setattr(ij, "reflectance", broken)
    status, out, err = irisjax("spectrum")
    assert (status, out) == (1, "")
    assert err == "irisjax: internal error: TypeError: two lines (IRISJAX_DEBUG=1 tells more)\n"


def test_interrupt_is_one_line(irisjax, monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(ij, "reflectance", interrupted)
    assert irisjax("spectrum", "-o", tmp_path / "out.csv") == (130, "", "irisjax: interrupted\n")
    assert not list(tmp_path.iterdir())


def test_help_and_version(irisjax):
    assert irisjax("--version") == (0, f"irisjax {ij.__version__}\n", "")
    status, out, _ = irisjax()
    assert status == 0
    assert "spectrum" in out
    for command, settings in {}.items():
        status, out, err = irisjax(command, "--help")
        assert (status, err) == (0, "")
        for setting in settings:
            assert setting.typed() in out
    assert "mg/ml" in out
    assert "0 to 1; default 0.5" in out


def python(*arguments, **options):
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        env=environment,
        **options,
    )


def test_the_real_command(tmp_path):
    done = python(
        "-m",
        "irisjax",
        "spectrum",
        "--level",
        "low",
        "--wavelengths",
        "450",
        "-o",
        "x.csv",
        cwd=tmp_path,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    value = io.read_table(tmp_path / "x.csv").columns["reflectance"]
    assert value == pytest.approx(0.0405, abs=5e-5)
    done = python("-m", "irisjax", "spectrum", "--level", "none", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


def test_ctrl_c_while_importing(monkeypatch, capsys):
    class Interrupted:
        @staticmethod
        def find_spec(name, *_):
            if name == "irisjax.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "irisjax.cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    with pytest.raises(SystemExit) as left:
        door()
    assert (left.value.code, capsys.readouterr().err) == (130, "irisjax: interrupted\n")


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_ctrl_c_in_a_long_run(tmp_path):
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            INTERRUPTIBLE,
            *["spectrum", "--solver", "monte-carlo", "--photons", "2e9", "-o", "x.csv"],
        ],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "block\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "irisjax: interrupted\n")
    assert not list(tmp_path.iterdir())


# Says when photons are on their way.
INTERRUPTIBLE = """
import sys
from irisjax import cli
from irisjax.cli import jobs
count = jobs.MonteCarlo.count
def told(*arguments, **options):
    print("block", flush=True)
    return count(*arguments, **options)
jobs.MonteCarlo.count = told
cli.main(sys.argv[1:])
"""


def test_import_loads_no_pictures_and_no_colour():
    heavy = ("matplotlib", "colour", "emcee", "arviz", "viser", "typer", "tqdm", "OpenImageIO")
    code = (
        f"import sys, irisjax; irisjax.reflectance; print([m for m in {heavy} if m in sys.modules])"
    )
    assert python("-c", code).stdout == "[]\n"
    code = "import sys, irisjax.cli; print([m for m in ('matplotlib', 'colour', 'OpenImageIO') if m in sys.modules])"
    assert python("-c", code).stdout == "[]\n"


def test_modules_load_when_asked_for():
    code = "import irisjax as ij; print(ij.tissue.iris.__name__, ij.io.scenes.__name__, hasattr(ij.render, 'nothing'))"
    assert python("-c", code).stdout == "irisjax.tissue.iris irisjax.io.scenes False\n"


def test_import_leaves_the_precision_alone():
    code = "import irisjax, irisjax.cli, jax; print(jax.config.read('jax_enable_x64'))"
    assert python("-c", code).stdout == "False\n"
