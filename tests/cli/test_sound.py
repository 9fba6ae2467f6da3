"""Sound on the command line: what a capture has, and what is refused before anything is trained."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.capture_sound import RATE, read_sound
from splatreel.cli.main import main
from tests import flashes
from toyroom.capture import make_capture


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("room") / "room", width=16, height=16, frames=20)


def test_check_reports_the_soundtrack(room: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "check", str(room), "--quick"]) == 1, "16 pixels show nothing that cameras agree on"
    assert "sound: camera cam00 (the loudest without distortion)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ("cam99", "--sound cam99: is neither a file nor such a camera"),
        ("splatreel.json", "its sound cannot be decoded"),
    ],
)
def test_missing_sound_is_refused_before_training(
    room: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    wanted: str,
    said: str,
) -> None:
    monkeypatch.chdir(room)
    assert main(["reconstruct", ".", "--out", str(tmp_path / "out"), "--sound", wanted]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert "group 1" not in error


def test_film_of_some_frames_has_their_sound(tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    assert main(["export", str(flashes.GOLDEN), "--out", str(film), "--frames", "100:150", "--width", "32"]) == 0
    found = flashes.onsets(np.concatenate(list(read_sound(film, 1, RATE))))
    np.testing.assert_allclose(found + 2, flashes.CLICKS[2:3], atol=2e-3)
