"""Synthetic films, ray traced and written as captures, for properties that other captures lack."""

import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ball import found
from run import run
from splatreel.base import threads
from splatreel.capture.opening import open_capture
from splatreel.config import Quality, preset
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from toyroom.capture import VideoWriter, llff_row
from toyroom.raytracer import StaticView, trace_frame, trace_static
from toyroom.solids import Shapes

FPS = 30
QUALITY = {"crf": "6", "preset": "medium"}
"""Options of x264 that keep the noise of a camera. Those of the built-in capture remove most of it."""
VISIBLE, SMALLEST = 20, 1e-3
"""Gray levels by which a pixel shows a thing, or its shadow; the least share of the image that is looked at."""
SKIN = (0.9, 0.7, 0.58)


@dataclass(frozen=True)
class Film:
    """A scene and its cameras. moving: function from seconds to the moving solids. light: position of the lamp.

    noise: standard deviation of pixels, in gray levels. gain: that of the logarithm of the training cameras' color gains.
    drift: how far their exposures go up and down meanwhile, each by itself: the logarithm of a gain of all channels. late: frames by
    which they are out of step at most; the held-out cameras are late as the others are in the mean.
    """

    cameras: list[Camera]
    held_out: tuple[str, ...]
    still: Shapes
    moving: Callable[[float], Shapes]
    light: np.ndarray
    noise: float
    gain: float
    drift: float = 0.0
    late: float = 0.0

    def write(self, path: Path, frames: int) -> None:
        """Write a Neu3DV folder atomically. The bytes are the same every time."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as temporary:
            folder = Path(temporary) / path.name
            folder.mkdir()
            with ThreadPoolExecutor(threads.count()) as pool:
                list(pool.map(lambda number: self._shoot(folder, number, frames), range(len(self.cameras))))
            np.save(folder / "poses_bounds.npy", np.stack([llff_row(camera, 1.5, 14.0) for camera in self.cameras]))
            about = {"held_out": self.held_out, "fps": FPS}
            (folder / "splatreel.json").write_text(json.dumps(about), encoding="utf-8")
            os.replace(folder, path)

    def _shoot(self, folder: Path, number: int, frames: int) -> None:
        camera, rng = self.cameras[number], np.random.default_rng(number)
        fixed = camera.name in self.held_out
        gain = np.ones(3) if fixed else np.exp(rng.normal(0, self.gain, 3))
        (phase, speed, _), late = self._habits(number), self._lateness(number)
        seen = trace_static(camera, self.still, self.light)
        with VideoWriter(folder / f"{camera.name}.mp4", camera, FPS, quality=QUALITY) as video:
            for t in range(frames):
                clean = self.image(camera, seen, max(t + late, 0) / FPS)
                exposure = 1.0 if fixed else np.exp(self.drift * np.sin(phase + speed * t / FPS))
                noisy = clean * gain * exposure + rng.normal(0, self.noise, clean.shape)
                video.add(noisy.clip(0, 255).astype(np.uint8))

    def image(self, camera: Camera, seen: StaticView, seconds: float) -> np.ndarray:
        """Return a noise-free image in gray levels, [H, W, 3].

        Args:
            seen: Static surfaces that the camera sees.
        """
        return trace_frame(camera, seen, self.still, self.moving(seconds), self.light)

    def _habits(self, number: int) -> np.ndarray:
        """Return the phase (radians), the rate (radians per second) of a camera's exposure, and its lateness in frames, [3]."""
        return np.random.default_rng((number, 1)).uniform((0, 2, -self.late), (2 * np.pi, 8, self.late))

    def _lateness(self, number: int) -> float:
        """Return the frames by which a camera is late."""
        lates = {n: self._habits(n)[2] for n, camera in enumerate(self.cameras) if camera.name not in self.held_out}
        return float(lates[number] - np.mean(list(lates.values()))) if number in lates else 0.0

    def run(self, name: str, quality: Quality, frames: int, seed: int, out: Path | None, note: str) -> Path:
        """Film the scene unless it exists, reconstruct, evaluate and record it as `name`; return the reel's path."""
        out = out or Path(f"out/benchmark-{name}-{quality}-{frames}-{seed}")
        started = time.monotonic()
        if not (out / "capture").exists():
            self.write(out / "capture", frames)
        filming = time.monotonic() - started
        config = dataclasses.replace(preset(quality), seed=seed)
        run(name, open_capture(out / "capture"), out, config, None, note, filming)
        return out / "reel"

    def shows(self, reel: Path, frames: int, without: Callable[[float], Shapes]) -> dict[str, dict]:
        """Return, for each held-out camera, how well a reel shows a moving object.

        The value is the share of the thing's pixels that look more like it than like the background.

        Args:
            without: The moving solids without the thing.
        """
        played, summaries = open_reel(reel), {}
        for camera in [camera for camera in self.cameras if camera.name in self.held_out]:
            seen, shares = trace_static(camera, self.still, self.light), {}
            for t in range(frames):
                scenes = self.moving(t / FPS), without(t / FPS)
                there, gone = (trace_frame(camera, seen, self.still, scene, self.light) for scene in scenes)
                image = 255 * played.render(played.at(t / FPS), camera)
                pixels = np.abs(there - gone).mean(-1) > VISIBLE
                if pixels.mean() >= SMALLEST:
                    nearer = np.abs(image - there).mean(-1) < np.abs(image - gone).mean(-1)
                    shares[t] = float(nearer[pixels].mean())
            summaries[camera.name] = found(shares)
            print(f"{camera.name}: {summaries[camera.name]}")
        return summaries
