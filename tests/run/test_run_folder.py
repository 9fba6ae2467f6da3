"""Locks on output folders."""

import os
from pathlib import Path

import pytest

from splatreel.base.errors import InUseError
from splatreel.config import Config
from splatreel.run.run_folder import RunLock, lock_reel, run_record
from tests.method.captures import WallCapture
from tests.windows import simulate_windows_locks

pytestmark = pytest.mark.skipif(os.name != "posix", reason="simulates Windows")


def test_windows_refuses_a_second_run_in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows has no fcntl, and its locks are those of msvcrt."""
    simulate_windows_locks(monkeypatch)
    record = run_record(WallCapture(2), Config(), "auto")
    with RunLock(tmp_path / "out", record):
        with pytest.raises(InUseError, match="another process is reconstructing into this folder"):
            RunLock(tmp_path / "out", record).__enter__()
        with RunLock(tmp_path / "out", record, part="chapter0001"):
            pass
    with RunLock(tmp_path / "out", record):
        pass


def test_windows_refuses_a_second_writer_of_a_reel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulate_windows_locks(monkeypatch)
    with lock_reel(tmp_path / "reel"), pytest.raises(InUseError, match="another process is writing this reel"):
        lock_reel(tmp_path / "reel").__enter__()
    assert list((tmp_path / "reel").iterdir()) == []
