"""Reflectance, radiance, BRDF and colour: their values, shapes, checks and transformations."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import all_irides, quick_jit
from experiments.closed_formulas import KubelkaMunk
from irisjax.measure import colour
from irisjax.measure.colour import agx_encode, illuminant_power, srgb_encode

IRIS = ij.Iris.of_level("moderate")
GRID = ij.wavelengths(380, 780, 5)
FEW = ij.IlitExact(12, process=ij.ILIT_CORRECTED)  # compiles soonest of those with a BRDF
CLOSED = KubelkaMunk()  # where the spectrum is not the point


def read(iris):
    """One program for all irides."""
    return ij.reflectance(iris, GRID, solver=FEW)


def test_wavelength_grid():
    grid = ij.wavelengths(400, 700, 10)
    assert grid.tolist() == list(range(400, 701, 10))
    assert set(np.diff(ij.wavelengths(380, 780, 2.5))) == {2.5}
    assert ij.wavelengths(550, 550, 1).tolist() == [550]

    for bad in ((700, 400, 10), (400, 700, 0), (400, 700, -5), (400, 700, 7), (400, np.nan, 5)):
        with pytest.raises(ValueError, match=r"^wavelengths\("):
            ij.wavelengths(*bad)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ([500.0, 500.0], "wavelengths must increase; 500 nm is followed by 500 nm"),
        ([], "wavelengths must be a list of at least one number"),
        ([np.nan], "wavelengths must be finite"),
        ([300.0], "wavelength 300 nm is outside the lutein table"),
    ],
)
def test_bad_wavelengths(grid, message):
    brdf = partial(ij.brdf, cos_exit=1.0)
    for instrument in (ij.reflectance, ij.radiance, brdf, ij.colour):
        with pytest.raises(ValueError, match=message):
            instrument(IRIS, np.array(grid))


def test_bad_cosines():
    for cosine in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match=r"cos_incidence = .* is outside \[0, 1\]"):
            ij.reflectance(IRIS, GRID, cos_incidence=cosine)
        with pytest.raises(ValueError, match=r"cos_exit = .* is outside \[0, 1\]"):
            ij.brdf(IRIS, GRID, cos_exit=cosine)
    with pytest.raises(ValueError, match=r"must be a number in .* or 'diffuse', got 'sideways'"):
        ij.reflectance(IRIS, GRID, cos_incidence="sideways")


def test_result():
    r = read(IRIS)
    np.testing.assert_array_equal(r.wavelengths, GRID)
    assert r.values.shape == GRID.shape
    assert r.standard_error is None
    assert bool(r.status == ij.RESULTS.successful)
    np.testing.assert_allclose(np.asarray(r), r.values)
    index = 1.42 / 3 + 1
    np.testing.assert_allclose(r.mirrored, ((index - 1.336) / (index + 1.336)) ** 2, rtol=1e-9)
    lines = repr(r).splitlines()
    assert lines[0] == "reflectance"
    assert lines[1].split() == ["wavelength_nm", "reflectance"]
    assert lines[2].split() == ["380", f"{float(r.values[0]):.6g}"]
    assert "..." in lines


def test_jit_vmap_and_grad():
    """The derivative in reverse is that of differences."""
    irides = jax.tree.map(np.asarray, all_irides()[1])  # whose parts compile nothing

    def measured(iris):
        found = read(iris)
        return found.values.sum(), found

    reverse = jax.value_and_grad(measured, has_aux=True)
    (_, batch), slope = quick_jit(jax.vmap(reverse))(irides)
    slope = jax.tree.map(np.asarray, slope)
    leaves, structure = jax.tree.flatten(jax.tree.map(lambda x: x[0], irides))
    for i, leaf in enumerate(leaves):
        step = np.where(np.arange(len(leaves)) == i, 1e-6 * leaf, 0.0)
        high, low = (np.sum(read(structure.unflatten(leaves + s))) for s in (step, -step))
        found = jax.tree.leaves(slope)[i][0] * step[i]
        np.testing.assert_allclose(found, (high - low) / 2, rtol=1e-6, atol=1e-13)
    assert repr(batch) == "reflectance, batch of shape (9, 81)"
    for i in (0, 8):
        one = jax.tree.map(lambda x, i=i: x[i], irides)
        np.testing.assert_allclose(np.asarray(batch.values)[i], read(one).values, rtol=1e-12)
    assert (slope.eumelanin < 0).all()
    assert (slope.base_index != 0).all()


def test_radiance_factor():
    """Radiance over a white diffuser's E/π is the reflectance times the cornea's transmittance."""
    lit = ij.radiance(IRIS, GRID, cos_incidence=0.5, illuminant="A", solver=FEW)
    assert lit.unit == "relative/sr"
    through, inside = ij.Media().inward(0.5)
    bare = ij.reflectance(IRIS, GRID, cos_incidence=inside, solver=FEW).values
    factor = np.pi * np.asarray(lit.values) / np.asarray(illuminant_power("A", GRID))
    np.testing.assert_allclose(factor / np.asarray(bare), float(through), rtol=1e-12)
    assert illuminant_power("A", np.array([560.0]))[0] == 1
    with pytest.raises(ValueError, match="unknown illuminant 'Z'"):
        ij.radiance(IRIS, GRID, illuminant="Z")
    with pytest.raises(ValueError, match="from one direction"):
        ij.radiance(IRIS, GRID, cos_incidence="diffuse")


def test_cornea_settings():
    through = float(ij.Media().inward(1.0)[0])
    factor, inside = map(float, ij.Media().inward(0.5))
    for cornea, *expected in (
        *(("none", 1.0, 0.5), ("inward", factor, inside)),
        ("round-trip", factor * through / 1.336**2, inside),
    ):
        found, light = ij.Spectrophotometer(GRID, cornea=cornea, cos_incidence=0.5).incident()
        assert [float(found), float(light.cosine)] == pytest.approx(expected, rel=1e-12)


def test_brdf_shapes():
    angle, cosine, azimuth = ij.principal_plane(9)
    assert angle[4] == 0
    assert (np.asarray(cosine) > 0).all()
    assert float(azimuth[0]) == pytest.approx(np.pi)
    seen = {"azimuth": azimuth, "solver": FEW}
    f = ij.brdf(IRIS, GRID, cos_incidence=0.5, cos_exit=cosine, **seen)
    assert f.values.shape == (81, 9)
    assert repr(f) == "Brdf of shape (81, 9) (wavelengths, exits), 1/sr"
    values = np.asarray(f.values)
    np.testing.assert_allclose(values, values[:, ::-1], rtol=1e-12)
    assert ij.brdf(IRIS, GRID, cos_exit=0.5, **seen).values.shape == (81, 9)
    # ILIT's BRDF is a product of functions of the incidence and of the exit.
    ratio = np.asarray(ij.brdf(IRIS, GRID, cos_exit=cosine, **seen).values) / values
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-12)


def test_colour_against_colour_science():
    import colour as cs

    whole = ij.colour(ij.Iris.of_level("low"), solver=CLOSED)
    for level, illuminant in (("low", "D65"), ("high", "A"), ("moderate", "D50")):
        # colour counts the end points whole, the trapezoidal rule by half: leave them out.
        spectrum = ij.reflectance(ij.Iris.of_level(level), GRID, solver=CLOSED)
        values = np.asarray(spectrum.values) * np.r_[0.0, np.ones(79), 0.0]
        found = ij.colour_of(GRID, values, illuminant=illuminant)
        if illuminant == "D65":
            np.testing.assert_allclose(whole.xyz, found.xyz, rtol=3e-4)
        sd = cs.SpectralDistribution(values, GRID)
        cmfs = cs.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(sd.shape)
        light = cs.SDS_ILLUMINANTS[illuminant].copy().align(sd.shape)
        expected = cs.sd_to_XYZ(sd, cmfs, light, method="Integration") / 100
        np.testing.assert_allclose(found.xyz, expected, rtol=1e-5)
        white = cs.sd_to_XYZ(cs.sd_ones(sd.shape), cmfs, light, method="Integration") / 100
        np.testing.assert_allclose(
            found.lab, cs.XYZ_to_Lab(np.asarray(found.xyz), cs.XYZ_to_xy(white)), atol=2e-3
        )


def test_white_and_grey():
    for illuminant in ("D65", "A", "E"):
        white = ij.colour_of(GRID, np.ones(81), illuminant=illuminant)
        np.testing.assert_allclose(white.srgb, 1, atol=2e-4)
        np.testing.assert_allclose(white.lab, [100, 0, 0], atol=1e-9)
        grey = ij.colour_of(GRID, np.full(81, 0.18), illuminant=illuminant)
        # 18 % grey is L* 49.496, sRGB 0.4613.
        assert grey.lab[0] == pytest.approx(49.496, abs=1e-3)
        np.testing.assert_allclose(grey.srgb, 0.46135, atol=2e-4)
        assert bool(grey.in_gamut)


def test_srgb_transfer_function():
    found = srgb_encode(jnp.asarray([0.0, 0.0031308, 0.5, 1.0, -0.01]))
    np.testing.assert_allclose(found, [0, 0.04045, 0.735357, 1, -0.1292], atol=1e-6)


def test_out_of_gamut_is_reported_not_clipped():
    line = ij.colour_of(GRID, np.where(GRID == 520, 1.0, 0.0))
    assert not bool(line.in_gamut)
    assert np.min(line.srgb_linear) < 0


def test_colour_errors():
    for name in ("cat", "Stockman & Sharpe 2 Degree Cone Fundamentals"):
        with pytest.raises(ValueError, match=f"unknown observer '{name}'"):
            ij.colour(IRIS, observer=name)
    with pytest.raises(ValueError, match="unknown illuminant 'Z'"):
        ij.colour(IRIS, illuminant="Z")
    with pytest.raises(ValueError, match="at least two wavelengths"):
        ij.colour(IRIS, np.array([500.0]))
    for grid, message in (
        ([450.0, 650.0], "wavelengths from 450 to 650 nm make no colour"),
        (np.arange(500.0, 601.0, 5), "it needs all from 420 to 680 nm"),
        ([400.0, 500.0, 600.0, 700.0], "400 nm is followed by 500 nm"),
    ):
        with pytest.raises(ValueError, match=message):
            ij.colour(IRIS, np.asarray(grid))
        with pytest.raises(ValueError, match=message):
            ij.colour_of(np.asarray(grid), np.ones(len(grid)))


def test_lighter_iris_is_lighter_and_bluer():
    def lightness(eumelanin):
        iris = ij.Iris.of_level("low").replace(eumelanin=eumelanin)
        return ij.colour(iris, solver=CLOSED).lab[0]

    low, high = (ij.colour(ij.Iris.of_level(x), solver=CLOSED) for x in ("low", "high"))
    assert low.lab[0] > high.lab[0]
    assert low.lab[2] < 0
    slope = quick_jit(jax.grad(jax.checkpoint(lightness)))(0.12)
    difference = (lightness(0.12 + 1e-5) - lightness(0.12 - 1e-5)) / 2e-5
    assert slope == pytest.approx(float(difference), rel=1e-6)


def test_observers_and_illuminants_are_colour_sciences():
    """They are read from a file of the package: every table against the library's own."""
    import colour as cs

    tables = colour._tables()
    for name, table in tables.items():
        kind, _, of = name.partition(" ")
        theirs = (cs.MSDS_CMFS if kind == "observer" else cs.SDS_ILLUMINANTS)[of]
        np.testing.assert_array_equal(table[0], theirs.wavelengths)
        np.testing.assert_array_equal(table[1:], theirs.values.T.reshape(len(table) - 1, -1))
    assert len(tables) == len(cs.SDS_ILLUMINANTS) + 4
    np.testing.assert_array_equal(colour._BRADFORD, cs.CHROMATIC_ADAPTATION_TRANSFORMS["Bradford"])


def test_light_collected_from_a_cone():
    """A mean of the BRDF over the cone, the same in an inversion."""
    seen = {"cos_incidence": 0.7, "aperture": 0.5}
    read = np.asarray(ij.reflectance(IRIS, GRID, solver=FEW, **seen).values)
    sine2 = (np.arange(9) + 0.5) / 9 * (0.5 / 1.336) ** 2
    cosine = np.sqrt(1 - sine2)  # this process's light is the same all round
    f = ij.brdf(IRIS, GRID, cos_incidence=0.7, cos_exit=cosine, solver=FEW)
    np.testing.assert_allclose(read, np.pi * np.asarray(f.values).mean(1), rtol=5e-4)
    problem = ij.problem(
        ij.spectrum(GRID, read, **seen), base=IRIS, solver=FEW, free=["melanin_load"]
    )
    z = problem.standard({"melanin_load": IRIS.melanin_load})
    predict = jax.jit(lambda x: jax.jvp(lambda y: problem.predict(y)[0], (x,), (jnp.ones(1),)))
    (low, _), (middle, slope), (high, _) = (
        map(np.asarray, predict(z + d)) for d in (-1e-4, 0, 1e-4)
    )
    np.testing.assert_allclose(middle, read, rtol=1e-12)
    np.testing.assert_allclose(slope, (high - low) / 2e-4, rtol=1e-4)


def test_what_has_no_aperture():
    photons, probe = ij.MonteCarlo(10), partial(ij.Spectrophotometer, GRID)
    for call, message in (
        (lambda: ij.Radiometer(GRID, aperture=0.2), "a Radiometer has no aperture"),
        (lambda: probe(aperture=1.2), "aperture = 1.2"),
        (
            lambda: probe(aperture=0.2, cos_incidence="diffuse"),
            "diffuse light and an aperture: by reciprocity",
        ),
        (
            lambda: ij.observe(IRIS, probe(aperture=0.2), photons),
            "an aperture is not for MonteCarlo",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_agx_is_the_published_curve():
    """Against the constants of the MIT-licensed github.com/bWFuanVzYWth/AgX, on greys and colours."""
    grey = 0.18 * 2.0 ** np.array([-12.0, -10.0, -5.0, -0.5, 0.0, 2.0, 6.4, 6.5, 9.0])
    colours = np.concatenate([np.repeat(grey[:, None], 3, 1), [[1.0, 0.2, 0.0], [0.0, 0.1, 4.0]]])
    into = [[0.84240107, 0.07843650, 0.07916243], [0.04240107, 0.87843650, 0.07916243]]
    into = np.array([*into, [0.04240107, 0.07843650, 0.87916243]])
    with np.errstate(divide="ignore"):
        stops = np.log2(colours @ into.T)
    x = np.clip((stops + 12.473931188332413) / 16.5, 0, 1)
    low = x <= 0.6060606060606061
    a, b = np.where(low, 59.507875, 69.86278913545539), np.where(low, 3.0, 3.25)
    v = x - 0.6060606060606061
    shown = 0.5 + 2 * v * (1 + a * np.abs(v) ** b) ** (-1 / b)
    found = np.asarray(agx_encode(colours))
    np.testing.assert_allclose(found, np.clip(shown @ np.linalg.inv(into).T, 0, 1), atol=2e-6)
    assert found[4, 0] == pytest.approx(0.5) and (np.diff(found[:9, 0]) >= 0).all()
