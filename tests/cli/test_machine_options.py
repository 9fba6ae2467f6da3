"""`splatreel reconstruct --estimate`."""

import re
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from splatreel.base import threads
from splatreel.cli.main import main
from splatreel.run import machine_speed, requirements
from splatreel.run.machine_speed import describe_processor
from splatreel.run.machines import ray_cluster
from tests.capture import folders
from tests.method.captures import WallCapture


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of videos of three frames; the working directory is the one it lies in, and this machine is that of the costs."""
    source, folder = WallCapture(3), tmp_path / "scene"
    folder.mkdir()
    for camera in source.cameras:
        folders.write_video(folder / f"{camera.name}.mp4", list(source.read(0, 3, [camera.name])[:, 0]))
    np.save(folder / "poses_bounds.npy", folders.llff(source.cameras))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(machine_speed, "_seconds", lambda probe: probe.seconds)
    return folder


def estimate(*options: str) -> int:
    return main(["reconstruct", "scene", "--out", "out", "--device", "cpu", "--estimate", *options])


def test_estimate_prints_time_and_memory_and_writes_nothing(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert estimate("--threads", "1") == 0
    first, *stages, processor, last = capsys.readouterr().out.splitlines()
    said = r"scene: 3 frames of 3 cameras, 48x32, take about (\d+) s from the beginning \(1 thread\), if nothing else runs:"
    found = re.fullmatch(said, first)
    assert found is not None
    parts = [float(line.split()[-2]) for line in stages]
    assert sum(parts) == pytest.approx(float(found[1]), abs=1 + 0.5 * len(parts))
    assert "training the motion" in "".join(stages)
    assert processor == f"Processor: {describe_processor()}."
    assert re.fullmatch(r"Memory: about 0\.\d GB at most; [\d.]+ GB are free\.", last)
    assert [path.name for path in scene.parent.iterdir()] == ["scene"]


def test_estimate_reports_too_little_free_memory(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requirements, "free_memory", lambda: 2 * 10**8)
    assert estimate() == 0
    assert "but only 0.2 GB are free: close other programs.\n" in capsys.readouterr().out


def test_too_little_memory_is_refused(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requirements, "total_memory", lambda: 1 << 30)
    assert estimate("--width", "3000") == 1
    refused = capsys.readouterr().err
    width = re.search(r"of 3000x2000 by 3 cameras, 3 frames at a time, take .* --width (\d+) fits\.", refused)
    assert width is not None
    assert main(["reconstruct", "scene", "--out", "out", "--width", "3000"]) == 1
    assert capsys.readouterr().err == refused
    assert estimate("--width", width[1]) == 0
    assert not Path("out").exists()


def test_estimate_of_batch_tasks(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ("--set", "group.length=1", "--set", "group.overlap=0", "--set", "chapter_frames=1")
    assert estimate("--threads", "1", "--job", "chapter", *small) == 0  # of no task of an array
    first, scene_job, chapter, _, task, array = capsys.readouterr().out.splitlines()
    assert first == "scene: 3 frames of 3 cameras, 48x32, 3 chapters. If nothing else runs:"
    assert re.fullmatch(r"  --job scene    about [\d.]+ s", scene_job)
    assert re.fullmatch(r"  --job chapter  about [\d.]+ s a chapter", chapter)
    assert re.fullmatch(r"Each task: 1 thread as fast as here; about 0\.\d GB of memory, such as --mem=1G\.", task)
    assert array.startswith("Array: up to 3 tasks (--array=0-2); with all at once the reel takes about ")
    assert not Path("out").exists()
    assert estimate("--follow") == 2
    assert "--estimate is for complete captures" in capsys.readouterr().err


def test_estimate_on_cluster(scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_limit", None)
    node = {"Alive": True, "Resources": {"CPU": 2, "memory": 64 << 30}}
    monkeypatch.setattr(ray_cluster, "connected", lambda _: nullcontext(SimpleNamespace(nodes=lambda: [node, node])))
    small = ("--set", "group.length=1", "--set", "group.overlap=0", "--set", "chapter_frames=1")
    assert estimate("--cluster", "auto", *small) == 0
    shown = capsys.readouterr().out
    assert re.search(r"the scene      about [\d.]+ s on a node, with 2 threads\n", shown)
    assert re.search(r"all            about [\d.]+ s, with 3 of 3 chapters at a time\n", shown)
    assert re.search(r"Memory: about 0\.\d GB for each of them\.\n", shown)
