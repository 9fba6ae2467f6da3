"""Atomic writes, random temporary names, and removal of files that killed programs left."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base import atomic
from splatreel.base.atomic import lock, move, open_lock, remove, replacing, scratch, sweep, write_bytes
from splatreel.base.errors import GaussiansError
from tests.windows import simulate_windows_locks

KILLED = """
import os, sys
from pathlib import Path
from splatreel.base.atomic import replacing, scratch
with replacing(Path(sys.argv[1]) / "000001.ply") as file, scratch(Path(sys.argv[1]), "capture") as folder:
    file.write_text("half")
    (folder / "cam00.mp4").write_text("half")
    os._exit(9)
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_replacing_keeps_the_old_file_until_the_new_one_is_complete(tmp_path: Path) -> None:
    file = tmp_path / "folder" / "a.txt"
    file.parent.mkdir()
    write_bytes(file, b"old")
    with pytest.raises(ZeroDivisionError), replacing(file) as temporary:
        temporary.write_bytes(bytes(1 // len(file.read_bytes()[3:])))
    assert (names(file.parent), file.read_bytes()) == (["a.txt"], b"old")
    with replacing(file) as temporary:
        temporary.write_bytes(b"new")
    assert (names(file.parent), file.read_bytes()) == (["a.txt"], b"new")


def test_replacing_uses_default_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"")
    write_bytes(tmp_path / "ours", b"")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_temporary_names_are_random_and_links_are_not_followed(tmp_path: Path) -> None:
    victim, file = tmp_path / "victim", tmp_path / "a.txt"
    victim.write_bytes(b"mine")
    (tmp_path / f".a.txt.{os.getpid()}.tmp").symlink_to(victim)  # what the name used to be
    file.symlink_to(victim)
    with replacing(file) as first, replacing(file) as second:
        assert first != second
        first.write_bytes(b"1")
        second.write_bytes(b"2")
    assert victim.read_bytes() == b"mine"
    assert not file.is_symlink()


@pytest.mark.skipif(os.name != "posix", reason="locks of files")
def test_sweep_removes_files_of_killed_programs_only(tmp_path: Path) -> None:
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False).returncode == 9
    (tmp_path / ".mine.tmp").write_text("of somebody else")
    assert len(names(tmp_path)) == 3
    with replacing(tmp_path / "000001.ply") as alive, scratch(tmp_path, "capture") as folder:
        sweep(tmp_path)
        assert names(tmp_path) == sorted([".mine.tmp", alive.name, folder.name])
    assert names(tmp_path) == [".mine.tmp", "000001.ply"]


@pytest.mark.skipif(os.name != "posix", reason="locks of files")
def test_lock_is_exclusive(tmp_path: Path) -> None:
    first, second = (os.open(tmp_path, os.O_RDONLY) for _ in range(2))
    try:
        assert (lock(first), lock(second)) == (True, False)
    finally:
        os.close(first)
        os.close(second)


def test_replacing_accepts_long_names(tmp_path: Path) -> None:
    write_bytes(tmp_path / ("a" * 250), b"whole")
    assert names(tmp_path) == ["a" * 250]


def test_write_error_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(GaussiansError, match=r"file/a\.ply: could not be written"):
        write_bytes(tmp_path / "file" / "a.ply", b"")


def shared(fails: int, winerror: int, act: Callable[..., None]) -> Callable[..., None]:
    """Return a function of `os` that fails as on Windows, `fails` times, while another program has the file open."""
    left = [fails]

    def act_later(*arguments: Any, **options: Any) -> None:
        if left[0]:
            left[0] -= 1
            error = PermissionError(13, "The process cannot access the file")
            setattr(error, "winerror", winerror)  # noqa: B010 - an attribute on Windows only
            raise error
        act(*arguments, **options)

    return act_later


@pytest.mark.parametrize("winerror", [5, 32])
def test_files_that_a_server_has_open_are_replaced_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, winerror: int
) -> None:
    waits: list[float] = []
    monkeypatch.setattr(atomic, "time", SimpleNamespace(sleep=waits.append))
    (tmp_path / "manifest.json").write_bytes(b"old")
    monkeypatch.setattr(os, "replace", shared(3, winerror, os.replace))
    write_bytes(tmp_path / "manifest.json", b"new")
    assert (tmp_path / "manifest.json").read_bytes() == b"new"
    assert waits == sorted(waits)
    assert len(waits) == 3
    monkeypatch.setattr(Path, "unlink", shared(2, winerror, Path.unlink))
    remove(tmp_path / "manifest.json")
    assert names(tmp_path) == []


def test_files_that_stay_open_are_an_error_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(atomic, "time", SimpleNamespace(sleep=waits.append))
    monkeypatch.setattr(os, "replace", shared(1000, 32, os.replace))
    with pytest.raises(GaussiansError, match=r"a\.ply: could not be written"):
        write_bytes(tmp_path / "a.ply", b"")
    assert 5 < sum(waits) < 30
    assert names(tmp_path) == []


def test_other_refusals_are_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "time", SimpleNamespace(sleep=lambda seconds: pytest.fail("waits")))
    with pytest.raises(OSError, match="No such file"):
        move(tmp_path / "missing", tmp_path / "other")


def test_no_other_code_replaces_files() -> None:
    """`move` and `replacing` try again on Windows."""
    source = Path(atomic.__file__).parents[1]
    found = [path for path in source.rglob("*.py") if re.search(r"os\.(replace|rename)\(|\.rename\(", path.read_text())]
    assert found == [Path(atomic.__file__)]


@pytest.mark.skipif(os.name != "posix", reason="simulates Windows")
def test_locks_of_windows_are_exclusive_and_hide_no_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    windows = simulate_windows_locks(monkeypatch)
    first, second = (open_lock(tmp_path / "reel") for _ in range(2))
    try:
        assert (lock(first), lock(second)) == (True, False)
    finally:
        os.close(first)
        os.close(second)
    write_bytes(tmp_path / "a.txt", b"whole")
    assert (tmp_path / "a.txt").read_bytes() == b"whole"
    assert min(windows.positions) > 1 << 30


def test_systems_without_locks_have_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "fcntl", None)
    monkeypatch.setattr(atomic, "msvcrt", None)
    with open(tmp_path / "file", "wb") as file:
        assert lock(file.fileno())
