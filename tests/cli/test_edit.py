"""`splatreel edit`, which makes a new reel of a finished one."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from splatreel.cli.main import main
from splatreel.edit.operations import OPERATIONS
from splatreel.play.timeline import open_reel
from tests.edit.clips import write_reel
from tests.files import contents
from tests.golden import GOLDEN


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel", 2)


def test_operations_make_a_new_reel(reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(reel)
    out = tmp_path / "out"
    assert main(["edit", str(reel), "cut=0:6", "move=-1,0,0", "--title", "Part", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "12 frames, 1.20 s" in said
    assert "6 frames, 0.60 s" in said
    assert f"splatreel serve {out}" in said
    assert open_reel(out).manifest.presentation.title == "Part"
    assert main(["verify", str(out)]) == 0
    assert contents(reel) == before


def test_edit_list_comes_before_the_operations(reel: Path, tmp_path: Path) -> None:
    file = tmp_path / "edits.json"
    file.write_text(json.dumps({"format": "splatreel-edit", "version": 1, "operations": ["cut=6:12"]}))
    assert main(["edit", str(reel), "cut=0:2", "--list", str(file), "--out", str(tmp_path / "a")]) == 0
    assert main(["edit", str(reel), "cut=6:8", "--out", str(tmp_path / "b")]) == 0
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_wrong_use_is_explained(reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken = tmp_path / "taken"
    shutil.copytree(reel, taken)
    cases = [
        (["edit", str(reel), "reverse"], 2, "Name its folder with --out"),
        (["edit", str(reel)], 2, "Nothing to change"),
        (["edit", str(reel), "--out", str(tmp_path / "x")], 2, "Nothing to change"),
        (["edit", str(reel), "reverse", "--out", str(taken)], 2, "exists already"),
        (["edit", str(tmp_path / "none"), "reverse", "--out", str(tmp_path / "x")], 1, "none"),
        (["edit", str(reel), "crop=cone", "--out", str(tmp_path / "x")], 2, "crop=cone: Give box:"),
        (["edit", "https://example.invalid/reel", "--title", "x"], 2, "is not on this machine"),
        (["edit", str(reel), "--list", str(tmp_path / "no.json"), "--out", str(tmp_path / "x")], 2, "no.json"),
    ]
    for arguments, code, message in cases:
        assert main(arguments) == code, arguments
        assert message in capsys.readouterr().err, arguments
    assert contents(taken) == contents(reel)


def test_help_names_every_operation(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["edit", "--help"])
    text = capsys.readouterr().out
    for name in OPERATIONS:
        assert name in text


def test_reels_of_the_papers_codec_are_edited(tmp_path: Path) -> None:
    assert main(["edit", str(GOLDEN), "scale=2", "--out", str(tmp_path / "out")]) == 0
    a, b = open_reel(tmp_path / "out"), open_reel(GOLDEN)
    for seconds in (0.0, 0.25):
        assert len(a.at(seconds)) == len(b.at(seconds))


@pytest.mark.kill
def test_killed_edit_leaves_nothing_and_starts_again(reel: Path, tmp_path: Path) -> None:
    out = tmp_path / "place" / "out"
    arguments = [sys.executable, "-m", "splatreel", "edit", str(reel), "reverse", "--out", str(out)]
    for _ in range(3):
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ)
        until = time.monotonic() + 60
        while time.monotonic() < until and process.poll() is None:
            if any(out.parent.glob(".out.*/groups/*")) if out.parent.exists() else False:
                break
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert process.returncode == 0 or not out.exists()
        shutil.rmtree(out, ignore_errors=True)
    assert main(arguments[3:]) == 0
    assert main(["verify", str(out)]) == 0
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_edit_that_is_complete_already_says_so(reel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A command may be killed just after it finished. Another reel of the same length is not taken for it."""
    out = tmp_path / "out"
    assert main(["edit", str(reel), "cut=0:6", "--out", str(out)]) == 0
    before = contents(out)
    assert main(["edit", str(reel), "cut=0:6", "--out", str(out)]) == 0
    assert f"{out}: was complete already, with the same content" in capsys.readouterr().out
    for operations in (["cut=0:5"], ["cut=0:6", "move=1,0,0"]):
        assert main(["edit", str(reel), *operations, "--out", str(out)]) == 2
        assert "exists already" in capsys.readouterr().err
    assert contents(out) == before


def test_edit_of_texts_deletes_what_a_killed_one_left(reel: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(reel, copy)
    (copy / f".manifest.json.{'0' * 16}.tmp").write_text("{}")
    assert main(["edit", str(copy), "--title", "New"]) == 0
    assert not list(copy.glob(".*"))


def test_hundreds_of_operations_need_no_deep_call_stack(reel: Path, tmp_path: Path) -> None:
    operations = ["move=0.01,0,0", "exposure=0", "cut=0:12"] * 300
    assert main(["edit", str(reel), *operations, "--out", str(tmp_path / "out")]) == 0
    assert main(["verify", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize("value", ["0:" + "9" * 5000, "9" * 5000 + ":", "0:" + "9" * 5000 + "s", "0:\u0663"])
def test_frames_of_thousands_of_digits_are_refused(
    reel: Path, tmp_path: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["edit", str(reel), f"cut={value}", "--out", str(tmp_path / "out")]) == 2
    assert "Error: cut=" in capsys.readouterr().err


@pytest.mark.parametrize("more", [["reverse", "--out", "out"], ["--title", "New"]])
def test_reel_that_is_still_written_is_refused(
    reel: Path, tmp_path: Path, more: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(reel, "live")
    manifest = json.loads(Path("live/manifest.json").read_text())
    Path("live/manifest.json").write_text(json.dumps(manifest | {"live": True}))
    before = contents(Path("live"))
    assert main(["edit", "live", *more]) != 0
    assert "is still being written" in capsys.readouterr().err
    assert contents(Path("live")) == before
    assert not Path("out").exists()
