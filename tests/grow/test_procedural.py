import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.grow.noise import noise
from irisjax.grow.presets import preset
from irisjax.grow.procedural import ABL, MELANIN, STROMA, procedural, stroma_profile
from irisjax.tissue.maps import IrisMaps

SHAPE = (128, 48)
KEY = jax.random.key(7)
NOTHING = {"profile": False, "fibres": 0.0, "clouds": 0.0, "collarette": 0.0, "ruff": 0.0}
NOTHING |= {"crypts": 0, "furrows": 0}
EXTRA = {"freckles": 5, "abl": 1.0, "heterochromia": 2.0, "amber": 1.0, "patches": 0.5}


def grown(eye=None, key=KEY, **features):
    return procedural(ij.Iris(), eye, shape=SHAPE, key=key, **features)


@pytest.fixture(scope="module")
def everything():
    return grown(**EXTRA)


def test_every_map_is_there_and_within_what_irides_are(everything):
    maps = everything.present()
    assert set(maps) == set(IrisMaps().__dict__) - {"residual"}
    assert {m.shape for m in maps.values()} == {SHAPE}
    low_high = {
        "relief": (-0.2, 0.2), "abl_depth": (0.004, 0.18), "stroma_depth": (0.02, 1.0),
        "freckles": (0, 1), "eumelanin": (0.05, 20), "pheomelanin": (0.3, 3),
    }  # fmt: skip
    for name, (low, high) in low_high.items():
        assert low <= maps[name].min() < maps[name].max() <= high, name


def usual(name):
    return float(getattr(ij.Iris(), name.replace("depth", "thickness")) if "depth" in name else 1)


@pytest.mark.parametrize("name", ["stroma_depth", "abl_depth", "eumelanin", "pheomelanin"])
def test_area_means_are_those_of_the_iris(everything, name):
    place = np.asarray(ij.Eye().from_axis((np.arange(SHAPE[1]) + 0.5) / SHAPE[1]))
    mean = (np.asarray(getattr(everything, name)) * place).sum() / (SHAPE[0] * place.sum())
    np.testing.assert_allclose(mean, usual(name), rtol=1e-12)


@pytest.mark.parametrize("name", ["stroma_depth", "abl_depth", "eumelanin"])
def test_thick_and_thin_tissue_keeps_its_fibres(everything, name):
    found = np.sort(np.asarray(getattr(everything, name)).ravel())
    low, middle, high = np.ptp(found.reshape(16, -1)[[0, 8, -1]], axis=1)
    assert min(low, high) > 0.2 * middle > 0  # no plateau at the ends of the range


@pytest.mark.parametrize("feature", ["fibres", "clouds", "abl", "patches", "amber"])
def test_features_of_any_strength_stay_in_their_ranges(feature):
    maps = grown(**EXTRA | {feature: 300.0})
    limits = {"stroma_depth": STROMA, "abl_depth": ABL, "eumelanin": MELANIN}
    for name, (low, high) in (limits | {"pheomelanin": MELANIN}).items():
        relative = np.asarray(getattr(maps, name)) / usual(name)
        # Ranges hold to the tolerance with which the area mean is found.
        assert low - 1e-4 < relative.min() < relative.max() < high + 1e-4, name


def test_a_wider_pupil_presses_the_same_tissue_together(everything):
    """Volumes by circles' areas; the rest against what stretched maps would show."""
    narrow, wide = (grown(ij.Eye(pupil_radius=r), **EXTRA) for r in (1.0, 3.4))
    eyes = {1.0: narrow, 1.9: everything, 3.4: wide}
    moved = everything.moved(ij.Eye(), ij.Eye(pupil_radius=3.4))

    def volumes(maps, name, pupil):
        rings = np.pi * np.diff(np.linspace(pupil, 5.5, SHAPE[1] + 1) ** 2)
        return np.asarray(getattr(maps, name)).mean(0) * rings

    for name in ("stroma_depth", "abl_depth"):
        found = [volumes(maps, name, r).sum() for r, maps in eyes.items()]
        np.testing.assert_allclose(found, found[0], rtol=1e-12)
        np.testing.assert_allclose(volumes(moved, name, 3.4), volumes(everything, name, 1.9))
    np.testing.assert_array_equal(moved.eumelanin, everything.eumelanin)

    def seam(maps, pupil):  # mm over which the seam leaves half of the stroma
        whole = grown(ij.Eye(pupil_radius=pupil), **EXTRA | {"ruff": 0.0})
        share = np.asarray(maps.stroma_depth.mean(0) / whole.stroma_depth.mean(0))
        place = np.linspace(0, 5.5 - pupil, 2 * SHAPE[1] + 1)[1::2]
        return np.interp(0.5 * share[-1], share[:8], place[:8])

    widths = [seam(maps, r) for r, maps in eyes.items()]
    assert max(widths) < (4.5 / 2.1) ** 0.5 * min(widths)  # stretched by 4.5 over 2.1 mm
    steps = [np.diff(maps.relief, axis=1)[:, 20:].std() for maps in (narrow, everything, wide)]
    thicker = (5.5**2 - 1.0**2) / (5.5**2 - 3.4**2)
    assert steps[0] < steps[1] and thicker * steps[0] < steps[2]  # folds deepen by more


def test_equal_keys_give_equal_maps_and_others_do_not(everything):
    again, other = (grown(key=jax.random.key(k), **EXTRA) for k in (7, 8))
    for name, m in everything.present().items():
        np.testing.assert_array_equal(m, again.present()[name])
        assert np.abs(np.asarray(m) - other.present()[name]).max() > 0.1 * np.ptp(m), name


def test_no_seam(everything):
    for name, m in everything.present().items():
        jumps = np.abs(m - np.roll(m, 1, axis=0)).mean(1)
        assert jumps[0] < np.quantile(jumps[1:], 0.98) or jumps[0] == 0, name


def test_fibres_run_radially():
    """On the usual grid: on a coarse one clouds vary along the radius as fast as fibres do."""
    maps = procedural(ij.Iris(), key=KEY, **EXTRA)
    m = np.asarray(maps.stroma_depth)[:, maps.stroma_depth.shape[1] // 2 :]
    m = m / m.mean(0)
    assert np.diff(m, axis=0).std() > 2 * np.diff(m, axis=1).std()


def test_fibres_throw_no_specks():
    """Some began and ended within a texel, and threw a black speck on light irides: neighbours
    along the radius differed by 26 µm at most in the mean of these irides, and by 11 µm since.
    """
    bare = {"furrows": 0, "crypts": 0, "clouds": 0.0, "collarette": 0.0, "ruff": 0.0}
    reliefs = (grown(key=jax.random.key(k), **bare).relief for k in range(4))
    steps = [np.abs(np.diff(np.asarray(relief), axis=1)).max() for relief in reliefs]
    assert np.mean(steps) < 0.02


def test_margins_are_thin_at_the_pupil_and_the_root(everything):
    thin = grown(**EXTRA, margins=1.0)
    ratio = np.asarray(thin.stroma_depth.mean(0) / everything.stroma_depth.mean(0))
    pupillary, ciliary, root = ratio[1], ratio[SHAPE[1] // 2], ratio[-1]
    assert pupillary < 0.8 * ciliary and root < 0.8 * ciliary


def test_crypts_open_near_the_collarette_and_loose_fibres_cross():
    closed, open_, loose = (
        grown(crypts=n, looseness=x).stroma_depth for n, x in ((0, 0.0), (50, 0.0), (0, 2.0))
    )
    thinned = np.asarray(open_ < 0.5 * closed).mean(0)
    assert thinned[10:30].mean() > 0.05 > 2 * thinned[40:].mean()
    along = [np.diff(np.log(m), axis=1)[:, 24:].std() for m in (closed, loose)]
    assert along[1] > 1.2 * along[0]


def test_noise_is_periodic():
    turns, radius = jnp.linspace(0, 1, 50), jnp.linspace(0, 1, 50)
    a, b = (noise(jnp.uint32(3), turns + k, radius, (6, 2), 3) for k in (0, 1))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert float(jnp.abs(a).max()) <= 1


def test_profile_passes_through_ultrasound():
    r = (np.array([2.25, 3.5, 5.0]) - 2.0) / 3.5
    whole = stroma_profile(jnp.asarray(r)) + 0.07 + 0.05675
    np.testing.assert_allclose(whole, [0.645, 0.457, 0.372])


@pytest.mark.parametrize(
    ("asked", "present"),
    [
        ({}, set()),
        ({"profile": True, "relief": 0.0}, {"stroma_depth"}),
        ({"furrows": 2}, {"relief"}),
        ({"clouds": 1.0, "relief": 0.0}, {"stroma_depth"}),
        ({"margins": 1.0}, {"stroma_depth"}),
        ({"freckles": 2}, {"freckles"}),
        ({"heterochromia": 1.0}, {"eumelanin"}),
        ({"patches": 1.0}, {"eumelanin"}),
        ({"amber": 1.0}, {"pheomelanin"}),
        ({"ruff": 1.0, "relief": 0.0}, {"stroma_depth"}),
        ({"abl": 1.0}, {"relief", "abl_depth"}),
        ({"crypts": 2, "relief": 0.0}, {"stroma_depth"}),
    ],
)
def test_maps_that_nothing_needs_are_absent(asked, present):
    maps = jax.eval_shape(lambda key: grown(key=key, **NOTHING | asked), KEY)
    assert set(maps.present()) == present


def test_errors():
    known = "unknown eye colour 'red'; known: amber, blue, brown, dark-brown, green, grey, hazel"
    with pytest.raises(ValueError, match=known):
        preset("red", key=KEY)
    with pytest.raises(ValueError, match="crypts = -1 is outside"):
        procedural(ij.Iris(), crypts=-1, key=KEY)
    narrow = r"pupil_radius = 4\.7 mm must be at least 0\.1 mm below iris_radius = 4\.75 mm"
    with pytest.raises(ValueError, match=narrow):
        grown(ij.Eye(pupil_radius=4.7, iris_radius=4.75))
    with pytest.raises(ValueError, match=r"shape \(8, 8\) is below"):
        procedural(ij.Iris(), shape=(8, 8), key=KEY)
    with pytest.raises(ValueError, match=r"^texels = 0 is outside \[2, inf\)$"):
        ij.lids(ij.Eye(), texels=0, key=KEY)
    with pytest.raises(ValueError, match=r"^number of polar angles = 0 is outside \[2, inf\)$"):
        ij.veins(ij.Eye(), shape=(8, 0), key=KEY)


def test_single_precision_sees_the_noise_of_double(float32):
    found = jax.eval_shape(lambda key: grown(key=key), KEY)
    assert found.stroma_depth.dtype == found.relief.dtype == jnp.float32
    turns = jnp.linspace(0, 1, 50)
    fine = noise(jnp.uint32(3), turns, turns, (6, 2), 3)
    assert fine.dtype == jnp.float32
    np.testing.assert_allclose(np.asarray(fine)[[7, 33]], [0.214834, 0.083868], atol=1e-5)
