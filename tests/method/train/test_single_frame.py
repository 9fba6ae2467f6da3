"""Reconstruction of one frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.base.progress import Silent
from splatreel.method.train.single_frame import reconstruct_single_frame
from splatreel.run.pipeline import reconstruct
from splatreel.run.store import load_arrays, load_json, pack
from tests.method.captures import WallCapture
from tests.method.small import small
from tests.notes import Notes

CONFIG = small({"keyframe.first_iterations": 40})


class Trace(Silent):
    """Progress that records the last step."""

    done = 0

    def update(self, done: int, **numbers: float) -> None:
        self.done = done


def images(capture: WallCapture, frame: int) -> np.ndarray:
    return capture.read(frame, 1, [camera.name for camera in capture.cameras])[0]


def test_single_frame_equals_first_keyframe_of_a_run(tmp_path: Path) -> None:
    capture, trace = WallCapture(1), Trace()
    gaussians, layout = reconstruct_single_frame(capture.cameras, images(capture, 0), CONFIG, progress=trace)
    work = reconstruct(capture, tmp_path, CONFIG, device="cpu").work
    keyframe = load_arrays(work / "group0000" / "keyframe.safetensors")
    for name, value in pack(gaussians).items():
        np.testing.assert_array_equal(value, keyframe[name])
    assert layout.to_dict() == load_json(work / "layout.json")
    assert trace.done == 40


def test_single_frame_warns_about_low_psnr() -> None:
    capture, heard = WallCapture(1), Notes()
    config = replace(CONFIG, keyframe=replace(CONFIG.keyframe, first_iterations=150, rate_scale=4.0))
    shown = images(capture, 0)
    reconstruct_single_frame(capture.cameras, shown, config, progress=heard)
    assert not heard.lines
    noise = np.random.default_rng(0).integers(0, 256, shown.shape).astype(np.uint8)
    reconstruct_single_frame(capture.cameras, noise, config, progress=heard)
    assert "the cameras disagree" in heard.lines[0]
