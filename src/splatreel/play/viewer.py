"""Viewer that renders a reel with the Python kernels and streams the images to browsers through viser (extra `viewer`).

It serves machines whose browsers cannot draw, and shows exactly what the kernels render. Each browser has its own camera; all share
one time.
"""

from __future__ import annotations

import contextlib
import io
import math
import threading
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatreel.base.errors import SplatreelError
from splatreel.play.timeline import Draw, Timeline
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

_HOST = "127.0.0.1"
RATES = ("0.25", "0.5", "1", "2")
_MAX_SECONDS = 1 / 12
"""Maximum seconds per image while something moves. Still views are rendered at full resolution."""
_MIN_SIDE = 96
"""Minimum pixels of the shorter side."""
_POLL = 1 / 60


@dataclass
class Clock:
    """Playback time, which advances while playing and stops or loops at the end."""

    duration: float
    """End of the reel, in seconds."""
    playing: bool = True
    loop: bool = True
    rate: float = 1.0
    """Seconds of the reel per second."""
    time: float = 0.0
    """Present time, in seconds of the reel."""
    start: float = 0.0
    """Start of the reel, in seconds."""

    def __post_init__(self) -> None:
        self.time = max(self.time, self.start)

    def advance(self, seconds: float) -> None:
        """Advance by `seconds` of real time."""
        if not self.playing or self.duration <= self.start:
            return
        self.time += seconds * self.rate
        if self.time >= self.duration:
            self.playing = self.loop
            length = self.duration - self.start
            self.time = self.start + (self.time - self.start) % length if self.loop else self.duration

    def seek(self, time: float) -> None:
        """Go to a time, clamped to the reel."""
        self.time = min(max(time, self.start), self.duration)

    def toggle(self) -> None:
        """Play or pause. At the end, play from the start."""
        if not self.playing and self.time >= self.duration:
            self.time = self.start
        self.playing = not self.playing


class Viewer:
    """A viser server that shows a reel, on a thread of its own.

    It is also a context manager: `with Viewer(...) as viewer:`.
    """

    def __init__(self, reel: Timeline, draw: Draw, port: int = 0, width: int = 1280) -> None:
        """Start the viser server. Rendering begins when the context is entered.

        Args:
            reel: Reel to show.
            draw: Renderer, see `renderers.Draw`.
            port: Port to listen on; 0 takes any free one.
            width: Maximum width of an image, in pixels.

        Raises:
            ModuleNotFoundError: viser is not installed.
        """
        import viser

        self.reel = reel
        self.clock = Clock(reel.duration, start=reel.manifest.first_frame / reel.fps)
        self._draw = draw
        self._width = width
        self._error: SplatreelError | None = None
        self._shown: dict[int, tuple] = {}
        self._moment: tuple[float, Gaussians] | None = None
        self._pace = 1e-7
        """Recent rendering time per pixel, in seconds."""
        # viser warns when a browser closes while its image is rendered.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        # Viser prints its address, which the command line prints as well.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server: Any = viser.ViserServer(host=_HOST, port=port, label="Splatreel", verbose=False)
        self._arrange()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="splatreel-viewer", daemon=True)

    @property
    def url(self) -> str:
        """URL of the viewer."""
        return f"http://{_HOST}:{self._server.get_port()}/"

    @property
    def settled(self) -> bool:
        """True if every browser shows the present time and its own view at full resolution."""
        clients = self._server.get_clients()
        return bool(clients) and all(self._shown.get(name, ((), False))[1] for name in clients)

    def wait(self) -> None:
        """Block until another thread calls `close`, or until Ctrl-C. Raises `SplatreelError` if the reel is damaged."""
        while self._thread.is_alive():
            self._thread.join(0.5)
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Stop rendering and free the port."""
        self._ended.set()
        self._thread.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def __enter__(self) -> Viewer:
        self._warm_up()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _arrange(self) -> None:
        """Create the control panel and set the first view."""
        server, clock, manifest = self._server, self.clock, self.reel.manifest
        server.scene.set_up_direction(tuple(map(float, manifest.up)))
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        place_camera(server.initial_camera, manifest.camera, np.asarray(manifest.bounds).mean(0))
        self._play = server.gui.add_button("Pause", hint="Play or pause")
        first, last = clock.start, max(clock.duration, clock.start + 1e-3)
        self._slider = server.gui.add_slider("Time", min=first, max=last, step=1e-3, initial_value=first)
        rate = server.gui.add_dropdown("Speed", RATES, initial_value="1")
        loop = server.gui.add_checkbox("Loop", initial_value=True)
        home = server.gui.add_button("Reset view")
        self._play.on_click(lambda _: clock.toggle())
        self._slider.on_update(lambda event: clock.seek(event.target.value) if event.client else None)
        rate.on_update(lambda event: setattr(clock, "rate", float(event.target.value)))
        loop.on_update(lambda event: setattr(clock, "loop", event.target.value))
        middle = np.asarray(manifest.bounds).mean(0)
        home.on_click(
            lambda event: place_camera(event.client.camera, manifest.camera, middle) if event.client else None
        )

    def _warm_up(self) -> None:
        """Render before time begins, to compile the kernels, decode the first group and measure the speed of the device."""
        for _ in range(2):
            began = time.perf_counter()
            view = self.reel.manifest.camera
            self._image(view, full=True)
            self._pace = (time.perf_counter() - began) / (view.width * view.height)

    def _run(self) -> None:
        last = time.perf_counter()
        try:
            while not self._ended.is_set():
                now = time.perf_counter()
                self.clock.advance(now - last)
                last = now
                self._play.label = "Pause" if self.clock.playing else "Play"
                self._slider.value = round(self.clock.time, 3)
                if not self._show_all():
                    self._ended.wait(_POLL)
        except SplatreelError as error:
            self._error = error

    def _show_all(self) -> bool:
        """Render for every browser that does not show the present time and view at full resolution. Return True if any did not."""
        clients = self._server.get_clients()
        self._shown = {name: shown for name, shown in self._shown.items() if name in clients}
        drew = False
        for name, client in clients.items():
            camera, view = client.camera, self._view_of(client.camera)
            if view is None:
                continue
            key = (self.clock.time, *camera.position, *camera.wxyz, camera.fov, view.width, view.height)
            before = self._shown.get(name)
            if before == (key, True):
                continue
            still = before is not None and before[0] == key
            image = self._image(view, full=still)
            client.scene.set_background_image(image, format="jpeg", jpeg_quality=90 if still else 75)
            self._shown[name] = (key, still)
            drew = True
        return drew

    def _view_of(self, camera: Any) -> Camera | None:
        """Return the camera of a browser, at most `width` pixels wide; None while the browser has no size."""
        if camera.image_width < 1 or camera.image_height < 1:
            return None
        width = min(camera.image_width, self._width)
        height = max(round(width * camera.image_height / camera.image_width), 1)
        return camera_of(camera.position, camera.wxyz, camera.fov, width, height)

    def _image(self, view: Camera, full: bool) -> np.ndarray:
        """Render [h, w, 3] uint8, at reduced resolution unless `full`, if the device is too slow."""
        if not full:
            part = min(math.sqrt(_MAX_SECONDS / (self._pace * view.width * view.height)), 1.0)
            part = max(part, min(_MIN_SIDE / min(view.width, view.height), 1.0))
            view = view.resized(max(round(view.width * part), 1), max(round(view.height * part), 1))
        began = time.perf_counter()
        if self._moment is None or self._moment[0] != self.clock.time:
            self._moment = (self.clock.time, self.reel.at(self.clock.time))
        image = self.reel.render(self._moment[1], view, self._draw)
        taken = (time.perf_counter() - began) / (view.width * view.height)
        self._pace += 0.3 * (taken - self._pace)
        return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def camera_of(position: np.ndarray, wxyz: np.ndarray, fov: float, width: int, height: int) -> Camera:
    """Return a camera.

    Args:
        position: [3] in world units.
        wxyz: [4] rotation from camera to world, OpenCV.
        fov: Vertical field of view, in radians.
        width: Pixels.
        height: Pixels.
    """
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotations.to_matrix(np.asarray(wxyz, np.float64)[None])[0].T
    viewmat[:3, 3] = -viewmat[:3, :3] @ np.asarray(position)
    focal = height / 2 / math.tan(fov / 2)
    return Camera("view", viewmat, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), width, height)


def place_camera(handle: Any, camera: Camera, middle: np.ndarray) -> None:
    """Set a viser camera to the pose of `camera`. It orbits the point ahead that is as far away as `middle` [3]."""
    ahead = float((middle - camera.center) @ camera.forward)
    distance = ahead if ahead > 0 else max(float(np.linalg.norm(middle - camera.center)), 1e-3)
    handle.position = camera.center.astype(np.float64)
    handle.look_at = (camera.center + distance * camera.forward).astype(np.float64)
    handle.fov = 2 * math.atan(camera.height / 2 / float(camera.K[1, 1]))
