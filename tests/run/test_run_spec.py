"""Jobs of a run open its videos by the frame tables that the job of the scene has written."""

from pathlib import Path

import pytest

from splatreel.capture import video
from splatreel.capture.opening import CaptureSource
from splatreel.run.jobs import save_frame_tables
from splatreel.run.pipeline import RunSpec
from tests.capture import folders
from tests.run.machines.runs import CONFIG


def test_each_video_is_scanned_once_for_all_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = folders.neu3dv(tmp_path / "capture")
    scanned: list[int] = []
    scan = video.scan
    monkeypatch.setattr(video, "scan", lambda *rest: scanned.append(1) or scan(*rest))
    run_spec = RunSpec(CaptureSource(capture), tmp_path / "out", CONFIG, device="cpu")
    with run_spec.opened() as run:
        assert len(scanned) == len(list(capture.glob("*.mp4")))
        (tmp_path / "out" / "work").mkdir(parents=True)
        save_frame_tables(run)
    scanned.clear()
    with run_spec.opened() as run:  # as each task does
        first = run.capture.cameras[1].name
        assert folders.which(run.capture.read(7, 1, [first])[0, 0]) == (1, 7)
    assert scanned == []
