"""The viewer's page, by viser: the eye in the viewport, sliders to the right, spectrum and colour
to the left.
"""

import contextlib
import importlib.util
import io
import math
import socket
import threading
import time
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.view.bench import Bench
from irisjax.view.panels import (
    BLACK,
    ORBIT,
    CoatsPanel,
    TissuePanel,
    framed,
    meant,
    orbit,
    shown,
    sliders,
)
from irisjax.view.session import QUICK
from irisjax.view.studio import Studio

if TYPE_CHECKING:
    import viser

_VISERS = np.full(3, 3.0)  # where it puts its camera by itself
_REST = 0.25  # s without a change before the fine picture replaces the draft
_PATIENCE = 0.3  # s that other pigments may take without a draft
_MOST_STEPS = 100  # that can be undone
_SCENE = "scene.toml"
# viser turns its camera by every arrow key on the page; one that moves a slider is not passed on.
_KEEP_ARROWS = (
    """<img src="data:," style="display:none" onerror="document.body.addEventListener('keydown', """
    """event => event.target.closest('[role=slider]') && event.stopPropagation())">"""
)


def serve(
    studio: Studio | Bench,
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    ready: Callable[[str], None] = lambda address: None,
) -> None:
    """Serve the viewer until Ctrl-C.

    Args:
        studio: The scene that is shown.
        host: The address.
        port: The port; 0 takes a free one.
        ready: Is called with the page's address.

    Raises:
        ValueError: As `check_address`.
    """
    check_address(host, port)
    import viser

    with _silence():
        server = viser.ViserServer(host, port, label="irisjax", verbose=False)
    page = _Page(server, studio)
    with warnings.catch_warnings():
        # A browser may leave while its picture is being drawn.
        warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
        try:
            page.worker.start()
            ready(f"http://{host}:{server.get_port()}")
            while True:
                time.sleep(0.5)
        except KeyboardInterrupt:
            pass
        finally:
            page.worker.stop()
            with _silence():
                server.stop()
            page.worker.join(timeout=10)


def check_address(host: str, port: int) -> None:
    """Check that the viewer's page can be served.

    Raises:
        ValueError: viser is not installed, or the address cannot be used.
    """
    if importlib.util.find_spec("viser") is None:
        raise ValueError("the viewer needs viser: pip install 'irisjax[view]'")
    # viser would move on to the next free port without a word.
    try:
        with socket.create_server((host, port)):
            pass
    except OSError as error:
        raise ValueError(
            f"cannot listen on port {port} of {host}: {error.strerror or error}"
        ) from None


def _silence():
    """Standard output is the command's, not viser's."""
    return contextlib.redirect_stdout(io.StringIO())


class _Page:
    """Widgets, and the worker that answers them."""

    def __init__(self, server: "viser.ViserServer", studio: Studio | Bench):
        self.server, self.studio = server, studio
        self.worker = Newest(self._show)
        self.picture = np.full((3, 4, 3), BLACK, np.uint8)
        self.panel = (
            CoatsPanel(server.gui, studio, self.worker.put)
            if isinstance(studio, Bench)
            else TissuePanel(server.gui, studio)
        )
        self.past: list[Any] = []  # settings of earlier pictures, the last one that of now
        self.first, self.spent = True, 0.0  # s for the last picture with other pigments
        self.width = studio.settings.width  # of the field at viser's `ORBIT`
        gui = server.gui
        self._look(server.initial_camera)
        server.initial_camera.up = np.array([0.0, 1.0, 0.0])
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(330)
        panel = gui.add_panel()
        with panel.add_tab(self.panel.TITLE):
            self.status = self.panel.results()
            gui.add_html(_KEEP_ARROWS)
        panel.dock_left()
        panel.set_width(320)
        self._say("computing the eye's tables …")
        self.widgets = self._settings()
        server.on_client_connect(self._connected)
        self.worker.put()

    def _settings(self) -> dict[str, Any]:
        gui, studio, widgets = self.server.gui, self.studio, self.panel.widgets()
        with gui.add_folder("Light"):
            around, now = studio.environments(), studio.settings
            widgets["environment"] = gui.add_dropdown(
                "environment", around, initial_value=now.environment
            )
            widgets |= sliders(gui, "Light", now)
        for name, widget in widgets.items():
            widget.on_update(lambda event, name=name: self._moved(event, name))
        if isinstance(studio, Studio):
            undo = gui.add_button("undo", hint="the change before the last picture")
            undo.on_click(lambda event: self._undo())
            if studio.file is not None:
                save = gui.add_button(
                    f"save {_SCENE}", hint=f"draw it by: irisjax render {_SCENE} -o eye.png"
                )
                save.on_click(lambda event: self._save(event.client, studio))
        return widgets

    def _undo(self) -> None:
        if len(self.past) > 1:
            self.past.pop()
            self.worker.put(**vars(self.past[-1]))

    def _save(self, client: "viser.ClientHandle | None", studio: Studio) -> None:
        if client is not None:
            client.send_file_download(_SCENE, studio.scene_text().encode())

    def _moved(self, event, name: str) -> None:
        if event.client is None:  # it is the page that follows the settings
            return
        # The photograph belongs to its own camera.
        asked = {name: meant(name, event.target.value)}
        if name == "photograph" and event.target.value > 0 and isinstance(self.studio, Studio):
            asked |= self.studio.photographed
        self.worker.put(**asked)

    def _say(self, *lines: str) -> None:
        self.status.content = (
            '<div id="irisjax-status" style="padding:0.4em 0.9em;'
            'font-size:0.8em;opacity:0.8">' + "<br>".join(lines) + "</div>"
        )

    def _show(self, changes: dict[str, Any]) -> None:
        """Draw after some changes; what is not quick first as a draft."""
        try:
            settings = self.studio.settings
            new = {n for n, value in changes.items() if getattr(settings, n, None) != value}
            quick, wipe = QUICK.issuperset(new), not self.first and new == {"photograph"}
            if not wipe and (self.first or not quick or self.spent > _PATIENCE):
                self._draw(True, changes)
                if not self.first and not self.worker.quiet(_REST):
                    return
                changes = {}
            spent = self._draw(False, changes)
            self.spent = spent if quick and not (wipe or self.first) else self.spent
            if not self.past or self.past[-1] != self.studio.settings:
                self.past = [*self.past, self.studio.settings][-_MOST_STEPS:]
            self.first = False
        except Exception as error:  # the page must outlive a setting that cannot be drawn
            self._say(f"{type(error).__name__}: {error}".replace("<", "&lt;"))

    def _draw(self, draft: bool, changes: dict[str, Any]) -> float:
        began = time.perf_counter()
        self.picture = self.studio.update(draft=draft, **changes)
        spent = time.perf_counter() - began
        clients = self.server.get_clients().values()
        for client in clients:
            self._send(client)
        if self.worker.quiet(0):
            if changes.get("photograph"):
                self._beside()
            if "preset" in changes or changes.get("photograph"):
                for client in clients:
                    if self._asked(client.camera):
                        self._look(client.camera)
        self.panel.show_result(self.first)
        for name, widget in self.widgets.items():
            wanted = shown(name, getattr(self.studio.settings, name))
            if "preset" in changes and widget.value != wanted:
                widget.value = wanted
        (height, width, _), s = self.picture.shape, self.studio.settings
        self._say(
            f"{'draft' if draft else 'picture'} {width} × {height}: {1e3 * spent:.0f} ms",
            f"camera {s.camera_polar:.0f}° off axis at {s.camera_azimuth:.0f}°, field "
            f"{s.width:.1f} mm; drag to orbit, scroll to zoom",
            *self.panel.remarks(),
        )
        return spent

    def _send(self, client: "viser.ClientHandle") -> None:
        client.scene.set_background_image(
            framed(self.picture, client.camera.aspect), format="jpeg", jpeg_quality=92
        )

    def _connected(self, client: "viser.ClientHandle") -> None:
        aspect, arrived = 0.0, False
        self._look(client.camera)

        @client.camera.on_update
        def follow(camera) -> None:
            nonlocal aspect, arrived
            if camera.aspect != aspect:
                aspect = camera.aspect
                self._send(client)
            place = np.asarray(camera.position) - np.asarray(camera.look_at)
            # A slow browser may report viser's own camera after ours, and stay there.
            if np.abs(place - _VISERS).max() < 1e-3:
                self._look(camera)
                return
            asked = self._asked(camera)
            arrived |= not asked  # before that, viser reports a camera of its own
            if asked and arrived:
                if "photograph" in self.widgets:
                    self.widgets["photograph"].value = 0.0
                self.worker.put(**asked)

        follow(client.camera)

    def _beside(self) -> None:
        """Set the slider as it must be for a photograph that is shown."""
        assert isinstance(self.studio, Studio)  # paint has no photograph
        slider, share = self.widgets["photograph"], self.studio.settings.photograph
        if slider.value == 0 and share:  # by a turn of the eye that the slider overtook
            slider.value = share

    def _asked(self, camera) -> dict[str, float]:
        """Settings of viser's camera, if others than those of the picture."""
        settings = self.studio.settings
        seen = orbit(np.asarray(camera.position) - np.asarray(camera.look_at), self.width)
        if seen["camera_polar"] < 0.5:  # straight ahead there is no azimuth
            seen["camera_azimuth"] = settings.camera_azimuth
        moved = any(abs(getattr(settings, name) - value) > 0.02 for name, value in seen.items())
        return seen if moved else {}

    def _look(self, camera) -> None:
        """Put viser's camera where the settings look from."""
        s = self.studio.settings
        polar, azimuth = math.radians(s.camera_polar), math.radians(s.camera_azimuth)
        sin = math.sin(polar)
        towards = np.array([sin * math.cos(azimuth), sin * math.sin(azimuth), math.cos(polar)])
        camera.position = ORBIT * s.width / self.width * towards  # viser's z is the eye's −z
        camera.look_at = np.zeros(3)  # which viser carries along with the position


class Newest(threading.Thread):
    """One thread that works on whatever changed; values that were overtaken while it was busy are
    never computed.
    """

    def __init__(self, work: Callable[[dict[str, Any]], None]):
        super().__init__(daemon=True)
        self._work, self._waiting, self._stopped = work, None, False
        self._news = threading.Condition()

    def put(self, **changes: Any) -> None:
        """Request some changes, in addition to those that still wait."""
        with self._news:
            self._waiting = {**(self._waiting or {}), **changes}
            self._news.notify_all()

    def quiet(self, seconds: float) -> bool:
        """Wait so long and return whether no change was requested; called by the work."""
        with self._news:
            return not self._news.wait_for(
                lambda: self._waiting is not None or self._stopped, seconds
            )

    def stop(self) -> None:
        """Leave after the work in hand."""
        with self._news:
            self._stopped = True
            self._news.notify_all()

    def run(self) -> None:
        """Work until `stop`."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting is not None or self._stopped)
                if self._stopped:
                    return
                changes, self._waiting = self._waiting or {}, None
            self._work(changes)
