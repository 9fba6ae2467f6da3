"""A run of three short chapters, described for other processes."""

from functools import partial
from pathlib import Path

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.run.jobs import scene_job
from splatreel.run.pipeline import RunSpec
from tests.method.captures import WallCapture
from tests.method.small import small

CONFIG = small({"chapter_frames": 4})
FRAMES = 11


class SpoiltCapture(WallCapture):
    """The frames of the second chapter cannot be read, as long as there is a file `spoilt`."""

    def __init__(self, frames: int, spoilt: Path) -> None:
        super().__init__(frames)
        self.spoilt = spoilt

    def _read_into(self, out, first, cameras) -> None:
        if first == 4 and len(out) > 1 and self.spoilt.exists():
            raise CaptureError(f"frame {first} is spoilt. Mend it.")
        super()._read_into(out, first, cameras)


def spec(out: Path, spoilt: Path | None = None) -> RunSpec:
    source = partial(WallCapture, FRAMES) if spoilt is None else partial(SpoiltCapture, FRAMES, spoilt)
    return RunSpec(source, out, CONFIG, device="cpu")


def make_scene(out: Path) -> Path:
    with spec(out).opened() as run:
        scene_job(run, Silent())
    return out
