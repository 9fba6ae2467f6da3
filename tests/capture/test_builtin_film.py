import shutil
from pathlib import Path

import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture import builtin_film
from splatreel.capture.builtin_film import copy_film
from splatreel.capture.opening import open_capture


def test_film_is_copied_from_a_read_only_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = shutil.copytree(builtin_film.FILM, tmp_path / "film")
    for file in shipped.iterdir():
        file.chmod(0o444)
    monkeypatch.setattr(builtin_film, "FILM", shipped)
    folder = copy_film(tmp_path / "room")
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == {f.name: f.read_bytes() for f in shipped.iterdir()}
    assert (folder / "splatreel.json").stat().st_mode & 0o200, "`capture sync` writes there"
    capture = open_capture(folder)
    assert (len(capture.cameras), capture.frames, capture.held_out) == (14, 60, ["cam00", "cam07"])


def test_an_existing_film_is_kept_and_other_folders_are_not_overwritten(tmp_path: Path) -> None:
    folder = copy_film(tmp_path / "room")
    before = (folder / "cam03.mp4").stat().st_mtime_ns
    assert copy_film(folder) == folder
    assert (folder / "cam03.mp4").stat().st_mtime_ns == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "mine.txt").write_text("mine")
    with pytest.raises(CaptureError, match="Remove it or choose another"):
        copy_film(tmp_path / "mine")
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["mine.txt"]


def test_a_package_without_the_film_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(builtin_film, "FILM", tmp_path / "film")
    with pytest.raises(CaptureError, match="lacks the film"):
        copy_film(tmp_path / "room")
    assert list(tmp_path.iterdir()) == []
