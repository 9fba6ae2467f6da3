"""A run to start baselines from, written without training: its keyframe is the truth of the first frame."""

from pathlib import Path

import numpy as np

from baselines.shared_start import SharedStart
from splatreel.capture.base import Capture
from splatreel.codec.reader import ReelReader
from splatreel.config import Config
from splatreel.config.settings import changed
from splatreel.method.init.layout import Layout
from splatreel.run.store import Store, pack
from splatreel.scene.gaussians import Gaussians
from tests.evaluation import scenes

SECONDS = {"points": 2.0, "keyframe": 8.0, "group": 90.0}
"""Seconds of the stages of the run. Its keyframe trained for 40 iterations, so that one took 0.2 seconds."""
PLAIN = {
    "antialias": False,
    "keyframe.first_iterations": 40,
    "group.length": 3,
    "group.overlap": 1,
    "keyframe.points_per_pixel": 1.0,
}


class StillCapture(scenes.FilmedCapture):
    """Capture in which nothing moves."""

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        super()._read_into(out[:1], 0, cameras)
        out[1:] = out[:1]


def still(path: Path) -> StillCapture:
    return StillCapture(path, scenes.cameras(), held_out=["cam00", "cam03"], frame_range=(0, scenes.FRAMES), fps=30)


def write_start(capture: Capture, out: Path, keyframe: Gaussians | None = None) -> SharedStart:
    """Write the checkpoints that baselines need."""
    header = ReelReader(scenes.write_reel(out / "reel")).manifest
    store, cameras = Store(out / "work"), capture.training_cameras
    points = scenes.truth(0) if keyframe is None else keyframe
    store.save_header(header)
    bounds = np.stack([points.means.min(0), points.means.max(0)]).astype(float).tolist()
    store.save_layout(Layout(header.near, 3.0, [0.0, -1.0, 0.0], bounds), points.means, np.ones((len(points), 3)))
    store.group(0).save("keyframe", pack(points) | {"gains": np.ones((len(cameras), 3), np.float32)})
    store.save_seconds(SECONDS)
    return SharedStart(capture, out, changed(Config(), PLAIN))
