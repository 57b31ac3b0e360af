"""Opacity maps of components: what an artist relies on."""

import functools
import re

import jax
import numpy as np
import pytest
from scipy import ndimage

from irisjax.ocularist.components import COMPONENTS, PARAMETER_RANGES, component, scan

PUPIL, SIZE = 0.3, 256
DRAWN = [name for name in COMPONENTS if name != "base"]
STROKES = [name for name in COMPONENTS if COMPONENTS[name].count is not None]


@functools.cache
def drawn(name, size=SIZE, pupil=PUPIL, seed=1, **parameters):
    return component(name, parameters).opacity(size, pupil, key=jax.random.key(seed))


def places(size=SIZE, pupil=PUPIL):
    """Relative radius and angle of texels."""
    x = (2 * np.arange(size) + 1) / size - 1
    radius = np.hypot(x[None], x[:, None])
    return (radius - pupil) / (1 - pupil), np.arctan2(-x[:, None], x[None])


def along(opacity, relative, pupil=PUPIL, count=1024):
    """Values round a circle, from +x towards +y."""
    angle = 2 * np.pi * np.arange(count) / count
    r = pupil + (1 - pupil) * relative
    half = len(opacity) / 2
    at = [half * (1 - r * np.sin(angle)) - 0.5, half * (1 + r * np.cos(angle)) - 0.5]
    return ndimage.map_coordinates(opacity, at, order=1)


@pytest.mark.parametrize("name", COMPONENTS)
@pytest.mark.parametrize("pupil", [0.05, 0.9])
def test_maps_are_opacities_of_the_iris_alone(name, pupil):
    opacity = drawn(name, pupil=pupil)
    assert opacity.dtype == np.float32 and opacity.shape == (SIZE, SIZE)
    assert 0 <= opacity.min() < 0.05 < 0.5 < opacity.max() <= 1
    relative, _ = places(pupil=pupil)
    margin = 4.01 / SIZE / (1 - pupil)
    assert not opacity[(relative > 1 + margin) | (relative < -margin)].any()
    assert name != "base" or opacity[(relative >= 0) & (relative <= 1)].min() == 1


@pytest.mark.parametrize("name", COMPONENTS)
def test_equal_keys_give_equal_bytes_and_others_do_not(name):
    one = drawn(name)
    assert one.tobytes() == drawn.__wrapped__(name).tobytes()
    if name != "base":
        assert np.abs(one - drawn(name, seed=2)).max() > 0.1


@pytest.mark.parametrize("name", DRAWN)
def test_another_size_samples_the_same_painting(name):
    fine, coarse, times = 512, 128, 4
    mean = drawn(name, fine).reshape(coarse, times, coarse, times).mean((1, 3))
    relative, _ = places(coarse)
    # Texels that the iris's edges cut are all clear or painted to their rims.
    within = (relative > 3 / coarse) & (relative < 1 - 3 / coarse)
    own = drawn(name, coarse)[within]
    assert np.sqrt(((own - mean[within]) ** 2).mean()) < 0.05 * own.std()


@pytest.mark.parametrize("name", ["collarette-spokes", "collarette-dots"])
def test_the_collarette_keeps_to_the_inner_half(name):
    relative, _ = places()
    opacity = drawn(name)
    assert opacity[relative > 0.6].max() < 0.01
    assert opacity[(relative > 0.1) & (relative < 0.45)].mean() > 0.03


@pytest.mark.parametrize("name", ["stroma-dots", "stroma-smeared-dots", "stroma-smears"])
def test_stroma_covers_nearly_all_of_the_iris(name):
    """Each of 48 fields of the iris has some paint."""
    relative, angle = places()
    opacity = drawn(name)
    for low in np.linspace(0.1, 0.7, 4):
        ring = (relative > low) & (relative < low + 0.2)
        sectors = np.floor((angle[ring] + np.pi) / (2 * np.pi) * 12)
        most = ndimage.maximum(opacity[ring], sectors, np.arange(12))
        assert np.min(most) > 0.3


def test_sphincter_is_a_ring_close_to_the_pupil():
    relative, _ = places()
    opacity = drawn("sphincter", reach=0.2)
    rings = (0, 0.1), (0.1, 0.2), (0.5, 1)
    inner, outer, rest = (opacity[(relative > a) & (relative < b)].mean() for a, b in rings)
    assert inner > 0.4 > outer > 0.1 and rest < 1e-3


def test_limbus_goes_from_clear_to_opaque():
    relative, _ = places()
    opacity = drawn("limbus", reach=0.2)
    assert opacity[relative < 0.6].max() < 0.01
    assert opacity[(relative > 0.985) & (relative <= 1)].min() > 0.95
    rings = [along(opacity, r).mean() for r in np.linspace(0.7, 0.98, 13)]
    assert (np.diff(rings) > 0).all()
    assert np.diff(rings).max() < 0.3


def test_pupil_is_a_soft_ring_at_its_margin():
    opacity = drawn("pupil", 512, reach=0.1)
    rings = [along(opacity, r).mean() for r in np.linspace(0.0, 0.2, 9)]
    assert rings[0] > 0.99
    assert (np.diff(rings) <= 0).all()
    assert rings[-1] == 0


def test_softer_brushes_leave_softer_edges():
    crisp, soft = (np.diff(drawn("stroma-smears", softness=s), axis=0) for s in (0.004, 0.03))
    assert np.abs(soft).max() < 0.3 * np.abs(crisp).max()


@pytest.mark.parametrize("name", ["stroma-smears", "stroma-smeared-dots", "collarette-spokes"])
def test_smears_run_radially(name):
    opacity = drawn(name, 512)
    polar = np.stack([along(opacity, r) for r in np.linspace(0.1, 0.38, 29)], 1)
    # Steps of 0.0025 outer radii or more round the axis, of 0.007 along the radius.
    round_it, outwards = (np.abs(np.diff(polar, axis=axis)).mean() for axis in (0, 1))
    assert round_it / 0.0025 > 2 * outwards / 0.007


@pytest.mark.parametrize("name", DRAWN)
def test_no_seam_where_the_angle_begins(name):
    """Neighbours across the +x axis differ as they do across the −x axis."""
    pupil_to_root = slice(round(SIZE / 2 * (1 + PUPIL)) + 1, SIZE - 1)
    jumps = np.zeros(2)
    for seed in range(8):
        opacity = drawn(name, seed=seed)
        step = np.abs(opacity[SIZE // 2] - opacity[SIZE // 2 - 1])
        jumps += [step[pupil_to_root].mean(), step[::-1][pupil_to_root].mean()]
    assert jumps[0] < 1.6 * jumps[1]


def strongest_harmonic(values):
    """Its share of the variance round a circle."""
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    return power.max() / power.sum()


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_strokes_are_no_computer_pattern(irregularity):
    """No number of spokes to a turn stands out, even of spokes at even distances."""
    opacity = drawn("collarette-spokes", 512, irregularity=irregularity, count=100)
    painted = np.mean([along(opacity, r) for r in (0.15, 0.2, 0.25)], axis=0)
    computed = np.exp(-0.5 * (np.abs(np.arange(1024) * 100 / 1024 % 1 - 0.5) / 0.15) ** 2)
    assert strongest_harmonic(computed) > 0.8
    assert strongest_harmonic(painted) < 0.2


@pytest.mark.parametrize("name", STROKES)
def test_more_strokes_cover_more_and_none_are_bare(name):
    few, many = (drawn(name, count=n).mean() for n in (60, 400))
    if name.startswith(("stroma", "collarette")):
        assert drawn(name, count=0).max() == 0
        assert many > 2 * few
    else:  # rings, on a wash, whose dabs are the narrower the more there are
        assert 0 < drawn(name, count=0).mean() < min(few, many)


@pytest.mark.parametrize("name", COMPONENTS)
def test_every_limit_can_be_drawn(name):
    ranged = set(COMPONENTS[name].parameters()) & set(PARAMETER_RANGES) - {"inner", "outer"}
    for end in ("low", "high"):
        given = {p: getattr(PARAMETER_RANGES[p], end) for p in ranged}
        assert np.isfinite(drawn(name, 32, **given)).all()


@pytest.mark.parametrize(
    ("name", "given", "line"),
    [
        ("limbus", {"size": 1}, "size = 1 is outside [2, 8192]"),
        ("limbus", {"pupil": float("nan")}, "pupil = nan is outside [0.02, 0.95]"),
        ("stroma", {}, "unknown component 'stroma'; did you mean 'stroma-dots'? known: base, stro"),
        ("limbus", {"widht": 1}, "unknown parameter of limbus 'widht'"),
        ("base", {"width": 0.1}, "unknown parameter of base 'width'; known: none"),
        ("limbus", {"reach": 2.0}, "limbus: reach = 2 is outside [0.01, 1]"),
        ("limbus", {"reach": True}, "limbus: reach = True is not a number"),
        ("stroma-dots", {"count": 2.5}, "stroma-dots: count = 2.5 is not a whole number"),
        ("stroma-dots", {"count": -1}, "stroma-dots: count = -1 is outside [0, 1500]"),
        ("stroma-smears", {"inner": 0.6, "outer": 0.5}, "inner = 0.6 is not below outer = 0.5"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(name, given, line):
    with pytest.raises(ValueError, match=re.escape(line)) as raised:
        drawn(name, **given)
    assert "\n" not in str(raised.value)


def test_scans_are_one_less_their_grey_value():
    """Colours become grey by the weights of ITU-R BT.709; what is not opaque lies on white."""
    grey = np.array([[0, 51], [204, 255]], np.uint8)
    opaque = np.array([[1, 0.8], [0.2, 0]], np.float32)
    same = grey.astype(np.uint16) * 257, 1 - opaque, np.repeat(grey[..., None], 3, 2)
    colours = np.array([[(1, 0, 0, 1), (0, 1, 0, 1)], [(0, 0, 0, 0.25), (1.0, 1, 1, 1)]])
    pairs = [(picture, opaque) for picture in (grey, *same)]
    pairs.append((colours, [[1 - 0.2126, 1 - 0.7152], [0.25, 0]]))
    pairs.append((np.tile([0.0, 0.5], (2, 2, 1)), np.full((2, 2), 0.5)))
    for picture, expected in pairs:
        np.testing.assert_allclose(scan(picture, 2), expected, atol=1e-6)
        assert scan(picture, 2).dtype == np.float32


def test_scans_of_another_size():
    x = (2 * np.arange(300) + 1) / 300 - 1
    picture = 0.5 + 0.4 * np.outer(np.cos(2 * x), np.sin(3 * x))
    for size in (100, 450):
        y = (2 * np.arange(size) + 1) / size - 1
        expected = 0.5 - 0.4 * np.outer(np.cos(2 * y), np.sin(3 * y))
        np.testing.assert_allclose(scan(picture, size), expected, atol=2e-3)
    noise = np.random.default_rng(0).integers(0, 2, (64, 64)).astype(float)
    assert 0 <= scan(noise, 97).min() < scan(noise, 97).max() <= 1


@pytest.mark.parametrize(
    ("picture", "line"),
    [
        (np.zeros((4, 6)), "a scan is 6 × 4 pixels; it must be square"),
        (np.zeros((0, 0)), "a scan is 0 × 0 pixels"),
        (np.zeros((4, 4, 5)), r"a scan has shape \(4, 4, 5\)"),
        (np.full((4, 4), 1.5), r"grey value of a scan = 1.5 is outside \[0, 1\]"),
        (np.zeros((4, 4), int), "a scan of int64 values"),
    ],
)
def test_scans_that_are_none(picture, line):
    with pytest.raises(ValueError, match=line):
        scan(picture, 8)
