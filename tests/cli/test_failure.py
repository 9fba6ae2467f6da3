"""Texts and exit codes of errors."""

import errno
import os
import sys
from pathlib import Path

import pytest

from splatreel.base.errors import ReelError, SplatreelError
from splatreel.cli.failure import explain
from splatreel.cli.main import main


def caused(error: BaseException, cause: BaseException) -> BaseException:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_behind_an_error_of_ours_keeps_its_remedy(code: int) -> None:
    full = OSError(code, "No space left on device")
    for error in (caused(ReelError("a.json: could not write 3 bytes."), full), full):
        found = explain(error, ["edit", "a"])
        assert found is not None
        text, exit_code = found
        assert exit_code == 1
        assert "the disk is full" in text
        assert "free some space, then run\n  splatreel edit a" in text
    assert "a.json" in (explain(caused(ReelError("a.json: x."), full), []) or ("", 0))[0]


def test_other_errors_of_ours_are_no_full_disk() -> None:
    error = caused(SplatreelError("a: cannot be read."), OSError(errno.EIO, "Input/output error"))
    assert explain(error, []) == ("Error: a: cannot be read.", 1)


def test_deep_call_stack_is_no_damaged_cache() -> None:
    def deeper() -> None:
        deeper()

    with pytest.raises(RecursionError) as caught:
        deeper()
    assert explain(caught.value, []) is None


@pytest.mark.skipif(sys.platform != "linux", reason="a deleted current folder")
def test_deleted_current_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(["info", "reel"]) == 1
    assert "Traceback" not in capsys.readouterr().err
    found = explain(FileNotFoundError(errno.ENOENT, "No such file or directory"), ["info", "reel"])
    assert found is not None
    assert "the current folder has been deleted" in found[0]
    monkeypatch.chdir(tmp_path)


def test_name_that_cannot_be_written_into_a_text_is_explained() -> None:
    with pytest.raises(UnicodeEncodeError) as caught:
        os.fsdecode(b"f\xff").encode()
    found = explain(caught.value, [])
    assert found is not None
    assert "is not UTF-8. Rename it" in found[0]
    with pytest.raises(UnicodeEncodeError) as caught:
        "\xe9".encode("ascii")
    assert explain(caught.value, []) is None


def test_output_that_looks_like_an_option_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["edit", "reel", "reverse", "--out", "-x"]) == 2
    assert "Write --out=./-x." in capsys.readouterr().err
