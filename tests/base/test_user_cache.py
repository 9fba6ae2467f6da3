from pathlib import Path

import pytest

from splatreel.base import user_cache


def test_files_are_found_again_and_may_be_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_cache, "folder", lambda: tmp_path / "cache" / "splatreel")
    assert user_cache.load("kernels/one") is None
    user_cache.save("kernels/one", b"code")
    assert user_cache.load("kernels/one") == b"code"
    user_cache.save("kernels/one", b"newer")
    assert user_cache.load("kernels/one") == b"newer"


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_bytes(b"")
    monkeypatch.setattr(user_cache, "folder", lambda: tmp_path / "file" / "splatreel")
    user_cache.save("one", b"code")
    assert user_cache.load("one") is None


@pytest.mark.parametrize(
    ("platform", "variable", "expected"),
    [
        ("linux", "XDG_CACHE_HOME", "splatreel"),
        ("win32", "LOCALAPPDATA", "splatreel"),
        ("darwin", "HOME", "Library/Caches/splatreel"),
    ],
)
def test_the_folder_is_the_one_of_the_system(
    platform: str, variable: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", platform)
    monkeypatch.setenv(variable, str(tmp_path))
    assert user_cache.folder() == tmp_path / expected
