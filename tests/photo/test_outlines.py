"""Limbus and pupil of simulated photographs, and of pictures that show no eye."""

import contextlib

import numpy as np
import pytest
from scipy import ndimage

from irisjax.photo import outlines
from irisjax.photo.edges import FittedEllipse
from irisjax.photo.outlines import MIN_CONFIDENCE, Boundaries, find_boundaries, refine_pupil
from irisjax.photo.photograph import Ellipse
from photo.simulated import (
    SKIN,
    Simulated,
    as_photograph,
    exposed,
    photographed,
    with_highlight,
    with_lashes,
    with_lids,
    with_noise,
)


def drawn(
    size=(300, 400),
    middle=(200.0, 150.0),
    radius=80.0,
    pupil=0.4,
    ratio=1.0,
    width=0.18,
    margin=0.0,
):
    """An eye as discs with rays in the iris; widths of limbus and pupil margin in radii of each."""
    limbus = Ellipse(middle, (radius, ratio * radius), 0.4)
    inner = Ellipse(middle, (pupil * radius, pupil * ratio * radius), 0.4)
    row, column = np.mgrid[: size[0], : size[1]]
    r = limbus.relative_radius(column, row)
    white = smoothstep((r - 1) / width + 0.5)
    angle = np.arctan2(row - middle[1], column - middle[0])
    iris = 0.15 * (1 + 0.2 * np.cos(40 * angle) * np.cos(9 * r))
    if margin:
        iris = iris * smoothstep((r / pupil - 1) / margin)
    inside = np.clip((r - pupil) * radius + 0.5, 0, 1)
    grey = 0.7 * white + iris * (1 - white) * inside + 0.003
    return Simulated(grey[..., None] * np.array([1.0, 0.95, 0.9]), limbus, inner)


def smoothstep(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def errors(found: Ellipse, true: Ellipse) -> np.ndarray:
    """Of centre and semi-axes, in radii."""
    off = [np.subtract(a, b) for a, b in zip(found[:2], true[:2], strict=True)]
    return np.array([np.hypot(*off[0]), *abs(off[1])]) / np.sqrt(np.prod(true.semi_axes))


def check(eye: Simulated, photo=None, within=0.02, **given):
    """Within a share of the radius, or half a pixel."""
    found = find_boundaries(photo or eye.photograph(), **given)
    for outline, true in zip(found[:2], eye[1:], strict=True):
        assert errors(outline, true).max() < max(within, 0.5 / true.semi_axes[1])
    assert found.limbus_confidence > MIN_CONFIDENCE
    assert found.pupil_confidence > MIN_CONFIDENCE
    return found


def aside() -> Simulated:
    """An eye that looks aside by 30 degrees."""
    return exposed(photographed("green_tilted.jpg", 1 / 4))


def between_lids(scale=1 / 8) -> Simulated:
    """An eye between lids and lashes, seen from ahead, 62 pixels in radius."""
    return photographed("blue_dirty.jpg", scale)


def places(eye: Simulated):
    """Places in radii of the limbus, to the right and down, and the distance from its middle."""
    row, column = np.mgrid[: eye.pixels.shape[0], : eye.pixels.shape[1]]
    (x, y), r = eye.limbus.centre, eye.limbus.mean_radius
    return (column - x) / r, (row - y) / r, np.hypot(column - x, row - y) / r


def unevenly_lit(eye: Simulated) -> Simulated:
    """The white is burnt out on one side, and in shadow on the other."""
    light = np.geomspace(3, 0.15, eye.pixels.shape[1])[None, :, None]
    uneven = eye._replace(pixels=np.clip(eye.pixels * light, 0, 1))
    return with_noise(with_highlight(uneven))


def mirrored_window(eye: Simulated) -> Simulated:
    """Burnt out, over the pupil's rim."""
    u, v, _ = places(eye)
    window = (abs(u) < 0.3) & (v > -0.62) & (v < -0.1)
    return eye._replace(pixels=eye.pixels + 1.5 * window[..., None])


def mirrored_sky(eye: Simulated) -> Simulated:
    """Half as bright as the iris, over the upper half of the pupil but for a dark post."""
    u, v, r = places(eye)
    sky = (r < 0.8) & (abs(u) < 0.55) & (v < 0) & (v > -0.35) & ~((abs(u) < 0.1) & (v > -0.25))
    sky = ndimage.gaussian_filter(sky.astype(float), 0.6)
    return eye._replace(pixels=eye.pixels + sky[..., None] * [0.06, 0.10, 0.17])


def soft_limbus(eye: Simulated) -> Simulated:
    near = np.exp(-(((places(eye)[2] - 1) / 0.08) ** 2))[..., None]
    smooth = ndimage.gaussian_filter(eye.pixels, (3, 3, 0))
    return eye._replace(pixels=eye.pixels * (1 - near) + near * smooth)


def yellow_ring(eye: Simulated) -> Simulated:
    share = ((places(eye)[2] < 0.62)[..., None]) * np.array([1.2, 0.25, -0.65])
    return eye._replace(pixels=eye.pixels * (1 + share))


def ring_lamp(eye: Simulated) -> Simulated:
    """Mirrored in the pupil, whose rim it is not."""
    u, v, _ = places(eye)
    ring = 1.5 * (abs(np.hypot(u - 0.05, v - 0.05) - 0.26) < 0.03)
    return eye._replace(pixels=eye.pixels + ndimage.gaussian_filter(ring, 0.5)[..., None])


def in_a_face(eye: Simulated, size=330) -> Simulated:
    """A brow, and a socket in the shade, of which the eye is a small part."""
    row, column = np.mgrid[:size, :size] - size // 2
    socket = 1 / (1 + np.exp((np.hypot(column / 130, row / 115) - 1) / 0.06))
    face = SKIN * (1 - 0.35 * socket)[..., None]
    brow = (abs(row + 90 - (column / 110) ** 2 * 30) < 12) & (abs(column) < 95)
    face = face * (1 - 0.8 * ndimage.gaussian_filter(brow.astype(float), 3))[..., None]
    rows, columns = eye.pixels.shape[:2]
    top, left = (size - rows) // 2, (size - columns) // 2
    face[top : top + rows, left : left + columns] = eye.pixels
    return Simulated(face, eye.limbus.moved(left, top), eye.pupil.moved(left, top))


EYES = {
    "beside the middle, narrow pupil": lambda: with_noise(drawn(middle=(95.0, 190.0), pupil=0.2)),
    "large, tilted": lambda: with_noise(drawn((150, 200), (100.0, 75.0), 70.0, ratio=0.85)),
    "unevenly lit": lambda: unevenly_lit(aside()),
    "mirrored window": lambda: mirrored_window(between_lids()),
    "mirrored sky": lambda: mirrored_sky(between_lids()),
    "soft limbus, yellow ring": lambda: soft_limbus(yellow_ring(between_lids())),
    "ring lamp": lambda: ring_lamp(photographed("brown_dirty.jpg", 1 / 8)),
    "in a face": lambda: in_a_face(between_lids(1 / 14)),
}


@pytest.mark.parametrize("name", EYES)
def test_outlines_are_found(name):
    check(EYES[name]())


def test_a_grey_picture_has_the_same_outlines():
    eye = with_noise(with_lashes(with_lids(aside(), 0.9, 0.9), upper=0.9))
    photo = eye.photograph()
    grey = np.repeat(photo.pixels.mean(-1, keepdims=True), 3, -1)
    check(eye, photo._replace(pixels=grey, grey=True))


@pytest.mark.parametrize(
    ("radius", "dark"), [(100.0, 0.0), (150.0, 0.1)], ids=["sharp", "dark margin"]
)
def test_the_pupil_ends_where_the_iris_begins(radius, dark):
    """Sharp, or with a margin that rises slowly from black, some pixels wide."""
    eye = drawn((int(2.6 * radius),) * 2, (1.29 * radius, 1.3 * radius), radius, margin=dark)
    for given in (None, eye.pupil):
        found = find_boundaries(eye.photograph(), limbus=eye.limbus, pupil=given)
        assert found.limbus == eye.limbus and found.limbus_confidence == 1
        assert errors(found.pupil, eye.pupil).max() < 0.01
        assert found.pupil_confidence > MIN_CONFIDENCE
        assert found.pupil_margin is not None
        # Blur and a margin narrower than it look alike: within a pixel and a half.
        assert abs(found.pupil_margin - dark) < 1.5 / (0.4 * radius)


@pytest.mark.parametrize("width", [0.02, 0.18])
def test_the_width_of_the_limbus_is_found(width):
    eye = with_noise(drawn((320, 400), (200.0, 160.0), 110.0, width=width))
    found = check(eye, within=0.01, pupil=eye.pupil)
    assert found.pupil == eye.pupil and found.pupil_confidence == 1
    assert found.limbus_width is not None
    # Blur and a rise narrower than it look alike: within two pixels.
    assert abs(found.limbus_width - width) < max(0.1 * width, 2 / 110)


def test_a_pupil_given_by_hand_does_not_make_the_limbus_worse():
    eye = mirrored_sky(between_lids())
    assert check(eye, pupil=eye.pupil).pupil == eye.pupil


def test_an_outline_that_is_not_sure_is_used_and_doubted():
    circle = Ellipse((50.0, 50.0), (20.0, 20.0))
    (said,) = Boundaries(circle, circle, 0.95, 0.7).doubts()
    assert said.startswith("the pupil may be wrong (confidence 0.70)") and "--pupil" in said
    assert not Boundaries(circle, circle, 1.0, 0.4).doubts()  # refused rather than doubted


def test_both_outlines_given_are_kept():
    black, given = np.zeros((50, 60, 3)), (Ellipse((1, 1), (9, 8)), Ellipse((2, 2), (3, 3)))
    found = find_boundaries(as_photograph(black), *given)
    assert found[:2] == given
    assert found[2:6] == (1.0, 1.0, None, None)  # nothing to be seen of a margin


def blobs(width: float) -> np.ndarray:
    field = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(150, 200)), width)
    return np.clip(0.5 + 0.15 * field / field.std(), 0, 1)[..., None] * SKIN / 0.45


DISC = np.where(np.hypot(*np.ogrid[-75:75, -100:100]) < 30, 0.05, 0.8)[..., None] * np.ones(3)
SMALL = drawn((150, 200), (100.0, 75.0), 40.0)


@pytest.mark.parametrize(
    "pixels",
    [
        blobs(8),
        DISC,
        SMALL.pixels[:, :100],
        with_noise(with_lids(SMALL, upper=-1.1, lower=1.1)).pixels,
        np.full((10, 12, 3), 0.5) + np.eye(10, 12)[..., None] * 0.3,
    ],
    ids=["blobs", "disc", "half", "closed", "tiny"],
)
def test_pictures_without_a_whole_eye_get_low_confidence(pixels):
    with contextlib.suppress(ValueError):  # no iris found
        found = find_boundaries(as_photograph(pixels))
        assert found.limbus_confidence < MIN_CONFIDENCE
        assert found.pupil_confidence < MIN_CONFIDENCE


@pytest.mark.parametrize(
    ("level", "known", "message"),
    [
        (0.0, {}, r"^even\.png: no iris found; give --limbus"),
        (1.0, {}, r"^even\.png: no iris found; give --limbus"),
        (
            0.5,
            {"limbus": Ellipse((900, 20), (80, 80))},
            r"middle of the limbus given, \(900, 20\), is outside .* 80 x 60",
        ),
        (
            0.5,
            {"limbus": Ellipse((10, 10), (5000, 20))},
            r"limbus given is too flat .* are 5000 and 20 pixels, .* at least 0\.4 of",
        ),
        (0.5, {"pupil": Ellipse((10, 10), (50, 19))}, r"pupil given is too flat"),
        (
            0.5,
            {"limbus": Ellipse((30, 30), (20, 20)), "pupil": Ellipse((20, 30), (10, 10))},
            r"^even\.png: the pupil given reaches outside the limbus given",
        ),
        (0.5, {"eye": "upper"}, "left, right or a number"),
        (0.5, {"eye": "0"}, "--eye 0: write left, right or a number from 1"),
    ],
)
def test_refusals(level, known, message):
    with pytest.raises(ValueError, match=message):
        find_boundaries(as_photograph(np.full((60, 80, 3), level), "even.png"), **known)


def test_a_pupil_of_eight_millimetres_is_right_or_doubted():
    eye = with_noise(drawn((190, 240), (120.0, 95.0), 66.0, pupil=4.0 / 5.5))
    found = find_boundaries(eye.photograph())
    off = found.pupil.relative_radius(*eye.pupil.points(np.linspace(0, 2 * np.pi, 60)).T) - 1
    assert abs(off).max() < 0.01 or found.pupil_confidence < MIN_CONFIDENCE


def mirrored_horizon(eye: Simulated) -> Simulated:
    """A sky that is mirrored as brightly as the iris covers a little over half of the pupil."""
    _, v, r = places(eye)
    sky = ndimage.gaussian_filter(((r < 0.8) & (v < 0.05) & (v > -0.5)).astype(float), 0.6)
    return eye._replace(pixels=eye.pixels + sky[..., None] * [0.10, 0.16, 0.28])


def test_a_horizon_over_the_pupil_does_not_move_where_the_iris_begins():
    """Beside the sky, whose light both sides of the rim have, the rise is as sharp as elsewhere."""
    eye = mirrored_horizon(between_lids())
    known = FittedEllipse(eye.limbus, 1.0), FittedEllipse(eye.pupil, 1.0)
    found = refine_pupil(eye.photograph(), *known)
    assert errors(found.outline, eye.pupil).max() < 0.02
    assert found.margin is not None and found.margin < 0.02


def test_one_of_several_small_eyes_is_chosen(monkeypatch):
    """Without a choice one of them is found whole."""
    eye = with_noise(drawn(size=(90, 100), middle=(50, 45), radius=32.0))
    photo = as_photograph(np.concatenate([eye.pixels, eye.pixels], 1), "two.png")
    some = find_boundaries(photo)
    assert some.limbus_confidence > MIN_CONFIDENCE
    left = some.limbus.centre[0] - some.limbus.centre[0] % 100
    for found, true in ((some.limbus, eye.limbus), (some.pupil, eye.pupil)):
        assert errors(found.moved(-left, 0), true).max() < max(0.02, 0.5 / true.semi_axes[1])
    find_eyes, eyes = outlines._find_eyes, []

    def find_once(*given, **known):
        eyes.append(eyes[0] if eyes else find_eyes(*given, **known))
        return eyes[0]

    monkeypatch.setattr(outlines, "_find_eyes", find_once)
    found = find_boundaries(photo, eye="right")
    assert found.eyes == 2 and abs(found.limbus.centre[0] - 150) < 2
    with pytest.raises(ValueError, match=r"two\.png: --eye 3, but the picture shows 2"):
        find_boundaries(photo, eye="3")
