"""The slider that wipes between a photograph and its rendering."""

import numpy as np
import pytest

from irisjax.render.camera import Camera
from irisjax.view import Studio
from irisjax.view.studio import resized, wiped


def flat(value, rows=6, columns=10):
    return np.full((rows, columns, 3), value, np.uint8)


def test_photograph_left_of_the_line_rendering_right_of_it():
    """At the ends of the slider one alone; both are left as they were."""
    photograph, rendered = flat(10), flat(200)
    assert (wiped(photograph, rendered, 0.4)[0, :, 0] == [10] * 3 + [255] + [200] * 6).all()
    for share, value in ((0.0, 200), (1.0, 10)):
        np.testing.assert_array_equal(wiped(photograph, rendered, share), flat(value))
    assert (photograph == 10).all() and (rendered == 200).all()


def test_refuses_what_cannot_be_compared():
    with pytest.raises(ValueError, match="photograph has 10 x 6 pixels, the rendering 10 x 5"):
        wiped(flat(10), flat(200, rows=5), 0.5)
    with pytest.raises(ValueError, match=r"photograph = 1.5 of the width is outside \[0, 1\]"):
        wiped(flat(10), flat(200), 1.5)


def test_a_pixel_of_the_smaller_picture_is_the_mean_of_what_it_covers():
    fine = np.random.default_rng(0).integers(0, 256, (6, 10, 3), np.uint8)
    means = fine.reshape(3, 2, 5, 2, 3).mean((1, 3))
    # Columns and rows are averaged one after the other, either time to the nearest level.
    assert np.abs(resized(fine, (5, 3)) - means).max() <= 1
    assert resized(fine, (10, 6)) is fine
    assert resized(flat(7, 7, 11), (5, 3)).shape == (3, 5, 3)
    with pytest.raises(ValueError, match="in that proportion"):
        resized(fine, (10, 9))


@pytest.fixture
def still(bare, monkeypatch):
    """A studio with a photograph, and how often it drew; drawing itself is left out."""
    drawn = []

    def rendered(self, kept, settings, draft):
        drawn.append((settings, draft))
        width, height = self._size(draft)
        return flat(200, height, width), 0.0

    monkeypatch.setattr(Studio, "_drawn", rendered)
    scene = bare.replace(camera=Camera(size=(40, 30)))
    return Studio(scene, photograph=flat(10, 30, 40)), drawn


def test_a_wipe_draws_nothing(still):
    found, drawn = still
    first = found.update()
    assert found.settings.photograph == 0.5
    assert (first[0, 0, 0], first[0, -1, 0]) == (10, 200)
    for share in (0.1, 0.9, 0.0, 1.0):
        shown = found.update(photograph=share)
        assert (shown[..., 0] == 10).sum() == pytest.approx(1200 * share, abs=30)
    assert len(drawn) == 1
    found.update(eumelanin=2.0)
    assert len(drawn) == 2
    assert (found.update()[..., 0] == 10).all()
    assert found.update(draft=True).shape == (7, 10, 3)


def test_another_camera_hides_the_photograph(still):
    found, _ = still
    for camera in ({"camera_polar": 20.0}, {"camera_azimuth": 9.0}, {"width": 9.0}):
        own = found.photographed
        found.update(photograph=0.7)
        assert (found.update(**camera) == 200).all()
        assert found.settings.photograph == 0
        assert (found.update(photograph=0.7) == 200).all()
        assert (found.update(photograph=1.0, **own) == 10).all()


def test_without_a_photograph_there_is_no_such_setting(bare):
    found = Studio(bare)
    assert found.settings.photograph is None
    with pytest.raises(ValueError, match="no photograph"):
        found.update(photograph=0.5)
    assert found.settings.photograph is None
