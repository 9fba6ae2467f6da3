"""The kernel cache in a container whose package folder and home are read-only."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from splatreel.base import compile_cache
from splatreel.base.compile_cache import _private_folder

SOURCE = Path(compile_cache.__file__).parents[1]
ROUND_TRIP = """
import sys, tempfile
if sys.argv[1] == "nothing":
    tempfile.gettempdir = lambda: "/dev/null/nowhere"
import numpy as np
import splatreel
from splatreel.codec.predictive import entropy
assert splatreel.__file__.startswith(sys.argv[2]), splatreel.__file__
print(entropy._bit_length(np.uint64(5)) if hasattr(entropy, "_bit_length") else "?")
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Copy the package to a place where no cache can be written, even by root: a file replaces each `__pycache__` folder."""
    place = tmp_path / "site" / "splatreel"
    ignored = shutil.ignore_patterns("__pycache__", "static")
    shutil.copytree(SOURCE, place, ignore=ignored)
    for folder in [place, *(path for path in place.rglob("*") if path.is_dir())]:
        (folder / "__pycache__").write_bytes(b"")
    return place.parent


def run(package: Path, temporary: Path, how: str) -> subprocess.CompletedProcess[str]:
    temporary.mkdir(exist_ok=True)
    environment = {
        name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
    }
    environment |= {
        "PYTHONPATH": os.pathsep.join([str(package), *sys.path]),
        "HOME": "/dev/null/home",
        "TMPDIR": str(temporary),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-c", ROUND_TRIP, how, str(package)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=temporary)


@pytest.mark.skipif(os.name != "posix", reason="a container")
def test_kernels_are_cached_in_temporary_folder(package: Path, tmp_path: Path) -> None:
    ended = run(package, tmp_path / "tmp", "temporary")
    assert (ended.returncode, ended.stdout) == (0, "3\n"), ended.stderr
    (folder,) = (tmp_path / "tmp").iterdir()
    assert folder.name == f"splatreel-numba-{os.getuid()}"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert any(file.suffix == ".nbc" for file in folder.rglob("*"))


@pytest.mark.skipif(os.name != "posix", reason="a container")
def test_kernels_run_without_cache_if_nothing_is_writable(package: Path, tmp_path: Path) -> None:
    ended = run(package, tmp_path / "tmp", "nothing")
    assert (ended.returncode, ended.stdout) == (0, "3\n"), ended.stderr
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="permissions")
@pytest.mark.parametrize("kind", ["open to others", "a link", "a file"])
def test_folder_writable_by_others_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / f"splatreel-numba-{os.getuid()}"
    if kind == "a link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "theirs")
    elif kind == "a file":
        folder.write_bytes(b"")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    assert _private_folder() is None
