"""The viewer's studio: a change recomputes what it must and no more."""

import threading
import time

import jax
import numpy as np
import pytest
from small import grown

import irisjax as ij
from common import counting
from irisjax.anatomy.eye import Cornea
from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import parse_scene, stream
from irisjax.measure.colour import colour_of, srgb_encode
from irisjax.render.picture import draw
from irisjax.view import Studio, panels, session, studio
from irisjax.view.server import Newest


@pytest.fixture
def counted(monkeypatch):
    """How often each function of a picture was computed."""
    return counting(
        monkeypatch,
        **dict.fromkeys(("trace_shares", "texture", "light_on_iris", "respond"), session),
    )


def fresh(found: Studio) -> np.ndarray:
    linear = found.settings.exposure * draw(found.scene())
    return np.rint(255 * np.clip(srgb_encode(linear), 0, 1))


@pytest.mark.peer
def test_a_change_costs_what_it_must(bare, counted):
    found = Studio(bare)
    before = found.update()
    assert before.shape == (12, 16, 3)
    assert before.dtype == np.uint8
    last = {}
    for change, cost in (
        ({"eumelanin": 0.3}, (0, 0, 0, 1)),
        ({"hemoglobin": 0.5, "saturation": 0.9, "abl_fraction": 0.2}, (0, 0, 0, 1)),
        ({"stroma": 1.3}, (0, 0, 0, 1)),
        ({"exposure": 1.5}, (0, 0, 0, 0)),
        ({"light_polar": 50.0}, (0, 0, 1, 0)),
        ({"light_polar": 50.0}, (0, 0, 0, 0)),
        ({"pupil_radius": 2.5}, (0, 1, 1, 0)),
        ({"environment": "studio", "strength": 0.5}, (0, 1, 1, 0)),
        ({"camera_polar": 30.0, "camera_azimuth": 120.0}, (1, 1, 1, 0)),
        ({"width": 9.0}, (1, 1, 1, 0)),
        ({}, (0, 0, 0, 0)),
    ):
        counted.update(dict.fromkeys(counted, 0))
        after = found.update(**change)
        assert tuple(counted.values()) == cost, change
        assert (after != before).any() == (change != {} and change != last), change
        assert np.abs(after - fresh(found)).max() <= 1, change
        before, last = after, change


@pytest.mark.peer
def test_drafts_are_kept_apart(bare, counted):
    found = Studio(bare)
    fine = found.update()
    assert found.update(draft=True).shape == (3, 4, 3)
    np.testing.assert_array_equal(found.update(), fine)
    assert counted == {"trace_shares": 1, "texture": 2, "light_on_iris": 2, "respond": 1}


def test_shares_of_the_pixels_show_the_same(bare, monkeypatch):
    """Pictures are those of one share: the first, one by a camera that has moved, and one of other
    pigments on what is kept of its view.
    """
    changes = {}, {"camera_polar": 30.0}, {"eumelanin": 0.3}
    whole, shared = Studio(bare), Studio(bare)
    expected = [whole.update(**change) for change in changes]
    monkeypatch.setattr("irisjax.numerics.chunks._FEW", 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(2), raising=False)
    counts = counting(monkeypatch, iris_part=session)
    for change, picture in zip(changes, expected, strict=True):
        np.testing.assert_array_equal(shared.update(**change), picture)
    assert counts["iris_part"] == 2 * len(changes)


def test_a_preset_brings_its_pigments(bare, monkeypatch):
    """It is grown for the scene's eye: behind F09's cornea the iris is in what fills the eye."""
    chambers = []

    def preset(eye, process, key):
        chambers.append(float(eye.aqueous_index))
        return grown(int(key == stream(3, "maps")), 0.02)

    monkeypatch.setitem(PRESETS, "blue", preset)
    monkeypatch.setattr(Studio, "_drawn", lambda self, *given: (np.zeros((1, 1, 3)), None))
    found = Studio(bare.replace(eye=bare.eye.replace(cornea=Cornea.f09(), aqueous_index=1.376)))
    assert found.presets()[0] == studio.GIVEN
    own = found.settings
    found.update(stroma=1.5)
    found.update(preset="blue", abl_fraction=0.1, seed=3)
    assert chambers == [pytest.approx(1.376)]
    assert found.settings.eumelanin == pytest.approx(0.02)
    assert (found.settings.abl_fraction, found.settings.stroma) == (0.1, 1.0)
    np.testing.assert_array_equal(found.scene().maps.stroma_depth, grown(1)[1].stroma_depth)
    found.update(preset=studio.GIVEN)
    assert found.settings == studio.Settings(**{**vars(own), "seed": 3})


def test_wrong_settings_change_nothing(bare):
    found = Studio(bare)
    before = found.settings
    for wrong, said in (
        ({"melanin": 1.0}, "no such"),
        ({"preset": "violet"}, "unknown"),
        ({"environment": "cave"}, "unknown"),
        ({"pupil_radius": 10.0}, "outside"),
        ({"eumelanin": -1.0}, "outside"),
    ):
        with pytest.raises(ValueError, match=said):
            found.update(**wrong)
        assert found.settings == before


def test_starts_as_the_scene_is():
    text = '[iris]\neumelanin = 0.4\n[maps]\nuniform = true\n[eye]\ncornea = "none"\npupil_radius = 1.4\n'
    text += "[camera]\npolar_deg = 20\nazimuth_deg = 30\n[[light]]\npolar_deg = 40\nazimuth_deg = 100\nirradiance = 2\n"
    found = Studio(parse_scene(text).scene()).settings
    assert (found.pupil_radius, found.environment) == (1.4, "none")
    assert (found.camera_polar, found.camera_azimuth) == (20, 30)
    assert (found.light_polar, found.light_azimuth) == pytest.approx((40, 100), abs=1e-3)
    assert (found.irradiance, found.eumelanin) == pytest.approx((2, 0.4))


def test_spectrum_and_colour(bare):
    values, colour = Studio(bare).spectrum()
    expected = ij.reflectance(bare.iris, studio.SPECTRUM_NM)
    np.testing.assert_allclose(values, expected.values, rtol=1e-9)
    np.testing.assert_allclose(colour.lab, colour_of(studio.SPECTRUM_NM, values).lab)


def test_only_the_newest_is_computed():
    seen, busy, go = [], threading.Event(), threading.Event()

    def work(changes):
        seen.append(changes)
        busy.set()
        go.wait(10)

    worker = Newest(work)
    worker.start()
    worker.put(a=1)
    assert busy.wait(10)
    for a in range(2, 9):
        worker.put(a=a)
    worker.put(b=1)
    assert not worker.quiet(10)
    go.set()
    deadline = time.monotonic() + 10
    while len(seen) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    worker.stop()
    worker.join(10)
    assert seen == [{"a": 1}, {"a": 8, "b": 1}]


_LAMP = """
[iris]
level = "low"
[maps]
uniform = true
[eye]
cornea = "f09"
sclera = false
[camera]
size = [16, 12]
[environment]
kind = "sky"
strength = 0.5
[[light]]
position = [30, 40, -120]
colour = [1.0, 0.9, 0.8]
"""


@pytest.mark.parametrize(
    "changes",
    [
        {"eumelanin": 0.3, "stroma": 1.5, "hemoglobin": 0.2, "exposure": 1.5},
        {"light_polar": 20.0, "irradiance": 2.0, "strength": 1.5, "pupil_radius": 2.5},
        {"environment": "none", "camera_polar": 30.0, "camera_azimuth": 120.0, "width": 9.0},
        {"environment": "studio", "irradiance": 0.0, "integrator": "radiative-transfer"},
    ],
)
def test_settings_as_a_scene_file(changes):
    """The file that the page saves is read as the scene that it shows."""
    file = parse_scene(_LAMP)
    found = Studio(file.scene(), file=file)
    found.settings = found._changed(changes)
    again = parse_scene(found.scene_text())
    assert again.exposure == pytest.approx(found.settings.exposure)
    scenes = [found.scene(), again.scene()]
    if "environment" in changes:  # pictures of it are coarser on the page
        names = ["none", *(s.get("kind") for s in [again.sections.get("environment")] if s)]
        assert names[-1] == changes["environment"]
        scenes = [scene.replace(environment=None) for scene in scenes]
    shown, read = map(jax.tree.leaves, scenes)
    assert len(shown) == len(read)
    for value, other in zip(shown, read, strict=True):
        np.testing.assert_allclose(value, other, rtol=2e-6, atol=2e-6)


def test_presets_as_a_scene_file(bare, monkeypatch):
    monkeypatch.setattr(studio, "PRESETS", {"brown": lambda eye, process, key: grown()})
    found = Studio(bare, file=parse_scene(_LAMP))
    found.settings = found._changed({"preset": "brown", "seed": 3})
    sections = parse_scene(found.scene_text()).sections
    assert sections["iris"]["preset"] == "brown"
    assert sections["iris"]["eumelanin"] == pytest.approx(found.settings.eumelanin)
    assert sections["maps"] == {"seed": 3}


def test_sliders_of_melanin_are_logarithmic():
    assert panels.meant("eumelanin", panels.shown("eumelanin", 0.37)) == pytest.approx(0.37)
    assert panels.meant("eumelanin", panels.shown("eumelanin", 0.0)) == 0.0
    assert panels.shown("stroma", 1.3) == panels.meant("stroma", 1.3) == 1.3
