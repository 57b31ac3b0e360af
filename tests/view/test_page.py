"""The viewer's page: what the command refuses, and a browser that follows the sliders."""

import ast
import contextlib
import io
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from irisjax.io.clone_folders import PHOTOGRAPH, encode_photograph
from irisjax.view import Studio, panels, server


def test_says_what_is_missing(monkeypatch, complaint):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'irisjax[view]'" in complaint("--preset", "blue")


@pytest.mark.parametrize(("aspect", "top"), [(0.5, 0), (1.0, 2)], ids=["telephone", "window"])
def test_a_picture_is_above_the_panel_of_a_telephone(aspect, top):
    framed = panels.framed(np.full((12, 16, 3), 255, np.uint8), aspect)
    rows = np.flatnonzero((framed == 255).all((1, 2)))
    assert framed.shape[1] / framed.shape[0] == aspect
    assert (rows[0], rows[-1]) == (top, top + 11)


@pytest.mark.peer
def test_says_that_the_port_is_taken(complaint):
    pytest.importorskip("viser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port {port} of 127.0.0.1" in complaint("--port", str(port))


@pytest.mark.peer
def test_refuses_wrong_scenes(tmp_path, complaint):
    pytest.importorskip("viser")
    assert "violet" in complaint("--preset", "violet")
    (tmp_path / "eye.toml").write_text("[iris]\neumelanine = 1\n")
    assert "line 2" in complaint(str(tmp_path / "eye.toml"))
    assert "not both" in complaint(str(tmp_path / "eye.toml"), "--preset", "blue")


@pytest.mark.peer
def test_refuses_folders_that_are_no_clones(tmp_path, complaint):
    pytest.importorskip("viser")
    assert "no clone.json" in complaint(str(tmp_path))
    _clone(tmp_path, np.zeros((60, 80, 3)))
    assert "in that proportion" in complaint(str(tmp_path), "--size", "40x40")
    _clone(tmp_path, np.zeros((50, 80, 3)))
    assert "must be 80 x 60" in complaint(str(tmp_path))


def test_not_loaded_with_the_package():
    for path in Path(server.__file__).parent.glob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [x.name for x in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.startswith("viser") for name in names), path


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


def _clone(folder, photograph):
    (folder / "clone.json").write_text(json.dumps({"photograph": "", "limbus": {}, "pupil": {}}))
    (folder / "scene.toml").write_text(SCENE)
    (folder / PHOTOGRAPH).write_bytes(encode_photograph(photograph))


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
        # Chromium takes half a gigabyte, which not everyone who runs the tests wants.
        pytest.skip("no Chromium: python -m playwright install --with-deps chromium")


@contextlib.contextmanager
def _viewer(subject):
    """Address of a viewer in a process of its own, which Ctrl-C must end."""
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from irisjax.__main__ import main; main()"
    command = [sys.executable, "-c", code, "view", str(subject), "--port", "0"]
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


@pytest.fixture
def address(tmp_path):
    """Of a viewer of a small scene."""
    (tmp_path / "eye.toml").write_text(SCENE)
    with _viewer(tmp_path / "eye.toml") as found:
        yield found


@pytest.fixture
def served(bare):
    """The page of a viewer that no browser has opened."""
    viser = pytest.importorskip("viser")
    with contextlib.redirect_stdout(io.StringIO()):
        server_of_page = viser.ViserServer(port=0, verbose=False)
    yield server._Page(server_of_page, Studio(bare))
    with contextlib.redirect_stdout(io.StringIO()):
        server_of_page.stop()


@pytest.mark.peer
def test_a_slow_browser_is_put_where_the_scene_looks_from(served):
    """viser's own camera, reported after ours, is no orbit of the user's."""

    class Reported:
        aspect, position, look_at = 1.5, np.full(3, 3.0), np.zeros(3)

        def on_update(self, follow):
            self.follow = follow
            return follow

    camera = Reported()
    scene = SimpleNamespace(set_background_image=lambda *_, **__: None)
    served._connected(SimpleNamespace(camera=camera, scene=scene))
    place = camera.position.copy()
    for reported in (place, np.full(3, 3.0)):
        camera.position = reported
        camera.follow(camera)
        np.testing.assert_allclose(camera.position, place)
    camera.position = place + np.array([0.5, 0.0, 0.0])  # the user's
    camera.follow(camera)
    polar = np.degrees(np.arctan2(0.5, place[2]))
    assert served.worker._waiting["camera_polar"] == pytest.approx(polar, abs=0.01)
    assert served.worker._waiting["camera_azimuth"] == 0.0


@pytest.mark.peer
def test_changes_are_undone(served):
    def work():
        changes, served.worker._waiting = served.worker._waiting, None
        served._show(changes)

    for changes in ({}, {"eumelanin": 0.1}, {"eumelanin": 1.0, "width": 9.0}):
        served.worker.put(**changes)
        work()
    served._undo()
    work()
    settings = served.studio.settings
    assert (settings.eumelanin, settings.width) == (0.1, 15.0)
    assert served.widgets["eumelanin"].value == pytest.approx(-1.0)
    served._undo()
    served._undo()  # there is nothing before the first
    work()
    assert served.studio.settings.eumelanin == 1.0


@pytest.mark.peer
@pytest.mark.parametrize("seconds", [0, 5])
def test_ctrl_c_is_how_it_ends(tmp_path, seconds):
    """While it computes its first picture, too: nothing is said, the status is 0."""
    pytest.importorskip("viser")
    (tmp_path / "eye.toml").write_text(SCENE)
    with _viewer(tmp_path / "eye.toml"):
        time.sleep(seconds)


def _turn(page, x, y):
    """Drag the eye to the left from a point of the page."""
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y, steps=6)
    page.mouse.up()
    page.get_by_text(re.compile(r"camera [1-9]\d*° off axis")).wait_for(timeout=30_000)


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
    slider.press("ArrowLeft", delay=300)  # moves the slider, and not the camera
    assert float(slider.get_attribute("aria-valuenow")) < 1.0
    time.sleep(1.0)
    page.get_by_text("camera 0° off axis").wait_for(timeout=5_000)
    _turn(page, *(box[at] + box[size] / 2 for at, size in (("x", "width"), ("y", "height"))))
    assert errors == []


@pytest.mark.peer
def test_a_clone_beside_its_photograph(browser, tmp_path):
    """Turning the eye hides the photograph; the slider brings it back, and its camera."""
    _clone(tmp_path, np.broadcast_to([0.0, 1.0, 0.0], (60, 80, 3)))
    with _viewer(tmp_path) as address:
        page = browser.new_page(viewport={"width": 1200, "height": 500})
        page.goto(address)
        page.get_by_text("left: photograph; right: simulated").wait_for(timeout=60_000)
        page.get_by_text("picture 80 × 60").wait_for(timeout=60_000)
        box = page.locator("canvas").first.bounding_box()
        x, y = (box[at] + box[size] / 2 for at, size in (("x", "width"), ("y", "height")))

        def green(offset, wanted):
            import imageio.v3

            clip = {"x": x + offset - 5, "y": y - 5, "width": 10, "height": 10}
            deadline = time.monotonic() + 30
            while time.monotonic() < deadline:
                shot = imageio.v3.imread(page.screenshot(clip=clip), extension=".png")
                red, middle, _ = shot[..., :3].mean((0, 1))
                if (middle > red + 100) == wanted:
                    return True
                time.sleep(0.2)
            return False

        assert green(-60, True)
        assert green(60, False)
        slider = page.get_by_role("slider").first
        _turn(page, x, y)
        assert green(-60, False)
        assert float(slider.get_attribute("aria-valuenow")) == 0
        slider.focus()
        slider.press("End")
        page.get_by_text("camera 0° off axis").wait_for(timeout=30_000)
        assert green(60, True)
        page.get_by_text("picture 80 × 60").wait_for(timeout=30_000)
