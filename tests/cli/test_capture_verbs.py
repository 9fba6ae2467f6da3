"""Output of `splatreel capture calibrate` and `capture sync`; tests/capture tests the methods."""

from pathlib import Path

import pytest

from splatreel.calibration import calibrate, sync
from splatreel.capture.sidecar import SyncEvidence
from splatreel.cli.main import main
from tests.capture import folders


def test_calibrate_reports_placed_left_out_and_doubtful_cameras(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[Path, Path | None]] = []

    def found(path: Path, progress: object, also: Path | None, *_: object) -> calibrate.Calibration:
        asked.append((path, also))
        return calibrate.Calibration({"a": 900, "b": 12, "c": 400}, ["d"], 0.456, 3, ["HLG is converted"])

    monkeypatch.setattr(calibrate, "calibrate", found)
    assert main(["capture", "calibrate", "phones", "--also", "photos"]) == 0
    assert asked == [(Path("phones"), Path("photos"))]
    said = capsys.readouterr().out
    assert "phones/sparse/0: 3 cameras, placed alike at 3 moments; points are off by 0.46 pixels" in said
    assert "  HLG is converted\n" in said
    assert "left out, since they overlap the others too little to be certain: d" in said
    assert "doubtful, since they see few points: b (12)" in said


def test_calibrate_of_too_few_videos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders.write_video(tmp_path / "phone.mp4", [folders.frame(0, 0)])
    assert main(["capture", "calibrate", str(tmp_path)]) == 1
    assert "at least 3 are needed" in capsys.readouterr().err


def test_sync_reports_the_start_of_each_video(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[bool] = []

    def found(path: Path, progress: object, leave_out: object, dry_run: bool) -> sync.Synchronization:
        asked.append(dry_run)
        evidence = {"b": SyncEvidence("a", "sound", 5.25, 2.0)}
        return sync.Synchronization({"a": 0.0, "b": 1.23456}, {"b": 0.999}, evidence, 1 / 30, 60, True, ["a note"])

    monkeypatch.setattr(sync, "synchronize", found)
    assert main(["capture", "sync", "phones", "--dry-run"]) == 0
    assert asked == [True]
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  a 0.000",
        "  b 1.235, by sound with a: fits 5.2 times as well as at any other time (2 is needed)",
        "    its clock is 0.100 % too slow, which is corrected",
        "  a note",
        "--dry-run: phones/splatreel.json was not changed.",
    ]


def test_sync_names_videos_that_are_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nothing = sync.Synchronization({"a": 0.0}, {}, {}, 1 / 30, 60, True, [], True)
    monkeypatch.setattr(sync, "synchronize", lambda *_: nothing)
    (tmp_path / "cam04.R3D").touch()
    assert main(["capture", "sync", str(tmp_path)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert "  not read: cam04.R3D. Convert .r3d to .mp4 or .mov, with the same times of the frames" in said
    assert said[-1].startswith("The videos are in step already, to half a frame.")


def test_sync_of_one_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders.write_video(tmp_path / "phone.mp4", [folders.frame(0, 0)])
    assert main(["capture", "sync", str(tmp_path)]) == 1
    assert "at least two are needed to synchronize" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("note", "said"),
    [
        ('{"starts": {"cam00": -1}}', "starts is {'cam00': -1}, expected seconds of 0 or more by camera"),
        ('{"sync": {"cam00": {"clear": 2}}}', "sync of cam00 is {'clear': 2}, expected what `capture sync` writes"),
        ('{"rates": {"cam00": 2}}', "rates is {'cam00': 2}, expected numbers of 0.9 to 1.1 by camera"),
        ('{"calibration_failed": 3}', "calibration_failed is 3, expected a sentence"),
    ],
)
def test_impossible_start_in_note_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], note: str, said: str
) -> None:
    scene = folders.neu3dv(tmp_path / "scene", count=4, frames=2)
    (scene / "splatreel.json").write_text(note)
    assert main(["capture", "check", str(scene), "--quick"]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert str(scene / "splatreel.json") in error


def test_film_writes_the_built_in_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = tmp_path / "room"
    assert main(["capture", "film", str(room)]) == 0
    said = capsys.readouterr()
    assert f"{room}: 14 cameras and 60 frames of 256 x 192 pixels, with sound" in said.out
    assert "cam00, cam07" in said.out
    assert main(["capture", "film", str(tmp_path)]) == 1
    assert "is not the built-in capture" in capsys.readouterr().err
