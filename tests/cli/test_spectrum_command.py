"""`irisjax spectrum`, `brdf` and `colour`: results as the library gives them, plots, swatches."""

import contextlib
import dataclasses
import importlib
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from refusals import one_line
from stand_ins import Quick

import irisjax as ij
from irisjax.anatomy.media import Media
from irisjax.cli import measure
from irisjax.cli.light import ColourLight, SpectrumLight
from irisjax.measure.polarimeter import PolarisedReading
from irisjax.tissue.iris import LIMITS
from irisjax.transport.solution import RESULTS, Absorbed

observing = importlib.import_module("irisjax.measure.observe")

GRID = ("--wavelengths", "400:700:100")
SAMPLED = ("--solver", "monte-carlo", "--photons")
DEEP = ij.DEPTH_RESOLVED


IRIS = ij.Iris.of_level("low").replace(abl_fraction=0.2)
SAID = ("--level", "low", "--abl-fraction", "0.2", "--wavelengths", "400:700:100")
CASES = {
    "reflectance": (
        ("spectrum", "--cornea", "round-trip", "--cos-incidence", "0.6", "--no-first-surface"),
        lambda grid, **how: ij.reflectance(
            IRIS, grid, cornea="round-trip", cos_incidence=0.6, first_surface=False, **how
        ),
    ),
    "diffuse": (
        ("spectrum", "--cos-incidence", "diffuse", "--aqueous-index", "1.34"),
        lambda grid, **how: ij.reflectance(
            IRIS, grid, cos_incidence="diffuse", media=Media(aqueous=1.34), **how
        ),
    ),
    "radiance": (
        ("spectrum", "--instrument", "radiance", "--illuminant", "A", "--tear-index", "1.4"),
        lambda grid, **how: ij.radiance(IRIS, grid, illuminant="A", media=Media(tear=1.4), **how),
    ),
    "brdf": (
        ("brdf", "--angles", "6", "--incidence-deg", "60", "--process", "ilit-corrected"),
        lambda grid, **how: ij.brdf(
            IRIS,
            grid,
            cos_incidence=0.5,
            cos_exit=ij.principal_plane(6)[1],
            azimuth=ij.principal_plane(6)[2],
            **how,
        ),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_values_are_the_librarys(irisjax, quick, printed, name):
    arguments, library = CASES[name]
    status, out, err = irisjax(*arguments, *SAID)
    assert (status, err) == (0, "")
    header, columns = printed(out)
    assert header["abl_fraction"] == "0.2"
    assert "not a measurement" in header["simulated"]
    assert "twice as bright" in header["approximation"]
    process = ij.ILIT_CORRECTED if name == "brdf" else ij.ILIT_2006
    expected = library(ij.wavelengths(400, 700, 100), solver=Quick(process=process))
    (quantity,) = set(columns) - {"wavelength_nm", "angle_deg", "azimuth_deg"}
    np.testing.assert_allclose(columns[quantity], expected.values.ravel(), rtol=1e-11)
    if name == "brdf":
        np.testing.assert_allclose(columns["angle_deg"][:6], [75, 45, 15, 15, 45, 75])
        np.testing.assert_allclose(columns["azimuth_deg"][:6], [180, 180, 180, 0, 0, 0])
        assert float(header["cos_incidence"]) == pytest.approx(0.5)


def test_transmittance_by_either_name(irisjax, quick, printed):
    how = ("--ipe-melanin", "2", "--wavelengths", "650", "--level", "low")
    found = [irisjax("spectrum", name, "transmittance", *how) for name in NAMES]
    assert found[0] == found[1]
    columns = printed(found[0][1]).columns
    iris = ij.Iris.of_level("low").replace(ipe_melanin=2.0)
    expected = ij.transmittance(iris, [650.0], solver=Quick())
    np.testing.assert_allclose(columns["transmittance"], expected.values)
    status, _, err = irisjax("spectrum", NAMES[0], "transmittance", "--wavelengths", "650")
    assert status == 2
    assert "no light gets behind a black pigment epithelium" in err
    assert irisjax("spectrum", "--quantity", "colour")[0] == 2
    status, _, err = irisjax("spectrum", NAMES[0], "radiance", NAMES[1], "transmittance", *how)
    assert status == 2
    assert "are one option by two names: give one of them" in err


NAMES = "--instrument", "--quantity"
POWER_LAW = ("--process", "depth-resolved", "--reduced-scattering", "1.2")


def test_a_power_law_of_scattering_is_measured_from_the_shell(irisjax, quick, printed):
    status, out, err = irisjax("spectrum", *POWER_LAW, "--anisotropy", "0.85", *GRID)
    assert (status, err) == (0, "")
    header, columns = printed(out)
    assert "not known under a power law" in header["approximation"]
    iris, solver = ij.Iris().replace(reduced_scattering=1.2, anisotropy=0.85), Quick(process=DEEP)
    expected = ij.reflectance(iris, ij.wavelengths(400, 700, 100), solver=solver)
    np.testing.assert_allclose(columns["reflectance"], expected.values, rtol=1e-9)


@pytest.mark.peer
def test_a_brdf_has_the_angles_that_its_anisotropy_takes(irisjax):
    grid = ("--wavelengths", "700", "--angles", "4")
    assert irisjax("brdf", *POWER_LAW, "--anisotropy", "0.85", *grid)[0] == 0


@pytest.mark.parametrize(
    ("light", "scalar", "said"),
    [
        (ColourLight(), [1, 0.99, 1], "luminance 1.0 % low against"),
        (ColourLight(), [1, 1.0001, 1], "luminance within 0.05 % of"),
        (SpectrumLight(), [0.996, 0.994], "values 0.4 to 0.6 % low against"),
        (SpectrumLight(), [0.996, 1.01], "values 1.0 % high to 0.4 % low against"),
    ],
)
def test_how_far_scalar_theory_is_off_is_said(monkeypatch, light, scalar, said):
    def observe(iris, instrument, solver):
        found = np.asarray(scalar if solver.process == DEEP else np.ones(len(scalar)))
        return SimpleNamespace(xyz=found, values=found)

    monkeypatch.setattr(measure, "observe", observe)
    told = measure._scalar_theory_error(ij.Iris(), light)
    assert told == f"{said} polarised transport of the same layers"


@pytest.mark.peer
def test_brdf_by_photons(irisjax, printed):
    columns = printed(irisjax("brdf", "--angles", "6", *SAMPLED, "2000")[1]).columns
    names = ["wavelength_nm", "angle_deg", "azimuth_deg", "brdf_per_sr", "standard_error"]
    assert list(columns) == names


def test_equal_seeds_give_equal_bytes_whatever_the_block(irisjax, done, monkeypatch):
    arguments = ("spectrum", *SAMPLED, "300", "--level", "high", *GRID)
    first, err = done(*arguments, "--seed", "5")
    assert "fewer than 10 photons" in err
    monkeypatch.setattr(observing, "_BLOCK", 4 * 100)
    assert irisjax(*arguments, "--seed", "5")[1] == first
    other = irisjax(*arguments, "--seed", "6")[1]
    assert other != first.replace("seed: 5", "seed: 6")


def test_progress_is_told(irisjax, monkeypatch):
    told = []

    def observe(*_, progress, **__):
        progress(3)
        raise ValueError("enough")

    class Bar(contextlib.nullcontext):
        def __init__(self, total, **_):
            told.append(total)
            super().__init__(SimpleNamespace(update=told.append))

    monkeypatch.setattr(measure, "observe", observe)
    monkeypatch.setattr(measure, "tqdm", Bar)
    assert irisjax("spectrum", *SAMPLED, "9")[0] == 2
    assert told == [9, 3]


def test_brdf_over_the_hemisphere(done, quick, printed):
    over = ("--plane", "hemisphere", "--angles", "8")
    out, _ = done("brdf", *over, "--wavelengths", "450,650")
    columns = printed(out).columns
    assert columns["brdf_per_sr"].size == 2 * 4 * 8
    assert columns["angle_deg"].max() < 90
    assert np.unique(columns["azimuth_deg"]).size == 8
    per_angle = columns["brdf_per_sr"][columns["wavelength_nm"] == 450].reshape(4, 8)
    assert (np.diff(per_angle[:, 0]) < 0).all()  # as the stand-in's cosine


def test_every_parameter_and_switch_is_in_the_header(irisjax, quick, printed):
    header = printed(irisjax("spectrum", *GRID)[1]).header
    optional = {"abl_index", "stroma_index", "pheomelanin_abl_fraction", "ipe_melanin"}
    assert set(LIMITS) - optional <= set(header)
    switches = {"process", "phase", "rescatter", "perturb_on_reflection", "scattering", "cornea"}
    assert {"irisjax", *switches} <= set(header)
    assert header["irisjax"] == ij.__version__


def test_colour_and_swatch(irisjax, quick, tmp_path):
    path = tmp_path / "swatch.png"
    status, out, err = irisjax("colour", "--level", "low", "--swatch", path)
    assert (status, err) == (0, "")
    assert "inside sRGB" in out
    row = next(line for line in out.splitlines() if line.startswith("sRGB 8 bit")).split()
    pixels = np.asarray(Image.open(path).convert("RGB"))
    assert np.unique(pixels.reshape(-1, 3), axis=0).tolist() == [[int(v) for v in row[3:6]]]
    assert row[6] == "#" + "".join(f"{int(v):02x}" for v in row[3:6])


def test_colours_out_of_gamut_are_reported(done, quick, monkeypatch, tmp_path):
    true = measure._observe

    def shifted(*arguments, **options):
        found = true(*arguments, **options)
        srgb = found.srgb.at[0].set(-0.2)
        return dataclasses.replace(found, srgb=srgb, in_gamut=jnp.asarray(False))

    monkeypatch.setattr(measure, "_observe", shifted)
    out, _ = done("colour", "--swatch", tmp_path / "swatch.png")
    assert "outside sRGB's gamut: the 8-bit values are clipped" in out


@pytest.mark.parametrize(
    ("arguments", "magic"),
    [
        (("spectrum", "--plot", "f.pdf", *GRID), b"%PDF"),
        (("brdf", "--plot", "f.svg", "--angles", "6"), b"<?xml"),
        (("brdf", "--plot", "f.png", "--angles", "6", "--plane", "hemisphere"), b"\x89PNG"),
    ],
)
def test_plots(irisjax, quick, tmp_path, monkeypatch, arguments, magic):
    monkeypatch.chdir(tmp_path)
    assert irisjax(*arguments)[0] == 0
    (path,) = tmp_path.iterdir()
    first = path.read_bytes()
    assert first.startswith(magic)
    if magic != b"\x89PNG":  # the others have dates and names of their own
        assert irisjax(*arguments)[0] == 0
        assert path.read_bytes() == first


def test_bands_are_read_and_written(irisjax, done, printed, quick, tmp_path):
    bands = tmp_path / "bands.csv"
    bands.write_text("centre,fwhm\n600,30\n450,20\n")
    out, _ = done("spectrum", "--bands", bands)
    found = printed(out)
    np.testing.assert_allclose(found.columns["wavelength_nm"], [450, 600])
    assert found.header["bands"] == str(bands)
    again = tmp_path / "again.csv"
    again.write_text(out)
    assert irisjax("spectrum", "--from", again)[1] == out
    status, out, _ = irisjax("spectrum", "--bandwidth", "20", "--wavelengths", "450,600")
    assert (status, printed(out).header["bandwidth"]) == (0, "20.0")
    one_line(irisjax("spectrum", "--bands", bands, "--wavelengths", "450"), "without --wavelengths")
    wrong = ("--bandwidth", "5", "--instrument", "cross-polarised")
    one_line(irisjax("spectrum", *wrong), "--bandwidth")


def test_blood_by_its_amount_and_its_oxygen(irisjax, printed, quick, tmp_path):
    status, out, _ = irisjax("spectrum", "--hemoglobin", "0.1", "--saturation", "0.7")
    header = printed(out).header
    assert (status, float(header["oxyhemoglobin"])) == (0, pytest.approx(0.07))
    assert "hemoglobin" not in header
    again = tmp_path / "again.csv"
    again.write_text(out)
    header = printed(irisjax("spectrum", "--from", again, "--saturation", "0.2")[1]).header
    assert float(header["deoxyhemoglobin"]) == pytest.approx(0.08)
    both = ("--saturation", "0.5", "--oxyhemoglobin", "0.1")
    one_line(irisjax("spectrum", *both), "--saturation sets both haemoglobins")
    one_line(irisjax("spectrum", "--saturation", "2"), "saturation = 2 is outside")


WAVELENGTHS = np.array([450.0, 620.0])


@pytest.fixture
def observed(monkeypatch):
    """Readings of polarised light that are known; what is asked for."""
    half, asked = jnp.full(2, 0.5), []
    absorbed = Absorbed(half, half, half)
    reading = PolarisedReading(
        *(jnp.asarray(WAVELENGTHS), half, None, RESULTS.successful, absorbed),
        *(half, None, "degree of linear polarisation", "", half, jnp.ones((2, 4))),
    )
    monkeypatch.setattr(measure, "observe", lambda *given, **_: asked.append(given) or reading)
    return asked


CO_POLARISED = {"setting": "parallel", "cos_exit": "hemisphere", "polariser": np.radians(30)}


@pytest.mark.parametrize(
    ("arguments", "make", "how"),
    [
        ("cross-polarised", ij.Analyser, {"setting": "crossed"}),
        ("co-polarised --exit-deg hemisphere --polariser-deg 30", ij.Analyser, CO_POLARISED),
        ("degree-of-polarisation", ij.Polarimeter, {"cos_exit": np.sqrt(0.5)}),
    ],
)
def test_polarimeters_are_the_librarys(irisjax, observed, printed, arguments, make, how):
    said = ("--wavelengths", "450,620", "--level", "low", "--instrument", *arguments.split())
    status, out, err = irisjax("spectrum", *said)
    assert (status, err) == (0, "")
    ((iris, found, solver),) = observed
    assert eqx.tree_equal(iris, ij.Iris.of_level("low"), rtol=1e-12)
    assert eqx.tree_equal(found, make(WAVELENGTHS, **how), rtol=1e-12)
    assert solver.process == ij.POLARISED
    header, columns = printed(out)
    assert (header["process"], header["polarised"]) == ("depth-resolved", "yes")
    assert arguments.split("-")[0] in header["simulated"]
    assert "photographs" in header["approximation"]
    assert columns["degree_of_linear_polarisation"].tolist() == [0.5, 0.5]
    np.testing.assert_allclose(columns["angle_deg"], np.degrees(0.5))
