"""Findings about the cameras in whole reconstructions that are interrupted and continued."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.codec.reader import ReelReader
from splatreel.method.cameras import rig
from splatreel.method.cameras.poses import CorrectedPose, PoseFindings
from splatreel.run.pipeline import reconstruct
from splatreel.run.store import load_arrays
from splatreel.scene.camera import Camera
from tests.method.captures import WallCapture
from tests.run.test_pipeline import CONFIG, FRAMES, Stop, content, finish_despite


@pytest.mark.slow
def test_exposures_and_time_offsets_survive_interruptions(tmp_path: Path) -> None:
    capture = WallCapture(FRAMES, drift=0.08)
    undisturbed = reconstruct(capture, tmp_path / "undisturbed", CONFIG)
    for index, first in enumerate((0, 2)):
        found = load_arrays(undisturbed.work / f"group{index:04d}" / "exposure.safetensors")["change"]
        true = [
            [np.log(capture.exposure(c, first + t)) for c in range(len(capture.cameras))] for t in range(len(found))
        ]
        assert np.abs(found - np.array(true)[..., None]).max() < 0.02
    first, second = (load_arrays(file)["delays"] for file in sorted(undisturbed.work.glob("group*/delays.safetensors")))
    assert np.all(first != 0)
    assert np.all(second != first)
    seen: set[object] = set()
    disturbed = tmp_path / "disturbed"
    finish_despite(
        lambda: reconstruct(capture, disturbed, CONFIG, progress=Stop(seen)), KeyboardInterrupt, disturbed / "reel"
    )
    assert content(disturbed / "reel") == content(undisturbed.reel)


@pytest.mark.slow
def test_corrected_poses_survive_interruptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def findings(cameras: list[Camera], frames: np.ndarray) -> PoseFindings:
        """The second is a stranger, the third was touched; in later groups nothing is found."""
        assert frames.shape[:2] == (2, len(cameras))
        if len(cameras) < 5:
            return PoseFindings({}, [], [])
        return PoseFindings({2: CorrectedPose(moved(cameras[2]), 1.0)}, [1], [])

    def moved(camera: Camera) -> Camera:
        viewmat = camera.viewmat.copy()
        viewmat[0, 3] += 0.05
        return replace(camera, viewmat=viewmat)

    monkeypatch.setattr(rig, "inspect_poses", findings)
    capture = WallCapture(FRAMES, cameras=5)
    undisturbed = reconstruct(capture, tmp_path / "undisturbed", CONFIG)
    cameras = ReelReader(undisturbed.reel).manifest.cameras
    first, _, third, *others = capture.cameras
    assert [camera.name for camera in cameras] == [camera.name for camera in (first, third, *others)]
    assert np.allclose(cameras[1].viewmat, moved(third).viewmat)
    disturbed, seen = tmp_path / "disturbed", set[object]()
    finish_despite(
        lambda: reconstruct(capture, disturbed, CONFIG, progress=Stop(seen)), KeyboardInterrupt, disturbed / "reel"
    )
    assert content(disturbed / "reel") == content(undisturbed.reel)
