"""`splatreel reconstruct --estimate`."""

import re
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.recon.run import machine_speed, memory
from splatreel.recon.run.processor import describe_processor
from tests.capture import folders
from tests.recon.captures import WallCapture


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of videos of three frames; the working directory is the one it lies in, and this machine is that of the costs."""
    source, folder = WallCapture(3), tmp_path / "scene"
    folder.mkdir()
    for camera in source.cameras:
        folders.write_video(folder / f"{camera.name}.mp4", list(source.read(0, 3, [camera.name])[:, 0]))
    np.save(folder / "poses_bounds.npy", folders.llff(source.cameras))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(machine_speed, "_seconds", lambda probe, _: probe.seconds)
    return folder


def estimate(*options: str) -> int:
    return main(["reconstruct", "scene", "--out", "out", "--device", "cpu", "--estimate", *options])


def test_time_and_memory_are_said_and_nothing_is_written(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert estimate("--threads", "1") == 0
    first, *stages, processor, last = capsys.readouterr().out.splitlines()
    said = r"scene: 3 frames of 3 cameras, 48x32, take about (\d+) s from the beginning \(1 thread\), if nothing else runs:"
    found = re.fullmatch(said, first)
    assert found is not None
    parts = [float(line.split()[-2]) for line in stages]
    assert sum(parts) == pytest.approx(float(found[1]), abs=1 + 0.5 * len(parts))
    assert "learning how it moves" in "".join(stages)
    assert processor == f"Processor: {describe_processor()}."
    assert re.fullmatch(r"Memory: about 0\.\d GB at most; [\d.]+ GB are free\.", last)
    assert [path.name for path in scene.parent.iterdir()] == ["scene"]


def test_memory_that_others_have(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "free_memory", lambda: 2 * 10**8)
    assert estimate() == 0
    assert "but only 0.2 GB are free: end other programs.\n" in capsys.readouterr().out


def test_too_little_memory_is_refused(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "total_memory", lambda: 1 << 30)
    assert estimate("--width", "3000") == 1
    refused = capsys.readouterr().err
    width = re.search(r"of 3000x2000 by 3 cameras, 3 frames at a time, take .* --width (\d+) fits\.", refused)
    assert width is not None
    assert main(["reconstruct", "scene", "--out", "out", "--width", "3000"]) == 1
    assert capsys.readouterr().err == refused
    assert estimate("--width", width[1]) == 0
    assert not Path("out").exists()


def test_only_of_this_machine(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert estimate("--job", "scene") == 2
    assert capsys.readouterr().err.startswith("Error: --estimate is of runs on this machine alone. Leave out --job.")
    assert estimate("--workers", "1") == 0
