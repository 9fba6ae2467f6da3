"""A reel with known Gaussians, and a capture that renders them."""

from pathlib import Path

import numpy as np

from bench.microbenchmarks import cloud, front_camera, swinging_group
from splatreel.capture.base import Capture
from splatreel.codec.header import ReelHeader
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.kernels.image import render_image
from splatreel.run.store import Store, StoredGroup, StoredLayer
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.reel_source import ReelSource

FRAMES = 5
WIDTH, HEIGHT = 64, 48


def cameras() -> list[Camera]:
    """Return five cameras side by side."""
    made = []
    for i in range(5):
        camera = front_camera(WIDTH, HEIGHT)
        viewmat = camera.viewmat.copy()
        viewmat[0, 3] = 0.2 * (i - 2)
        made.append(Camera(f"cam{i:02d}", viewmat, camera.K, WIDTH, HEIGHT))
    return made


def group() -> Group:
    """Return dynamic points over 100 static ones, of which all except the first ten are alive."""
    moving = swinging_group(200, FRAMES)
    return Group(0, 0, moving.dynamic, moving.dx, moving.dq, np.arange(100) >= 10)


def static() -> Gaussians:
    return cloud(100, seed=7)


def truth(frame: int) -> Gaussians:
    """Return the points that the reel should show at a frame."""
    return Gaussians.concatenate([static()[10:], group().at(frame)])


class FilmedCapture(Capture):
    """Capture that renders `truth` with 8 bits. Frame `begin` of its files is the first of the scene."""

    begin = 0

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        for t in range(len(out)):
            for c, name in enumerate(cameras):
                image = np.clip(render_image(truth(max(first + t - self.begin, 0)), self.camera(name)), 0, 1)
                out[t, c] = np.rint(255 * image)


def capture(path: Path, held_out: list[str] | None = None, first: int = 0, end: int = FRAMES) -> FilmedCapture:
    names = ["cam00", "cam03"] if held_out is None else held_out
    return FilmedCapture(path, cameras(), held_out=names, frame_range=(first, end), fps=30)


def write_reel(path: Path, source: ReelSource | None = None) -> Path:
    """Write the scene as a reel of one group, with alive flags in the order of the stored layer."""
    training = [c for c in cameras() if c.name not in ("cam00", "cam03")]
    header = ReelHeader(
        fps=30,
        group_length=FRAMES,
        overlap=0,
        sh_degree=3,
        bounds=np.array([[-2.0, -2, -2], [2, 2, 2]]),
        up=np.array([0.0, -1, 0]),
        camera=training[0],
        cameras=training,
        source=source,
    )
    writer = ReelWriter(path, header, config=EncodeConfig())
    _, order = writer.add_layer(0, 0, static())
    moving = group()
    writer.add_group(Group(0, 0, moving.dynamic, moving.dx, moving.dq, moving.alive[order]))
    writer.finish()
    return path


def write_run(path: Path, source: ReelSource | None = None) -> Path:
    """Write the scene as the output folder of a reconstruction, with its reel and checkpoints."""
    reel = write_reel(path / "reel", source)
    store = Store(path / "work")
    store.save_header(ReelReader(reel).manifest)
    store.group(0).save_layer(StoredLayer(static(), static()))
    store.group(0).save_group(StoredGroup(group()))
    store.save_seconds({"keyframe": 30.0, "group": 60.0})
    return path
