"""`splatreel evaluate`, on a scene whose truth is known."""

import json
from pathlib import Path

import pytest

from splatreel.capture import opening
from splatreel.cli.main import main
from splatreel.scene.reel_source import ReelSource
from tests.evaluation import scenes


@pytest.fixture
def reel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    def open_capture(path: Path, **request: object) -> scenes.FilmedCapture:
        assert request["width"] == scenes.WIDTH  # the reel's own, as none is asked for
        assert (request["frames"], request["held_out"]) == ((0, scenes.FRAMES), ["cam00", "cam03"])
        return scenes.capture(path)

    monkeypatch.setattr(opening, "open_capture", open_capture)
    return scenes.write_reel(tmp_path / "run" / "reel", ReelSource(0, ("cam00", "cam03")))


def test_evaluate_prints_summary_and_writes_report(
    reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(reel.parent), "capture", "--out", str(tmp_path / "out")]) == 0
    assert "| cam03 |" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"pictures", "report.html", "report.json", "report.md"}


def test_json_goes_to_standard_output_alone(reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["evaluate", str(reel), "capture", "--out", str(tmp_path), "--cameras", "cam03", "--json"]
    assert main(arguments) == 0
    captured = capsys.readouterr()
    printed = json.loads(captured.out)
    assert printed == json.loads((tmp_path / "report.json").read_text())
    assert [c["name"] for c in printed["cameras"]] == ["cam03"]
    assert "comparing with " in captured.err


def test_unknown_camera_is_refused(reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(reel), "capture", "--out", str(tmp_path), "--cameras", "cam99"]) == 1
    assert "there is no camera 'cam99'" in capsys.readouterr().err
