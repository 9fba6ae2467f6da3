"""Videos that change slowly or once: the shared scene, and the points of each chapter."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.capture.base import Capture
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.jobs import ChapteredRun, chapter_job, scene_job
from splatreel.run.pipeline import plan_run
from splatreel.run.steps import CHAPTER
from splatreel.scene.gaussians import Gaussians
from tests.method.captures import HEIGHT, WIDTH, make_image
from tests.method.scenes import ring
from tests.method.small import small

FRAMES, CAMERAS = 12, 5
AWAY = 50.0
CONFIG = small({"chapter_frames": 4, "keyframe.first_iterations": 60, "check_poses": False, "background": False})


class ChangingWall(Capture):
    """A wall, and a cluster before it that rests and is gone from frame `leaves` on.

    Half as bright as other walls, so that no light makes it white. brighter: logarithm that light gains a frame.
    """

    def __init__(self, leaves: int, brighter: float = 0.0) -> None:
        self.leaves, self.brighter = leaves, brighter
        super().__init__(Path("wall"), ring(CAMERAS, width=WIDTH, height=HEIGHT), held_out=[], frame_range=(0, FRAMES))

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        for c, name in enumerate(cameras):
            number = [camera.name for camera in self.cameras].index(name)
            for t in range(len(out)):
                shown = make_image(number, CAMERAS, 0.0 if first + t < self.leaves else AWAY, dims=True)
                out[t, c] = np.rint(shown * np.exp(self.brighter * (first + t))).clip(0, 255)


def made(capture: Capture, out: Path, chapters: list[int]) -> ChapteredRun:
    """Reconstruct the shared scene and some of the chapters."""
    run = plan_run(capture, out, CONFIG, device="cpu")
    assert [chapter.groups[0].first for chapter in run.chapters] == [0, 4, 8]
    scene_job(run, Silent())
    for index in chapters:
        chapter_job(run, index, Silent())
    return run


def started(run: ChapteredRun, chapter: int) -> KeyframeResult:
    start = CHAPTER.load(run.store.group(run.chapters[chapter].first))
    assert start is not None
    return start


def alive(run: ChapteredRun, chapter: int) -> np.ndarray:
    """Shared static points that a chapter keeps."""
    found = started(run, chapter).alive
    assert found is not None
    return found


def cluster(points: Gaussians) -> np.ndarray:
    """Return [N] bool: visible points at the place of the cluster."""
    x, y, z = points.means.T
    return (x > -1.7) & (x < -0.5) & (np.abs(y) < 0.7) & (z > -0.5) & (z < 0.4) & (points.opacities > 0.3)


def test_scene_holds_mostly_resting_points_and_chapter_removes_absent_ones(tmp_path: Path) -> None:
    run = made(ChangingWall(leaves=8), tmp_path, [0, 2])
    shared = run.store.scene.layer()
    assert shared is not None
    there = cluster(shared.decoded)
    assert there.sum() > 20
    assert alive(run, 0)[there].mean() > 0.9
    last = alive(run, 2)
    assert last[there].mean() < 0.3
    assert last[~there].mean() > 0.9
    assert run.store.group(run.groups[-1].index).group().group.alive[: len(there)][there].mean() < 0.3


def test_drifting_light_adds_no_points_and_is_restored_in_playback(tmp_path: Path) -> None:
    run = made(ChangingWall(leaves=FRAMES, brighter=0.04), tmp_path, [0, 2])
    lights = []
    for chapter in (run.chapters[0], run.chapters[2]):
        assert len(started(run, chapter.index).points) == 0
        assert alive(run, chapter.index).all()
        light = run.store.group(chapter.first).group().group.light
        assert light is not None
        lights.append(light.mean(1))
    assert lights[1][0] / lights[0][0] == pytest.approx(np.exp(0.04 * 8), rel=0.03)
