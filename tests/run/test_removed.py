"""A capture that is removed during its reconstruction, and restored."""

import json
import shutil
from pathlib import Path

import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent, Span
from splatreel.capture.opening import open_capture
from splatreel.codec.inspection import verify_reel
from splatreel.run.pipeline import reconstruct
from tests.files import contents
from tests.method.captures import HEIGHT, WIDTH, WallCapture
from tests.method.small import small

FRAMES = 7
CONFIG = small({"group.length": 2, "keyframe.first_iterations": 10})


@pytest.fixture
def image_folder(tmp_path: Path) -> Path:
    """The wall as Panoptic Sports has its images: a file a camera and frame, opened when it is needed."""
    wall, folder = WallCapture(FRAMES), tmp_path / "pictures"
    for number in range(len(wall.cameras)):
        (folder / "ims" / str(number)).mkdir(parents=True)
    names = range(len(wall.cameras))
    meta = {
        "w": WIDTH,
        "h": HEIGHT,
        "k": [[camera.K.tolist() for camera in wall.cameras]] * FRAMES,
        "w2c": [[camera.viewmat.tolist() for camera in wall.cameras]] * FRAMES,
        "fn": [[f"{number}/{frame:06d}.png" for number in names] for frame in range(FRAMES)],
        "cam_id": [list(names)] * FRAMES,
    }
    (folder / "train_meta.json").write_text(json.dumps(meta))
    for frame, images in enumerate(wall.read(0, FRAMES, [camera.name for camera in wall.cameras])):
        for number, image in enumerate(images):
            Image.fromarray(image).save(folder / "ims" / str(number) / f"{frame:06d}.png")
    return folder


class Thief(Silent):
    """Progress that moves a folder away when a stage begins."""

    def __init__(self, folder: Path, stage: str) -> None:
        self.folder, self.stolen = folder, stage

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        if name.startswith(self.stolen):
            self.folder.rename(self.folder.with_name("elsewhere"))


@pytest.mark.slow
def test_removed_capture_is_reported_and_run_continues_later(image_folder: Path, tmp_path: Path) -> None:
    whole = reconstruct(open_capture(image_folder, held_out=[]), tmp_path / "whole", CONFIG)
    folder, out = image_folder / "ims", tmp_path / "out"
    thief = Thief(folder, "group 1/3: training the motion")
    with pytest.raises(CaptureError, match=r"ims.\d.0000\d\d\.png"):
        reconstruct(open_capture(image_folder, held_out=[]), out, CONFIG, progress=thief)
    groups = verify_reel(out / "reel").groups
    assert 1 <= groups < 3
    with pytest.raises(CaptureError, match="pictures"):
        reconstruct(open_capture(image_folder, held_out=[]), out, CONFIG)
    assert verify_reel(out / "reel").groups == groups
    shutil.move(folder.with_name("elsewhere"), folder)
    again = reconstruct(open_capture(image_folder, held_out=[]), out, CONFIG)
    assert contents(again.reel) == contents(whole.reel)
