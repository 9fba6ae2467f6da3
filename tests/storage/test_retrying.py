import errno
from pathlib import Path

import pytest

from splatreel.base.errors import StorageError
from splatreel.storage.folder import LocalFolder
from splatreel.storage.retrying import RetryingFolder
from tests.buckets import BreakingFolder


def test_write_is_retried_and_reported(tmp_path):
    told = []
    breaking = BreakingFolder(LocalFolder(tmp_path), breaks={0, 1})
    RetryingFolder(breaking, told.append, pauses=(0.0, 0.0)).write("a", b"1")
    assert LocalFolder(tmp_path).sizes() == {"a": 1}
    assert told == 2 * [f"{tmp_path}/a: could not be written (the line is cut). Retrying."]


def test_retries_end_after_the_last_pause(tmp_path):
    breaking = BreakingFolder(LocalFolder(tmp_path), breaks={0, 1, 2, 3})
    with pytest.raises(StorageError, match="the line is cut"):
        RetryingFolder(breaking, pauses=(0.0, 0.0)).write("a", b"1")
    assert breaking.writes == 3


def test_lasting_errors_are_not_retried(tmp_path):
    (tmp_path / "file").write_text("")
    told = []
    with pytest.raises(StorageError):
        RetryingFolder(LocalFolder(tmp_path / "file"), told.append).read("a", 1)
    assert told == []


def test_full_disk_is_not_retried(tmp_path, monkeypatch):
    def refused(path, data):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", refused)
    told = []
    with pytest.raises(StorageError, match=r"could not be written \(1 bytes\) \(No space left on device\)") as caught:
        RetryingFolder(LocalFolder(tmp_path), told.append).write("a", b"1")
    assert caught.value.lasting
    assert told == []
