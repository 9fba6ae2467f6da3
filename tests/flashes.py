"""The golden reel with sound: a wall that flashes, and a click at each flash.

tests/data/golden-sound: 4 s at 50 frames per second, in groups of one second. Offsets are interpolated between frames,
so a flash that starts at frame f rises over the previous frame. The click is in the middle of that rise, at (f - 1/2) /
50 s.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.mp4 import RATE
from splatreel.codec.opus_sound import encode_sound, write_sound
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

GOLDEN = Path(__file__).parent / "data" / "golden-sound"
FPS = 50
FRAMES = 200
FLASHES = (20, 65, 125, 190)
"""First bright frames; each flash takes `FLASH` frames."""
FLASH = 8
CLICKS = tuple((frame - 0.5) / FPS for frame in FLASHES)
"""Times of the clicks in seconds, at the middle of each flash's rise."""
POSITION = (1.0, 0.0, 0.0)


def clicks(times: tuple[float, ...] = CLICKS, seconds: float = FRAMES / FPS, channels: int = 1) -> np.ndarray:
    """Return short decaying bursts that start at given times, [seconds * RATE, channels] float32."""
    sound = np.zeros((round(seconds * RATE), channels), np.float32)
    ages = np.arange(RATE // 100)
    burst = 0.8 * np.exp(-ages / 60) * np.cos(ages * 2 * np.pi * 3000 / RATE)
    for time in times:
        at = round(time * RATE)
        sound[at : at + len(burst)] += burst[: len(sound) - at, None].astype(np.float32)
    return sound


def onsets(sound: np.ndarray, apart: float = 0.05) -> np.ndarray:
    """Return the start times of bursts of `clicks` in [N, channels], by best fit, to a sample."""
    burst = clicks((0.0,), 0.01)[:, 0]
    fit = np.correlate(sound.mean(1), burst, "valid")
    found = []
    while fit.max(initial=0.0) > 0.5 * burst @ burst:
        found.append(int(fit.argmax()))
        fit[max(found[-1] - round(apart * RATE), 0) : found[-1] + round(apart * RATE)] = 0
    return np.sort(found) / RATE


def write_golden(path: Path) -> None:
    """Write the reel: a wall of 63 dynamic points, dark except for flashes, and 12 static points in its corners."""
    if path.exists():
        shutil.rmtree(path)
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    camera = Camera("start", viewmat, np.array([[120, 0, 80], [0, 120, 60], [0, 0, 1]]), 160, 120)
    header = ReelHeader(
        fps=FPS,
        group_length=FPS,
        overlap=2,
        sh_degree=0,
        bounds=np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]),
        up=np.array([0.0, -1.0, 0.0]),
        camera=camera,
        cameras=[camera],
    )
    writer = ReelWriter(path, header, config=EncodeConfig())
    write_sound(writer, encode_sound([clicks()], 1), POSITION)
    corners = np.array([[x, y, 0.2 * z] for x in (-2, 2) for y in (-1.5, 1.5) for z in (-1, 0, 1)])
    writer.add_layer(0, 0, _points(corners, 0.1, 0.6))
    wall = np.stack(np.meshgrid(np.linspace(-1.6, 1.6, 9), np.linspace(-1.2, 1.2, 7), [0.0]), -1).reshape(-1, 3)
    bright = np.zeros(FRAMES, bool)
    for frame in FLASHES:
        bright[frame : frame + FLASH] = True
    for index, first in enumerate(range(0, FRAMES, FPS)):
        shown = bright[first : first + FPS + 2]
        dq = np.zeros((len(shown), len(wall), 4))
        dq[..., 0] = 1
        shade = np.zeros((len(shown), len(wall), 4), np.float32)
        shade[..., :3] = shown[:, None, None] * 0.9 / 0.2820948
        dynamic = _points(wall, 0.3, 0.05)
        writer.add_group(Group(index, first, dynamic, np.zeros((*dq.shape[:2], 3)), dq, np.ones(12, bool), shade))
    writer.finish()


def _points(means: np.ndarray, scale: float, gray: float) -> Gaussians:
    count = len(means)
    sh = np.full((count, 1, 3), (gray - 0.5) / 0.2820948)
    return Gaussians(means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), scale), np.full(count, 0.95), sh)
