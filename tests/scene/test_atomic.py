"""Atomic writes, random temporary names, and removal of files that killed programs left."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from splatreel.errors import GaussiansError
from splatreel.scene.atomic import lock, replacing, scratch, sweep, write_bytes

KILLED = """
import os, sys
from pathlib import Path
from splatreel.scene.atomic import replacing, scratch
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
