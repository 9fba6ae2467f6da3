"""Reels of frames with known points: decoded as encoded, within quantization."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.frame_methods import AttributeVideo, PerFrame, Streaming, chain
from baselines.part_by_part import Frames, PartMethod, run_in_parts
from baselines.shared_start import SharedStart
from baselines.temporal_slices import TemporalSlices
from splatreel.base.progress import Silent
from splatreel.codec.inspection import reel_info
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.metrics import psnr
from splatreel.kernels.image import render_image
from splatreel.play.timeline import Timeline
from splatreel.scene.gaussians import Gaussians
from tests.benchmarks.baselines.starts import still, write_start
from tests.evaluation import scenes


@pytest.fixture
def start(tmp_path: Path) -> SharedStart:
    return write_start(scenes.capture(tmp_path), tmp_path / "run")


def moving(folder: Path, method: PartMethod, count: int = scenes.FRAMES) -> Frames:
    """Save the moving points of the scene, as a method would have trained them."""
    frames = Frames(folder, count)
    for frame in range(count):
        frames.save(frame, method.first(scenes.truth(frame)))
    return frames


def image(points: Gaussians, start: SharedStart) -> np.ndarray:
    return np.clip(render_image(points, start.capture.cameras[1], near=start.layout.near), 0, 1)


@pytest.mark.parametrize(
    "method", [PerFrame(), Streaming(), AttributeVideo(), TemporalSlices()], ids=lambda m: type(m).__name__
)
def test_decoded_frames_show_what_was_encoded(method: PartMethod, start: SharedStart, tmp_path: Path) -> None:
    frames = moving(tmp_path / "frames", method)
    method.write(start, frames, tmp_path / "method")
    timeline = Timeline(ReelReader(tmp_path / "method"))
    assert timeline.frames == scenes.FRAMES
    for frame in (0, 2, 4):
        decoded = timeline.at(frame / timeline.fps)
        assert psnr(image(decoded, start), image(frames.load(frame), start)) > 30
    assert psnr(image(timeline.at(0), start), image(frames.load(4), start)) < 30  # the points do move


def test_chain_hides_points_before_their_frame(start: SharedStart, tmp_path: Path) -> None:
    frames, all_points = Frames(tmp_path / "frames", 3), scenes.truth(0)
    for frame, count in enumerate((280, 280, 290)):
        frames.save(frame, replace(all_points, means=all_points.means + 0.1 * frame)[:count])
    group = chain(start, frames, 0, 3, 0)
    assert len(group.dynamic) == 290
    assert (group.at(0).opacities[280:] == 0).all()
    assert (group.at(1).opacities[280:] == 0).all()
    for frame in range(3):
        shown = group.at(frame)[: 290 if frame == 2 else 280]
        np.testing.assert_allclose(shown.means, frames.load(frame).means, atol=1e-5)
        np.testing.assert_allclose(shown.opacities, frames.load(frame).opacities, atol=1e-6)


def test_a_rest_costs_a_stream_nearly_nothing(start: SharedStart, tmp_path: Path) -> None:
    sizes = {}
    for count in (1, 5):
        resting = Frames(tmp_path / f"frames{count}", count)
        for frame in range(count):
            resting.save(frame, scenes.truth(0))
        Streaming().write(start, resting, tmp_path / f"reel{count}")
        sizes[count] = reel_info(tmp_path / f"reel{count}").bytes
    Streaming().write(start, moving(tmp_path / "moving", Streaming()), tmp_path / "moved")
    assert sizes[5] < sizes[1] + 500
    assert reel_info(tmp_path / "moved").bytes > sizes[1] + 1000


@pytest.mark.slow
def test_a_static_scene_costs_a_stream_little_and_frames_much(tmp_path: Path) -> None:
    sizes = {}
    start = write_start(still(tmp_path), tmp_path / "run")
    for method in (PerFrame(), Streaming()):
        out = tmp_path / type(method).__name__
        run_in_parts(method, start, out, 12.0, Silent())
        sizes[type(method)] = reel_info(out / "reel").bytes
    assert 2 * sizes[Streaming] < sizes[PerFrame]
