"""The viewer: a change recomputes what it must and no more, and the page in a browser follows its
sliders.
"""

import contextlib
import dataclasses
import io
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from irisjax import cli
from irisjax.anatomy.eye import Cornea, Eye
from irisjax.grow.presets import PRESETS
from irisjax.io.scenes import parse_scene, stream
from irisjax.measure.colour import srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.compose import render
from irisjax.render.scene import Scene
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.view import Studio, server, studio
from irisjax.view.worker import Newest


def grown(seed=0, eumelanin=1.0):
    """An iris and maps that need no growing."""
    iris = Iris(eumelanin=eumelanin)
    uneven = np.random.default_rng(seed).uniform(0.5, 1.5, (32, 16))
    return iris, IrisMaps(stroma_depth=uneven * iris.stroma_thickness, relief=0.05 * uneven)


@pytest.fixture
def bare():
    """A bare iris in air, small: nothing to tabulate."""
    return Scene(
        *grown(),
        Eye(cornea=None, sclera=None),
        camera=Camera(size=(40, 30)),
        integrator=Separable(degrees=(2, 2, 2, 2, 2)),
    )


@pytest.fixture
def counted(monkeypatch):
    """How often pixels were sorted and stages made."""
    counts = {"look": 0, "prepare": 0}

    def count(name):
        function = getattr(studio, name)

        def called(*arguments, **named):
            counts[name] += 1
            return function(*arguments, **named)

        monkeypatch.setattr(studio, name, called)

    count("look")
    count("prepare")
    return counts


def fresh(found: Studio) -> np.ndarray:
    linear = found.settings.exposure * render(found.scene())
    return np.rint(255 * np.clip(srgb_encode(linear), 0, 1))


def test_a_change_costs_what_it_must(bare, counted):
    found = Studio(bare)
    before = found.update()
    assert before.shape == (30, 40, 3)
    assert before.dtype == np.uint8
    last = {}
    # (pixels sorted, stages made)
    for change, cost in (
        ({"eumelanin": 0.3}, (0, 0)),
        ({"hemoglobin": 0.5, "saturation": 0.9, "abl_fraction": 0.2}, (0, 0)),
        ({"stroma": 1.3}, (0, 0)),
        ({"exposure": 1.5}, (0, 0)),
        ({"light_polar": 50.0}, (0, 1)),
        ({"light_polar": 50.0}, (0, 0)),
        ({"pupil": 5.0}, (0, 1)),
        ({"environment": "studio", "strength": 0.5}, (0, 1)),
        ({"camera_polar": 30.0, "camera_azimuth": 120.0}, (1, 1)),
        ({"width": 9.0}, (1, 1)),
        ({}, (0, 0)),
    ):
        counted.update(look=0, prepare=0)
        after = found.update(**change)
        assert tuple(counted.values()) == cost, change
        assert (after != before).any() == (change != {} and change != last), change
        before, last = after, change
    assert np.abs(after - fresh(found)).max() <= 1


def test_drafts_are_kept_apart(bare, counted):
    found = Studio(bare)
    fine = found.update()
    assert found.update(draft=True).shape == (15, 20, 3)
    np.testing.assert_array_equal(found.update(), fine)
    assert counted == {"look": 2, "prepare": 2}


def test_a_preset_brings_its_pigments(bare, monkeypatch):
    monkeypatch.setitem(PRESETS, "blue", lambda key: grown(int(key == stream(3, "maps")), 0.02))
    found = Studio(bare)
    assert found.presets()[0] == studio.GIVEN
    own = found.settings
    found.update(stroma=1.5)
    found.update(preset="blue", abl_fraction=0.1, seed=3)
    assert found.settings.eumelanin == pytest.approx(0.02)
    assert (found.settings.abl_fraction, found.settings.stroma) == (0.1, 1.0)
    np.testing.assert_array_equal(found.scene().maps.stroma_depth, grown(1)[1].stroma_depth)
    found.update(preset=studio.GIVEN)
    assert found.settings == studio.Settings(**{**vars(own), "seed": 3})


def test_wrong_settings_change_nothing(bare):
    found = Studio(bare)
    before = found.settings
    for wrong in (
        {"melanin": 1.0},
        {"preset": "violet"},
        {"environment": "cave"},
        {"pupil": 20.0},
        {"eumelanin": -1.0},
    ):
        with pytest.raises(ValueError, match=r"no such|unknown|outside|must be"):
            found.update(**wrong)
        assert found.settings == before


def test_starts_as_the_scene_is():
    text = '[iris]\neumelanin = 0.4\n[maps]\nuniform = true\n[eye]\ncornea = "none"\npupil_radius = 1.4\n'
    text += "[camera]\npolar_deg = 20\nazimuth_deg = 30\n[[light]]\npolar_deg = 40\nazimuth_deg = 100\nirradiance = 2\n"
    found = Studio(parse_scene(text).scene()).settings
    assert (found.pupil, found.camera_polar, found.camera_azimuth, found.environment) == (
        2.8,
        20,
        30,
        "none",
    )
    assert (found.light_polar, found.light_azimuth) == pytest.approx((40, 100), abs=1e-3)
    assert (found.irradiance, found.eumelanin) == pytest.approx((2, 0.4))


def test_spectrum_and_colour(bare):
    import irisjax as ij

    values, colour = Studio(bare).spectrum()
    expected = ij.reflectance(bare.iris, studio.GRID)
    np.testing.assert_allclose(values, expected.values, rtol=1e-9)
    assert float(colour.lab[0]) == pytest.approx(float(ij.colour(bare.iris).lab[0]), abs=0.2)


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


def _complaint(*arguments):
    before = jax.config.read("jax_enable_x64")
    out = io.StringIO()
    try:
        with contextlib.redirect_stderr(out):
            status = cli.run(["view", *arguments])
    finally:
        jax.config.update("jax_enable_x64", before)
    assert status == 2
    assert out.getvalue().count("\n") == 1
    return out.getvalue()


def test_says_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'irisjax[view]'" in _complaint("--preset", "blue")


@pytest.mark.peer
def test_says_that_the_port_is_taken():
    pytest.importorskip("viser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port {port} of 127.0.0.1" in _complaint("--port", str(port))


@pytest.mark.peer
def test_refuses_wrong_scenes(tmp_path):
    pytest.importorskip("viser")
    assert "violet" in _complaint("--port", "0", "--preset", "violet")
    (tmp_path / "eye.toml").write_text("[iris]\neumelanine = 1\n")
    assert "line 2" in _complaint("--port", "0", str(tmp_path / "eye.toml"))
    assert "not both" in _complaint("--port", "0", str(tmp_path / "eye.toml"), "--preset", "blue")


def test_not_loaded_with_the_package():
    loaded = "import sys, irisjax, irisjax.view; raise SystemExit('viser' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", loaded]).returncode == 0


SCENE = """
[iris]
level = "low"
[maps]
uniform = true
[eye]
cornea = "none"
[camera]
size = [80, 60]
[[light]]
irradiance = 60
"""


@pytest.fixture
def browser():
    pytest.importorskip("viser")
    sync_api = pytest.importorskip("playwright.sync_api")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as p:
        names = ("chromium", "chromium-browser", "google-chrome", "chrome")
        for path in (None, *filter(None, map(shutil.which, names))):
            try:
                found = p.chromium.launch(executable_path=path, args=flags)
            except sync_api.Error:
                continue
            yield found
            found.close()
            return
        # Of half a gigabyte, which not everyone who runs the tests wants; CI installs it.
        pytest.skip("no Chromium: python -m playwright install --with-deps chromium")


@pytest.fixture
def address(tmp_path):
    """Of a viewer in a process of its own, which Ctrl-C must end."""
    (tmp_path / "eye.toml").write_text(SCENE)
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from irisjax.cli import main; main()"
    command = [sys.executable, "-c", code, "view", str(tmp_path / "eye.toml"), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        yield re.search(r"http://\S+", line)[0]
        process.send_signal(signal.SIGINT)
        rest, complaints = process.communicate(timeout=30)
        assert (process.returncode, rest, complaints) == (0, "", "")
    finally:
        process.kill()
        process.communicate()


def test_presets_in_another_chamber(bare):
    """Of F09's single surface: the iris is in what fills the eye."""
    eye = bare.eye.replace(cornea=Cornea.f09(), aqueous_index=1.376)
    found = Studio(bare.replace(eye=eye), lambda _: None)
    made = found._set(dataclasses.replace(found.settings, preset="blue"), (8, 6))
    assert float(made.eye.aqueous_index) == pytest.approx(1.376)


@pytest.mark.peer
def test_a_slow_browser_is_put_where_the_scene_looks_from(bare):
    """viser's own camera, reported after ours, is no orbit of the user's."""
    viser = pytest.importorskip("viser")

    class Reported:
        aspect, position, look_at = 1.5, np.full(3, 3.0), np.zeros(3)

        def on_update(self, follow):
            self.follow = follow
            return follow

    client = SimpleNamespace(
        camera=Reported(), scene=SimpleNamespace(set_background_image=lambda *_, **__: None)
    )
    with contextlib.redirect_stdout(io.StringIO()):
        served = viser.ViserServer(port=0, verbose=False)
    try:
        page = server._Page(served, Studio(bare))
        page._connected(client)
        place = client.camera.position.copy()
        for reported, kept in (
            (place, place),
            (np.full(3, 3.0), place),
            (place + np.array([0.5, 0.0, 0.0]), None),
        ):
            client.camera.position = reported
            client.camera.follow(client.camera)
            if kept is not None:
                np.testing.assert_allclose(client.camera.position, kept)
        # Only the last was the user's.
        assert page.worker._waiting["camera_polar"] == pytest.approx(
            np.degrees(np.arctan2(0.5, place[2])), abs=0.01
        )
        assert page.worker._waiting["camera_azimuth"] == 0.0
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            served.stop()


@pytest.mark.peer
def test_page(browser, address):
    """A slider moves, the picture changes, nothing complains."""
    page = browser.new_page(viewport={"width": 1200, "height": 500})
    errors = []
    page.on(
        "console", lambda message: errors.append(message.text) if message.type == "error" else None
    )
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.get_by_text("picture 80 × 60").wait_for(timeout=60_000)

    def brightness():
        import imageio.v3

        box = page.locator("canvas").first.bounding_box()
        x, y = (
            box["x"] + box["width"] / 2,
            box["y"] + box["height"] / 2 + box["width"] / 4,
        )  # below the pupil
        middle = {"x": x - 20, "y": y - 10, "width": 40, "height": 20}
        return imageio.v3.imread(page.screenshot(clip=middle), extension=".png")[..., :3].mean()

    def becomes(what, seconds=30):
        deadline = time.monotonic() + seconds
        while not what(value := brightness()) and time.monotonic() < deadline:
            time.sleep(0.2)
        return value

    light = becomes(lambda value: value > 40)
    box = page.locator("canvas").first.bounding_box()
    slider = page.get_by_role("slider").first
    slider.focus()
    slider.press("End")  # all the eumelanin there is
    dark = becomes(lambda value: value < 0.8 * light)
    assert dark < 0.8 * light, (light, dark)
    middle = [box[name] + box[size] / 2 for name, size in (("x", "width"), ("y", "height"))]
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] - 60, middle[1], steps=6)
    page.mouse.up()
    page.get_by_text(re.compile(r"camera [1-9]\d*° off axis")).wait_for(timeout=30_000)
    assert errors == []
