"""`irisjax spectrum`, `brdf` and `colour`: results as the library gives them, plots, swatches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.cli import jobs
from irisjax.tissue.iris import LIMITS
from irisjax.transport.montecarlo import Counts, MonteCarlo

GRID = ("--wavelengths", "400:700:100")


@pytest.mark.parametrize("solver", ["quick", pytest.param("exact", marks=pytest.mark.slow)])
def test_spectrum_is_the_librarys(irisjax, printed, request, solver):
    if solver == "quick":
        request.getfixturevalue("quick")
    status, out, err = irisjax("spectrum", "--level", "low", "--abl-fraction", "0.2", *GRID)
    assert (status, err) == (0, "")
    header, columns = printed(out)
    assert list(columns) == ["wavelength_nm", "reflectance"]
    assert header["abl_fraction"] == "0.2"
    assert "not a measurement" in header["simulated"]
    assert "twice as bright" in header["approximation"]
    iris = ij.Iris.of_level("low").replace(abl_fraction=0.2)
    expected = ij.reflectance(iris, ij.wavelengths(400, 700, 100), solver=ij.Exact())
    np.testing.assert_allclose(columns["reflectance"], expected.values, rtol=1e-11)


def test_equal_seeds_give_equal_bytes_whatever_the_block(irisjax, monkeypatch):
    arguments = ("spectrum", "--solver", "monte-carlo", "--photons", "3000", *GRID)
    first = irisjax(*arguments, "--seed", "5")[1]
    monkeypatch.setattr(jobs, "_BLOCK", 4 * 700)
    assert irisjax(*arguments, "--seed", "5")[1] == first
    other = irisjax(*arguments, "--seed", "6")[1]
    assert other != first.replace("seed: 5", "seed: 6")


def test_blocks_are_told_and_add():
    asked, told = [], []

    def count(first, last):
        asked.append((first, last))
        n = jnp.full(2, last - first)
        return Counts(fates=n[:, None] * jnp.arange(5), exits=None, photons=n)

    total = jobs.in_blocks(count, 10, 4, told.append)
    assert asked == [(0, 4), (4, 8), (8, 10)]
    assert told == [4, 4, 2]
    assert total.photons.tolist() == [10, 10]
    assert total.fates[1].tolist() == [0, 10, 20, 30, 40]
    assert total.exits is None


SAMPLED = {
    "reflectance": (("spectrum", "--cornea", "round-trip", "--cos-incidence", "0.6"), 0.6),
    "radiance": (("spectrum", "--instrument", "radiance", "--cos-incidence", "0.6"), 0.6),
    "diffuse": (("spectrum", "--cos-incidence", "diffuse"), "diffuse"),
    "brdf": (("brdf", "--angles", "6", "--incidence-deg", "60"), 0.5),
}


@pytest.mark.parametrize("name", SAMPLED)
def test_photons_are_sent_as_the_instrument_sends_them(irisjax, printed, monkeypatch, name):
    """The command counts them outside the instrument's program, the library inside it."""
    arguments, cosine = SAMPLED[name]

    # In place of photons: numbers that depend on all they are told.
    def count(solver, layers, process, cos_incidence, *, cos_exit=None, key=None, rays=None, **_):
        told = layers.extinction + layers.abl_absorption + (0 if rays is None else 1e-3 * rays)
        told = told + (0.1 if isinstance(cos_incidence, str) else cos_incidence)
        told = told + 1e-12 * jax.random.key_data(key).sum()
        share = jax.nn.sigmoid(told)[:, None] * jnp.linspace(0.1, 0.3, 5)
        exits = None if cos_exit is None else share[:, :1] * jnp.asarray(cos_exit)
        whole = [None if x is None else jnp.int32(1e6 * x) for x in (share, exits)]
        return Counts(*whole, photons=jnp.full(told.shape, 1_000_000, jnp.int32))

    monkeypatch.setattr(MonteCarlo, "count", count)
    sampled = ("--solver", "monte-carlo", "--photons", "1000000", "--seed", "3")
    status, out, err = irisjax(*arguments, "--level", "low", *sampled, *GRID)
    assert (status, err) == (0, "")
    header, columns = printed(out)
    options = {"cos_incidence": cosine, "solver": MonteCarlo(1_000_000), "key": jax.random.key(3)}
    iris, grid = ij.Iris.of_level("low"), ij.wavelengths(400, 700, 100)
    if name == "brdf":
        angle, _, azimuth = (np.asarray(a) for a in ij.principal_plane(6))
        options |= {"cos_exit": np.cos(angle), "azimuth": azimuth}
        result, values = ij.brdf(iris, grid, **options), columns["brdf_per_sr"]
        np.testing.assert_allclose(columns["angle_deg"][:6], [75, 45, 15, 15, 45, 75])
        np.testing.assert_allclose(columns["azimuth_deg"][:6], [180, 180, 180, 0, 0, 0])
        assert float(header["cos_incidence"]) == pytest.approx(0.5)
    elif name == "radiance":
        result, values = ij.radiance(iris, grid, **options), columns["radiance"]
    else:
        process = ij.Ilit(cornea="round-trip" if name == "reflectance" else None)
        result = ij.reflectance(iris, grid, process=process, **options)
        values = columns["reflectance"]
    # A count may fall to the other side of a whole number.
    np.testing.assert_allclose(values, result.values.ravel(), rtol=1e-5)
    np.testing.assert_allclose(columns["standard_error"], result.standard_error.ravel(), rtol=1e-5)


def test_wrong_light_is_refused_before_photons_are_sent(irisjax, monkeypatch):
    def count(*_, **__):
        raise AssertionError("photons were sent")

    monkeypatch.setattr(MonteCarlo, "count", count)
    sampled = ("--solver", "monte-carlo", *GRID)
    for wrong in (("--cos-incidence", "diffuse"), ("--illuminant", "moon")):
        status, _, err = irisjax("spectrum", "--instrument", "radiance", *wrong, *sampled)
        assert (status, err.count("\n")) == (2, 1)


def test_brdf_over_the_hemisphere(irisjax, quick, printed):
    status, out, _ = irisjax(
        "brdf", "--plane", "hemisphere", "--angles", "8", "--wavelengths", "450,650"
    )
    assert status == 0
    columns = printed(out).columns
    assert columns["brdf_per_sr"].size == 2 * 4 * 8
    assert columns["angle_deg"].max() < 90
    assert np.unique(columns["azimuth_deg"]).size == 8
    per_angle = columns["brdf_per_sr"][columns["wavelength_nm"] == 450].reshape(4, 8)
    assert (np.diff(per_angle[:, 0]) < 0).all()  # as the stand-in's cosine


def test_every_parameter_and_switch_is_in_the_header(irisjax, quick, printed):
    header = printed(irisjax("spectrum", *GRID)[1]).header
    optional = {"abl_index", "stroma_index"}
    assert set(LIMITS) - optional <= set(header)
    switches = {"process", "phase", "rescatter", "perturb_on_reflection", "scattering", "cornea"}
    assert {"irisjax", *switches} <= set(header)
    assert header["irisjax"] == ij.__version__


def test_colour_and_swatch(irisjax, quick, tmp_path):
    import matplotlib.image

    path = tmp_path / "swatch.png"
    status, out, err = irisjax("colour", "--level", "low", "--swatch", path)
    assert (status, err) == (0, "")
    assert "inside sRGB" in out
    row = next(line for line in out.splitlines() if line.startswith("sRGB 8 bit")).split()
    pixels = np.rint(255 * matplotlib.image.imread(path)[..., :3]).astype(int)
    assert np.unique(pixels.reshape(-1, 3), axis=0).tolist() == [[int(v) for v in row[3:6]]]
    assert row[6] == "#" + "".join(f"{int(v):02x}" for v in row[3:6])


def test_colours_out_of_gamut_are_reported(irisjax, quick, monkeypatch, tmp_path):
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
    assert irisjax(*arguments)[0] == 0
    assert path.read_bytes() == first
