"""The exact solver against reference tables, multiprecision, closed forms and itself at eight times
the size.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expn

import common
import irisjax as ij
from common import GRID, ILIT, PROCESSES, all_irides, layers, quick_jit, reference
from irisjax.optics.fresnel import fresnel_at
from irisjax.transport.process import DEPTH_RESOLVED
from multiprecision import ilit_rayleigh

ROWS = reference("ilit_reflectance.csv")


def mostly_slow(names, fast):
    """The names, with all but `fast` left to `pytest -m slow`."""
    return [n if n in fast else pytest.param(n, marks=pytest.mark.slow) for n in names]


SINGLE = ("lb06", "rayleigh-retest", "depth-resolved")

STANDARD = ij.IlitExact()


@functools.cache
def spectra(process, n_angles=40, bits=64):
    """The nine irides of the table, first surface left out of the values (it is in `.mirrored`)."""
    assert jax.config.jax_enable_x64 == (bits == 64)
    _, irides = all_irides()

    def spectrum(iris):
        return ij.reflectance(
            iris,
            GRID,
            process=process,
            solver=common.exact(process, n_angles),
            first_surface=False,
            throw=False,
        )

    # As users run it where it is the default process; the switches come in dozens.
    jit = jax.jit if process == ij.ILIT_2006 and n_angles == 40 and bits == 64 else quick_jit
    # As NumPy: what is kept outlives a change of precision.
    return jax.tree.map(np.asarray, jit(jax.vmap(spectrum))(irides))


@pytest.mark.parametrize("rescatter", ["to-interface", "retest"])
@pytest.mark.parametrize("phase", ["lb06", "rayleigh"])
@pytest.mark.parametrize("redrawn", [False, True])
def test_reference_table(phase, rescatter, redrawn):
    names, _ = all_irides()
    wanted = {
        (r["level"], float(r["abl_fraction"]), float(r["wavelength_nm"])): float(r["reflectance"])
        for r in ROWS
        if (r["phase"], r["rescatter"], r["perturb_on_reflection"])
        == (phase, rescatter, "1" if redrawn else "0")
    }
    if not wanted:
        pytest.skip("no rows of this variant in the table")
    assert len(wanted) == 279
    found = spectra(ij.Ilit(phase=phase, rescatter=rescatter, perturb_on_reflection=redrawn)).values
    expected = np.array([[wanted[(*name, float(w))] for w in GRID] for name in names])
    # The issue asks for 1e-7 with phase="rayleigh". The file itself is off by up to 1.34e-7 where
    # the ABL is thin: test_multiprecision settles one such point with 25 digits, and this solver is
    # right there.
    np.testing.assert_allclose(found, expected, rtol=1e-6 if phase == "lb06" else 1.5e-7)


@pytest.mark.parametrize(
    ("level", "fraction", "wavelength"),
    [("low", 0.2, 690.0), ("high", 0.8, 400.0), ("low", 0.5, 450.0)],
)
def test_multiprecision(level, fraction, wavelength):
    iris = ij.Iris.of_level(level).replace(abl_fraction=fraction)
    grid = np.array([wavelength])
    depths = iris.layers(ij.extinction(grid))
    expected = ilit_rayleigh(
        float(depths.abl_absorption[0]),
        float(depths.stroma_absorption[0]),
        float(depths.stroma_scattering[0]),
    )
    found = ij.reflectance(iris, grid, process=ij.ILIT_CORRECTED, first_surface=False).values[0]
    assert found == pytest.approx(expected, rel=1e-10)
    if (level, fraction, wavelength) == ("low", 0.2, 690.0):
        row = next(
            r for r in ROWS
            if (r["level"], r["abl_fraction"], r["wavelength_nm"], r["rescatter"], r["phase"], r["perturb_on_reflection"])
            == ("low", "0.2", "690", "to-interface", "rayleigh", "0")
        )  # fmt: skip
        # The file's own error, which the tolerance of test_reference_table allows for.
        assert abs(float(row["reflectance"]) / expected - 1) == pytest.approx(1.35e-7, abs=0.05e-7)


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        *((n, 64) for n in PROCESSES),
        *(pytest.param(n, 32, marks=[] if n in SINGLE else pytest.mark.slow) for n in PROCESSES),
    ],
)
def test_energy(name, bits):
    result = spectra(PROCESSES[name], bits=bits)
    parts = jax.tree.leaves((result.values, result.mirrored, result.absorbed))
    assert all(part.dtype == (np.float64 if bits == 64 else np.float32) for part in parts)
    total = sum(np.asarray(part).astype(np.float64) for part in parts)
    np.testing.assert_allclose(total, 1, rtol=0, atol=1e-12 if bits == 64 else 1e-6)


@pytest.mark.parametrize("name", mostly_slow(PROCESSES, SINGLE))
def test_single_precision(name):
    double = spectra(PROCESSES[name])
    jax.config.update("jax_enable_x64", False)
    try:
        single = spectra(PROCESSES[name], bits=32)
    finally:
        jax.config.update("jax_enable_x64", True)
    for mirrored in (0, 1):
        a, b = (np.asarray(r.values) + mirrored * np.asarray(r.mirrored) for r in (single, double))
        bright = b > 1e-3
        assert bright.mean() > 0.5
        np.testing.assert_allclose(a[bright], b[bright], rtol=2e-5)


@pytest.mark.parametrize(
    "name",
    mostly_slow(
        ("rayleigh", "rayleigh-retest", "rayleigh-redrawn", "retest-redrawn"),
        ("rayleigh", "retest-redrawn"),
    ),
)
def test_default_size_against_eight_times_the_nodes(name):
    fine = 8 * STANDARD.n_angles
    np.testing.assert_allclose(
        spectra(PROCESSES[name]).values, spectra(PROCESSES[name], fine).values, rtol=1e-10
    )


@pytest.mark.parametrize("name", mostly_slow(("lb06", "lb06-retest", "lb06-redrawn"), ("lb06",)))
def test_printed_phase_function_converges(name):
    """Its kernel is singular, which product integration takes in its stride."""
    fine = STANDARD.n_angles + 24
    np.testing.assert_allclose(
        spectra(PROCESSES[name]).values, spectra(PROCESSES[name], fine).values, rtol=1e-10
    )


def test_traced_indices_cost_no_accuracy():
    """An iris all of whose fields are traced gets a rule for every order of media."""
    iris = ij.Iris.of_level("low")

    @quick_jit
    def traced(fields):
        return ij.reflectance(
            ij.Iris(**fields), GRID, process=ij.ILIT_CORRECTED, first_surface=False
        ).values

    fields = {name: jnp.asarray(value) for name, value in iris.parameters().items()}
    concrete = ij.reflectance(iris, GRID, process=ij.ILIT_CORRECTED, first_surface=False).values
    np.testing.assert_allclose(traced(fields), concrete, rtol=1e-9)


# Limits. Depths in optical depth; media are (aqueous, ABL, stroma, IPE).
MATCHED = (1.4, 1.4, 1.4, 1.4)
IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)


X, W = np.polynomial.legendre.leggauss(64)
X, W = (X + 1) / 2, W / 2


def solve(process, abl, absorption, scattering, media=IRIS, cosine=1.0):
    """One program for each process: with the iris's order of media and, in ILIT, with a BRDF."""
    made = layers(abl, absorption, scattering, media)
    made = dataclasses.replace(made, order=layers(abl, absorption, scattering, IRIS).order)
    return common.solve(
        process, made, cosine, exits=None if isinstance(process, ij.RadiativeTransfer) else X
    )


@pytest.mark.parametrize("name", ["lb06", "rayleigh", "lb06-redrawn", "rayleigh-redrawn"])
def test_matched_media_to_interface(name):
    """No interface reflects: into the stroma with 2E₃(τ_A), scattered once, half of it up, out with
    2E₃(τ_A).
    """
    abl, absorption, scattering = (
        np.array([0.0, 0.2, 1.0]),
        np.array([0.1, 0.0, 0.5]),
        np.array([0.3, 1.0, 0.05]),
    )
    r = solve(PROCESSES[name], abl, absorption, scattering, MATCHED)
    through_abl, through_stroma = 2 * expn(3, abl), 2 * expn(3, absorption + scattering)
    events = through_abl * (1 - through_stroma)
    albedo = scattering / (absorption + scattering)
    np.testing.assert_allclose(r.mirrored, 0, atol=1e-16)
    np.testing.assert_allclose(r.reflectance, events * albedo / 2 * through_abl, rtol=1e-10)
    np.testing.assert_allclose(r.absorbed.stroma, events * (1 - albedo), rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(
        r.absorbed.ipe, through_abl * through_stroma + events * albedo / 2, rtol=1e-10
    )
    np.testing.assert_allclose(
        r.absorbed.abl, (1 - through_abl) + events * albedo / 2 * (1 - through_abl), rtol=1e-10
    )


@pytest.mark.parametrize("name", ["lb06-retest", "rayleigh-retest", "retest-redrawn"])
def test_matched_media_retested_without_absorption(name):
    """Nothing absorbs: what enters leaves above or below, and the more the more the stroma
    scatters.
    """
    r = solve(PROCESSES[name], 0.0, 0.0, np.array([0.01, 0.1, 1.0, 10.0]), MATCHED)
    np.testing.assert_allclose(r.reflectance + r.absorbed.ipe, 1, rtol=1e-12)
    assert (np.diff(r.reflectance) > 0).all()
    assert r.reflectance[0] == pytest.approx((1 - 2 * expn(3, 0.01)) / 2, rel=0.05)


@pytest.mark.parametrize("name", ILIT)
def test_opaque_abl(name):
    mirrored = float(fresnel_at(jnp.asarray(1.0), jnp.asarray(IRIS[0]), jnp.asarray(IRIS[1]))[0])
    for depth in (200.0, 1e6):
        r = solve(PROCESSES[name], depth, 0.1, 0.2)
        assert r.reflectance[0] < 1e-80
        assert r.mirrored[0] == pytest.approx(mirrored, rel=1e-13)
        assert r.absorbed.abl[0] == pytest.approx(1 - mirrored, rel=1e-13)


@pytest.mark.parametrize("name", PROCESSES)
def test_grazing_incidence(name):
    r = solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=0.0)
    assert r.mirrored[0] == 1
    assert r.reflectance[0] == 0
    assert r.absorbed.total()[0] == 0


@pytest.mark.parametrize("name", ILIT)
def test_incidence_enters_by_the_first_transmission_only(name):
    cosines = jnp.asarray([1.0, 0.7, 0.2, 0.01])
    made = layers(0.1, 0.1, 0.2, IRIS)
    f, t = fresnel_at(cosines, made.indices.aqueous, made.indices.abl)
    runs = [solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=c) for c in cosines]
    mirrored, r = (np.array([getattr(x, n)[0] for x in runs]) for n in ("mirrored", "reflectance"))
    np.testing.assert_allclose(mirrored, f, rtol=1e-13)
    np.testing.assert_allclose(r / t, np.full(4, r[0] / t[0]), rtol=1e-12)


@pytest.mark.parametrize("name", ["lb06", "depth-resolved"])
def test_diffuse_incidence_is_the_mean_over_the_hemisphere(name):
    x, w = np.polynomial.legendre.leggauss(40)
    x, w = (x + 1) / 2, w / 2
    one = np.array(
        [solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=c).reflectance[0] for c in jnp.asarray(x)]
    )
    diffuse = solve(PROCESSES[name], 0.1, 0.1, 0.2, cosine=ij.DIFFUSE).reflectance[0]
    assert diffuse == pytest.approx(float(np.sum(2 * x * w * one)), rel=1e-6)


@pytest.mark.parametrize("name", ILIT)
def test_brdf_integrates_to_reflectance(name):
    for cosine in (1.0, 0.3):
        r = solve(
            PROCESSES[name], [0.02, 0.3, 1.0], [0.05, 0.0, 1.5], [0.2, 2.5, 0.3], cosine=cosine
        )
        np.testing.assert_allclose(r.brdf @ (2 * np.pi * X * W), r.reflectance, rtol=1e-9)


@pytest.mark.slow  # the same through the public functions
@pytest.mark.parametrize("name", ILIT)
def test_brdf_integrates_to_reflectance_of_an_iris(name):
    iris = ij.Iris.of_level("low")

    @quick_jit
    def both(cosine):
        options = {"cos_incidence": cosine, "process": PROCESSES[name]}
        whole = ij.reflectance(iris, GRID, first_surface=False, **options)
        return ij.brdf(iris, GRID, cos_exit=X, **options).values, whole.values

    for cosine in (1.0, 0.3):
        f, whole = both(cosine)
        np.testing.assert_allclose(f @ (2 * np.pi * X * W), whole, rtol=1e-9)


@pytest.mark.parametrize(
    ("field", "value"), [("n_angles", 3), ("n_angles", 0), ("n_depths", 1), ("n_panels", 0)]
)
def test_bad_solver(field, value):
    with pytest.raises(ValueError, match=rf"^{field} = {value} must be a whole number of at least"):
        ij.RadiativeExact(**{field: value})


def test_status_of_bad_depths():
    for bad in (-0.1, np.nan, np.inf):
        for process in (ij.ILIT_2006, DEPTH_RESOLVED):
            result = solve(process, bad, 0.1, 0.2).status
            assert bool(result == ij.RESULTS.invalid_input)
