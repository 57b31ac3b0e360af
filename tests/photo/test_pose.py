"""Where the camera stood, from outlines that a known camera projects."""

import numpy as np
import pytest
from eyes_in_line import outlines

from irisjax.anatomy.eye import Cornea, Eye
from irisjax.photo import pose
from irisjax.photo.photograph import Ellipse, ellipse_through
from irisjax.photo.pose import find_pose, limbus_spread, tilts_of_people
from irisjax.render.camera import Camera

EYE = Eye()


@pytest.fixture
def round_limbi(monkeypatch):
    """Limbi that are round in the mean, and no preferred tilt: what a camera projects comes back."""
    monkeypatch.setattr(pose, "LIMBUS_FLAT", 0.0)
    monkeypatch.setattr(pose, "_tilt_cost", np.zeros_like)


def camera_at(polar=0.0, azimuth=0.0, distance=300.0):
    return Camera(polar, azimuth, distance, 14.0, (1001, 901))


def _off(azimuth, other):
    return abs(np.angle(np.exp(1j * (azimuth - other))))


@pytest.mark.parametrize("axes", [(40.0, 40.0), (40.0, 39.9), (40.0, 25.0)])
def test_an_ellipse_through_points_is_theirs(axes):
    given = Ellipse((700.0, -20.5), axes, 2.3)
    found = ellipse_through(given.points(np.linspace(0, 6, 25) ** 1.1))
    np.testing.assert_allclose(found.centre, given.centre, atol=1e-9)
    np.testing.assert_allclose(found.semi_axes, given.semi_axes, rtol=1e-9)
    np.testing.assert_allclose(found.flattening, given.flattening, atol=1e-9)


@pytest.mark.parametrize(("polar", "azimuth"), [(0.1, -2.0), (0.5236, 0.35)])
def test_tilt_side_and_pupil_come_back(polar, azimuth, round_limbi):
    """From a part of a photograph, which the camera's picture is."""
    aside, seen = np.array([310.25, -17.5]), Eye(pupil_radius=2.3)
    moved = [e.moved(*aside) for e in outlines(seen, camera_at(polar, azimuth))]
    found = find_pose(*moved, EYE)
    assert found.tilt == pytest.approx(polar, abs=1e-3)
    assert _off(float(found.camera.azimuth), azimuth) < 2e-3 / polar
    assert float(found.eye.pupil_radius) == pytest.approx(2.3, abs=1e-3)
    np.testing.assert_allclose(found.pupil_centre, 0, atol=2e-3)
    assert (found.side, found.distance) == ("pupil", None)
    for own, given in zip(outlines(found.eye, found.camera), moved, strict=True):
        back = np.array(own.centre) + found.corner
        np.testing.assert_allclose(back, given.centre, atol=0.6)  # to whole pixels
        np.testing.assert_allclose(own.semi_axes, given.semi_axes, rtol=2e-3)


def test_distance_from_the_focal_length(round_limbi):
    eye, distance = Eye(pupil_radius=1.5), 120.0
    shown = outlines(eye, camera_at(distance=distance))
    found = find_pose(*shown, EYE, focal_px=1001 / 14.0 * distance)
    assert eye.cornea is not None
    to_limbus = 3.6 - float(eye.cornea.anterior.sagitta(eye.limbus_radius))
    assert found.tilt < 1e-3 < found.tilt_sd  # a cosine says little about small tilts
    assert found.distance == pytest.approx(distance - to_limbus, rel=1e-4)
    assert float(found.camera.distance) == pytest.approx(distance, rel=1e-4)
    assert float(found.eye.pupil_radius) == pytest.approx(1.5, abs=1e-3)


def test_other_media_make_another_pupil(round_limbi):
    filled = Eye(cornea=Cornea(index=1.376), aqueous_index=1.376, pupil_radius=2.0)
    shown = outlines(filled, camera_at(0.4, 0.2))
    own, other = (find_pose(*shown, eye).eye.pupil_radius for eye in (filled, EYE))
    assert float(own) == pytest.approx(2.0, abs=1e-3)
    assert abs(float(other) - 2.0) > 0.02


def test_a_known_side_is_believed(round_limbi):
    """A pupil off the middle of its iris would tell the wrong side."""
    limbus, pupil = outlines(EYE, camera_at(0.15))
    wrong = pupil._replace(centre=(2 * limbus.centre[0] - pupil.centre[0], pupil.centre[1]))
    told = find_pose(limbus, wrong, EYE)
    given = find_pose(limbus, wrong, EYE, azimuth=0.2)
    assert _off(float(told.camera.azimuth), np.pi) < 0.1
    assert _off(float(given.camera.azimuth), 0.0) < 0.02
    assert given.side == "given"
    assert given.tilt == pytest.approx(0.15, abs=1e-3)


def _flattened(outline, by):
    """With the flattening, a complex number of twice the angle, changed."""
    flattening = complex(*outline.flattening) + by
    size, half = np.sqrt(np.prod(outline.semi_axes)), abs(flattening) / 2
    axes = size * np.exp(half), size * np.exp(-half)
    return outline._replace(semi_axes=axes, angle=float(np.angle(flattening) / 2))


@pytest.mark.parametrize(("degrees", "within"), [(0.0, 3.5), (12.0, 2.5)])
def test_a_limbus_half_hidden_by_lids_tells_the_tilt_with_its_pupil(degrees, within, round_limbi):
    """Lids leave the flattening open by 0.003: 4.4 degrees of a frontal eye, by Eq. 1 alone."""
    limbus, pupil = outlines(EYE, camera_at(np.radians(degrees)))
    seen = _flattened(limbus, 0.003j)
    assert np.degrees(np.arccos(seen.semi_axes[1] / seen.semi_axes[0])) > 4
    found = find_pose(seen, pupil, EYE)
    axis = found.tilt * np.exp(1j * float(found.camera.azimuth))
    assert np.degrees(abs(axis - np.radians(degrees))) < within


@pytest.mark.parametrize(
    ("pupil", "settings", "message"),
    [
        (Ellipse((500, 450), (3, 3)), {}, "no camera was found in 60 steps"),
        (Ellipse((500, 450), (370, 370)), {}, r"pupil's radius 4\.75 mm; it must be within 0\.25"),
        (Ellipse((900, 450), (100, 100)), {}, "the pupil's outline is not within the iris"),
        (Ellipse((500, 450), (150, 150)), {"focal_px": 100.0}, "the focal length puts the camera"),
    ],
)
def test_outlines_of_no_eye(pupil, settings, message):
    with pytest.raises(ValueError, match=message):
        find_pose(Ellipse((500, 450), (400, 400)), pupil, EYE, **settings)


def test_limbus_sizes_of_people():
    radii = np.concatenate([[r] * n for r, n in pose.LIMBUS_RADII])
    assert len(radii) == 461
    assert (radii.min(), radii.max()) == (5.3, 6.5)
    assert limbus_spread() == pytest.approx((radii.mean(), radii.std()))


def _measured(limbus, pupil):
    return find_pose(limbus, pupil, EYE, flattening_sd=(0.005, 0.005))


def _stretched(outline, by):
    return outline._replace(semi_axes=(by * outline.mean_radius, outline.mean_radius), angle=0.0)


def test_a_limbus_flat_as_people_have_it_is_not_tilted():
    """3 % wider than high, with a round pupil a little above its middle."""
    limbus, pupil = outlines(EYE, camera_at())
    found = _measured(_stretched(limbus, 1.03), pupil)
    low, high = np.degrees(found.tilt_interval)
    assert np.degrees(found.tilt) < 5 and low == 0 and 8 < high < 20
    assert found.stretched < 0.1


def test_a_nearly_frontal_pose_is_found():
    """The fit bounced at a kink straight ahead until its steps were spent."""
    limbus = Ellipse((319.131, 318.191), (253.165, 251.850), 0.4417)
    pupil = Ellipse((319.609, 319.518), (93.543, 91.430), 1.4457)
    found = find_pose(limbus, pupil, EYE, flattening_sd=(0.00317, 0.00658))
    assert np.degrees(found.tilt) < 2
    assert found.pupil_radius == pytest.approx(1.80, abs=0.01)


def test_a_stretched_file_is_not_a_tilted_eye_for_sure():
    """By a sixth: limbus and pupil are equally flat, and the pupil is in the middle."""
    found = _measured(*(_stretched(e, 1.16) for e in outlines(EYE, camera_at())))
    assert found.stretched > 0.5
    assert found.tilt_interval[0] == 0


@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_intervals_hold_the_tilt_of_peoples_eyes(degrees):
    """19 of 20, of eyes oval and pupils decentred as people's are."""
    random = np.random.default_rng(int(degrees))
    held, number = 0, 40
    for _ in range(number):
        side = random.uniform(0, 2 * np.pi)
        turned = -np.log(np.cos(np.radians(degrees))) * np.exp(2j * (side + np.pi / 2))
        of_limbus, of_pupil = (
            complex(*random.normal(0, sd, 2)) for sd in (pose.LIMBUS_OVAL, pose.PUPIL_OVAL)
        )
        circle = Ellipse((300.0, 300.0), (100.0, 100.0))
        limbus = _flattened(circle, turned + pose.LIMBUS_FLAT + of_limbus)
        aside = complex(*random.normal(0, pose.DECENTRED / 5.9, 2)) + 0.2j / 5.9
        aside += pose.PUPIL_SHIFT * np.sin(np.radians(degrees)) * np.exp(1j * side)
        pupil = _flattened(circle.scaled(0.4), turned / pose.FLATTENING_RATIO + of_pupil)
        pupil = pupil._replace(centre=(300 + 100 * aside.real, 300 - 100 * aside.imag))
        spread = np.array([pose.LIMBUS_OVAL, pose.PUPIL_OVAL])
        _, (low, high), _ = tilts_of_people(limbus, pupil, spread)
        held += np.degrees(low) <= degrees <= np.degrees(high)
    assert held >= 0.9 * number
