from functools import partial

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import irisjax as ij
from common import GRID, all_irides, reference
from irisjax.infer.parameters import of_iris
from irisjax.tissue.iris import FRACTIONS, LIMITS
from irisjax.tissue.pigments import extinction

H_A, H_S = 0.05675, 0.2855
layers_of = jax.jit(ij.Iris.layers)


def test_levels_are_table_2():
    expected = {
        "abl_fraction": 0.5, "oxyhemoglobin": 0.042, "deoxyhemoglobin": 0.042, "lutein": 1.562e-4,
        "zeaxanthin": 5.968e-5, "abl_thickness": H_A, "stroma_thickness": H_S, "intensification": 2.2,
        "fibril_radius": 30.0, "scattering_scale": 1.0,
    }  # fmt: skip
    levels = {"high": (1.008, 0.2674), "moderate": (0.8138, 0.2054), "low": (0.1201, 0.0194)}
    for level, (eumelanin, pheomelanin) in levels.items():
        found = ij.Iris.of_level(level).parameters()
        wanted = expected | {"eumelanin": eumelanin, "pheomelanin": pheomelanin}
        assert {name: found[name] for name in wanted} == wanted
    with pytest.raises(ValueError, match="level 'blue'; known: high, low, moderate"):
        ij.Iris.of_level("blue")


def test_depths_of_the_reference_tables():
    names, irides = all_irides()
    rows = [
        r for r in reference("ilit_reflectance.csv")
        if (r["rescatter"], r["phase"], r["perturb_on_reflection"]) == ("retest", "rayleigh", "0")
    ]  # fmt: skip
    layers = jax.jit(jax.vmap(ij.Iris.layers, (0, None)))(irides, ij.extinction(GRID))
    for column, found in (
        ("mu_a_abl", layers.abl_absorption / H_A),
        ("mu_a_stroma", layers.stroma_absorption / H_S),
        ("mu_s_stroma", layers.stroma_scattering / H_S),
    ):
        known = {
            (r["level"], float(r["abl_fraction"]), float(r["wavelength_nm"])): float(r[column])
            for r in rows
        }
        expected = [[known[(*name, w)] for w in GRID.tolist()] for name in names]
        # The file prints nine digits.
        np.testing.assert_allclose(found, expected, rtol=6e-9, err_msg=column)


@settings(max_examples=20)
@given(st.floats(0, 1), st.floats(0, 5), st.floats(0, 5), st.floats(0.01, 1), st.floats(0.01, 1))
def test_abl_fraction_is_the_share_of_mass(fraction, eumelanin, pheomelanin, h_a, h_s):
    iris = ij.Iris(
        eumelanin=eumelanin, pheomelanin=pheomelanin, abl_fraction=fraction, abl_thickness=h_a, stroma_thickness=h_s,
        oxyhemoglobin=0.0, deoxyhemoglobin=0.0, lutein=0.0, zeaxanthin=0.0, intensification=1.0,
    )  # fmt: skip
    assert iris.melanin_load == pytest.approx((eumelanin + pheomelanin) * (h_a + h_s), rel=1e-14)
    assert iris.abl_melanin == pytest.approx(fraction * float(iris.melanin_load), rel=1e-14)
    table = ij.extinction(np.array([550.0]))
    mass = float(table.eumelanin[0]) * eumelanin + float(table.pheomelanin[0]) * pheomelanin
    mass, layers = mass * (h_a + h_s), layers_of(iris, table)
    near = partial(pytest.approx, rel=1e-13, abs=1e-300)
    assert layers.abl_absorption[0] == near(fraction * mass)
    assert layers.stroma_absorption[0] == near((1 - fraction) * mass)


F09_FIG_1 = dict(zip(FRACTIONS, (7.56, 5.84, 4.61, 2.11), strict=True))


def test_volume_fractions_absorb_as_f09s_power_laws():
    """6.6e10 λ^−3.33 and 2.9e14 λ^−4.75 mm⁻¹, worked out by `bc` at 450 and 550 nm."""
    eumelanin = np.array([96.459779466, 49.446570979])
    pheomelanin = np.array([72.383329748, 27.904562818])
    none = dict.fromkeys(("oxyhemoglobin", "deoxyhemoglobin", "lutein", "zeaxanthin"), 0.0)
    for intensification in (2.2, 1.0):
        fields = none | F09_FIG_1 | {"intensification": intensification}
        iris = ij.Iris(abl_thickness=0.1).replace(**fields)
        layers = layers_of(iris, ij.extinction(np.array([450.0, 550.0])))
        abl, stroma = layers.abl_absorption / 0.1, layers.stroma_absorption / H_S
        np.testing.assert_allclose(abl, 0.0756 * eumelanin + 0.0584 * pheomelanin, rtol=1e-9)
        np.testing.assert_allclose(stroma, 0.0461 * eumelanin + 0.0211 * pheomelanin, rtol=1e-9)
        assert iris.volume_fractions() == pytest.approx(F09_FIG_1, rel=1e-12)
    assert "absorption = f09" in repr(iris)
    # A mg/ml means about as much by either absorption: a load of one is one of the other.
    tables, laws = (layers_of(ij.Iris(absorption=a), ij.extinction(GRID)) for a in ("lb06", "f09"))
    np.testing.assert_allclose(tables.abl_absorption, laws.abl_absorption, rtol=0.15)


def test_melanin_load_is_settable():
    iris = ij.Iris.of_level("moderate")
    assert iris.melanin_load == pytest.approx((0.8138 + 0.2054) * (H_A + H_S), rel=1e-14)
    changed = iris.replace(melanin_load=0.1)
    assert changed.melanin_load == pytest.approx(0.1, rel=1e-14)
    assert changed.pheomelanin / changed.eumelanin == pytest.approx(0.2054 / 0.8138, rel=1e-14)
    # After the other changes.
    thicker = iris.replace(stroma_thickness=0.5, melanin_load=0.1)
    assert thicker.melanin_load == pytest.approx(0.1, rel=1e-14)
    none = iris.replace(eumelanin=0, pheomelanin=0).replace(melanin_load=0.2)
    assert none.melanin_load == pytest.approx(0.2, rel=1e-14)
    assert none.pheomelanin == 0


def test_melanin_load_and_fraction_inside_jit_and_grad():
    def load(value, fraction):
        iris = ij.Iris.of_level("low").replace(melanin_load=value, abl_fraction=fraction)
        return iris.abl_melanin

    value, slopes = jax.jit(jax.value_and_grad(load, argnums=(0, 1)))(0.3, 0.4)
    assert value == pytest.approx(0.12, rel=1e-13)
    assert [float(s) for s in slopes] == pytest.approx([0.4, 0.3], rel=1e-13)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"eumelanin": -0.1}, r"^eumelanin = -0\.1 mg/ml is outside \[0, 2000\] mg/ml$"),
        ({"eumelanin": np.inf}, r"^eumelanin = inf mg/ml is outside"),
        ({"abl_fraction": 1.2}, r"^abl_fraction = 1\.2 is outside \[0, 1\]$"),
        ({"stroma_thickness": np.nan}, r"^stroma_thickness = nan mm is outside"),
        ({"stroma_index": 3.1}, r"^stroma_index = 3\.1 is outside \[1, 3\]$"),
        ({"collagen_fraction": 0.0}, r"^collagen_fraction = 0 is outside \(0, 1\]$"),
        ({"melanin_load": -1.0}, r"^melanin_load = -1 ug/mm2 is outside \[0, 12000\] ug/mm2$"),
        ({"melanin": 1.0}, r"^unknown parameter 'melanin'.* known: melanin_load, hemoglobin, "),
        ({"eumelanin": "much"}, r"^eumelanin must be a number, got 'much'$"),
        ({"eumelanin": True}, r"^eumelanin must be a number, got True$"),
        ({"eumelanin": 1j}, r"^eumelanin must be a real number"),
        ({"saturation": 1.2}, "saturation = 1.2 is outside"),
        ({"hemoglobin": -0.1}, "hemoglobin = -0.1 mmol/l is outside"),
        ({"hemoglobin": 0.1, "oxyhemoglobin": 0.1}, "both haemoglobins are set by it"),
        ({"abl_eumelanin_percent": 7.56}, "go together; give abl_pheomelanin_percent"),
        (F09_FIG_1 | {"eumelanin": 1.0}, "give no eumelanin"),
        (F09_FIG_1 | {"melanin_load": 1.0}, "give no melanin_load"),
        (F09_FIG_1 | {"absorption": "lb06"}, "give no absorption"),
        (F09_FIG_1 | {"stroma_eumelanin_percent": 101.0}, r"stroma_eumelanin_percent = 101 .*100"),
    ],
)
def test_bad_values_are_named(fields, said):
    with pytest.raises(ValueError, match=said):
        ij.Iris.of_level("low").replace(**fields)


@pytest.mark.parametrize("field", sorted(LIMITS))
def test_every_field_is_checked_and_kept(field):
    limits = LIMITS[field]
    with pytest.raises(ValueError, match=rf"^{field} = "):
        ij.Iris().replace(**{field: limits.low - 0.5})
    inside = 0.25 if limits.high <= 1 else 1.4 if limits.high == 3 else 2.6
    changed = ij.Iris().replace(**{field: inside})
    assert getattr(changed, field) == inside
    others = {n: v for n, v in changed.parameters().items() if n != field}
    assert others == {n: v for n, v in ij.Iris().parameters().items() if n != field}


def test_fields_are_arrays_so_that_values_do_not_retrace():
    assert ij.Iris(eumelanin=1).eumelanin.dtype == np.float64
    traces = []

    @jax.jit
    def f(iris):
        traces.append(1)
        return iris.melanin_load

    f(ij.Iris.of_level("low"))
    f(ij.Iris.of_level("high"))
    f(ij.Iris.of_level("high").replace(eumelanin=0.3, abl_fraction=np.float64(0.1)))
    f(ij.Iris(eumelanin=0.7).replace(stroma_thickness=jax.numpy.asarray(0.3)))
    assert len(traces) == 1


def test_print(bits):
    del bits
    seen, iris = [], ij.Iris.of_level("low")
    batch = jax.tree.map(lambda x: np.stack([x, x]), iris)
    jax.eval_shape(lambda iris: seen.append(repr(iris)), iris)
    for text in (repr(iris), *seen, repr(batch)):
        assert text.startswith("Iris(\n  eumelanin = ")
    assert "  eumelanin = 0.1201 mg/ml\n" in repr(iris)
    assert "  abl_fraction = 0.5\n" in repr(iris)
    assert "Traced" not in repr(iris)


def test_albedo_and_coalbedo_sum_to_one():
    layers = layers_of(ij.Iris.of_level("moderate"), ij.extinction(GRID))
    np.testing.assert_allclose(layers.albedo + layers.coalbedo, 1, rtol=1e-15)
    empty = layers_of(ij.Iris(stroma_thickness=0.0), ij.extinction(GRID))
    np.testing.assert_array_equal(empty.albedo, 0)
    np.testing.assert_array_equal(empty.coalbedo, 1)


def test_pheomelanin_may_be_shared_out_for_itself():
    """Layers of four concentrations  [F09 Section 5.2]."""
    table = extinction(np.array([450.0, 600.0]))
    both = ij.Iris(eumelanin=0.3, pheomelanin=0.2, abl_fraction=0.7)
    same = both.replace(pheomelanin_abl_fraction=0.7)
    found = [layers_of(x, table).abl_absorption for x in (both, same)]
    np.testing.assert_allclose(*found, rtol=1e-14)
    # What each melanin does by itself adds up.
    one = layers_of(both.replace(pheomelanin=0.0), table)
    other = layers_of(both.replace(eumelanin=0.0, abl_fraction=0.1), table)
    none = layers_of(both.replace(eumelanin=0.0, pheomelanin=0.0), table)
    apart = both.replace(pheomelanin_abl_fraction=0.1)
    found = layers_of(apart, table)
    for name in ("abl_absorption", "stroma_absorption"):
        whole, *parts = (getattr(x, name) - getattr(none, name) for x in (found, one, other))
        np.testing.assert_allclose(whole, sum(parts), rtol=1e-12)
    assert float(apart.abl_melanin) == pytest.approx((0.3 * 0.7 + 0.2 * 0.1) * (0.05675 + 0.2855))
    with pytest.raises(ValueError, match="abl_fraction"):
        of_iris(apart)


def test_blood_by_its_amount_and_its_oxygen():
    iris = ij.Iris().replace(hemoglobin=0.1, saturation=0.7)
    assert float(iris.oxyhemoglobin) == pytest.approx(0.07)
    assert float(iris.deoxyhemoglobin) == pytest.approx(0.03)
    assert float(iris.replace(hemoglobin=0.2).saturation) == pytest.approx(0.7)
    assert float(iris.replace(saturation=0.2).hemoglobin) == pytest.approx(0.1)
    without = iris.replace(hemoglobin=0.0)
    assert (float(without.hemoglobin), float(without.saturation)) == (0, 0.5)
