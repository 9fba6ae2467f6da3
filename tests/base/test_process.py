"""Limits of containers and batch jobs, as Linux shows them in files."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from splatreel.base import process, threads
from splatreel.base.process import _private_folder, check_address_space, steady_clock

TAKE_AND_FREE = """
import numpy as np
from benchmarks.resident import resident_of
from splatreel.base.process import give_back_freed_memory, keep_freed_memory

keep_freed_memory()
held = [np.ones(1 << 17) for _ in range(200)]  # a megabyte each
kept = held[::10]
most = resident_of("self")
held.clear()
after = resident_of("self")
give_back_freed_memory()
print(most - after, most - resident_of("self"))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc keeps memory so")
def test_freed_memory_is_kept_until_returned() -> None:
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", TAKE_AND_FREE], capture_output=True, text=True, check=True, cwd=root)
    before, after = map(int, done.stdout.split())
    assert before < 20e6
    assert after > 150e6


def test_steady_clock_ignores_that_the_clock_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    now, clock = time.time(), steady_clock()
    monkeypatch.setattr(time, "time", lambda: now - 1e9)
    first, second = clock(), clock()
    assert now - 1 <= first <= second


def test_durations_are_not_measured_by_a_clock_that_can_be_set() -> None:
    """Only dates of files that are served, and the beginning of `steady_clock`, are times of day."""
    root = Path(__file__).parents[2]
    found = [
        f"{file.relative_to(root / 'src' / 'splatreel')}"
        for file in sorted((root / "src").rglob("*.py"))
        if re.search(r"\btime\.time(_ns)?\b|datetime\.(now|today|utcnow)", file.read_text(encoding="utf-8"))
    ]
    assert found == [
        "base/process.py",
        "play/served_files.py",
        "play/web_app.py",
    ]
    scripts = [*(root / "player" / "src").rglob("*.ts"), *(root / "player" / "packages").glob("*/src/**/*.ts")]
    assert scripts
    assert [file.name for file in scripts if re.search(r"Date\.now|new Date\(", file.read_text("utf-8"))] == []


def test_a_low_limit_of_virtual_memory_is_an_error_before_native_code_aborts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "address_space_limit", lambda: None)
    check_address_space(1 << 60)
    monkeypatch.setattr(process, "address_space_limit", lambda: 1 << 50)
    check_address_space(1 << 30)
    with pytest.raises(MemoryError, match="of virtual memory are left"):
        check_address_space(1 << 51)


GIB = 1 << 30


@pytest.fixture
def mounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty tree of groups."""
    monkeypatch.setattr(process, "MOUNTED", tmp_path / "cgroup")
    monkeypatch.setattr(process, "OWN", tmp_path / "own")
    (tmp_path / "cgroup").mkdir()
    return tmp_path / "cgroup"


def write(place: Path, **files: str) -> None:
    place.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (place / name.replace("__", ".")).write_text(content)


def own(mounted: Path, text: str) -> None:
    (mounted.parent / "own").write_text(text)


def test_version_2_uses_the_tightest_enclosing_limit(mounted: Path) -> None:
    own(mounted, "0::/slurm/job_7/step_0\n")
    write(mounted, cpu__max="max 100000\n", memory__max="max\n")
    write(
        mounted / "slurm" / "job_7",
        cpu__max="250000 100000\n",
        memory__max=f"{4 * GIB}\n",
        memory__current=f"{3 * GIB}\n",
    )
    write(mounted / "slurm" / "job_7", memory__stat=f"anon 5\ninactive_file {GIB}\nactive_file 0\n")
    write(
        mounted / "slurm" / "job_7" / "step_0",
        cpu__max="800000 100000\n",
        memory__max=f"{8 * GIB}\n",
        memory__current="0\n",
    )
    assert process.cpu_quota() == 2.5
    assert process.memory_limit() == 4 * GIB
    assert process.free_memory() == 2 * GIB


def test_version_2_in_a_container_with_root_group(mounted: Path) -> None:
    own(mounted, "0::/../elsewhere\n")
    write(mounted, cpu__max="50000 100000", memory__max=str(GIB), memory__current=str(GIB // 4))
    assert (process.cpu_quota(), process.memory_limit(), process.free_memory()) == (0.5, GIB, GIB - GIB // 4)


def test_version_1_reads_each_controller(mounted: Path) -> None:
    own(mounted, "9:name=systemd:/\n4:memory:/docker/abc\n3:cpu,cpuacct:/docker/abc\n0::/\n")
    write(mounted / "memory", memory__limit_in_bytes="9223372036854771712\n", memory__usage_in_bytes="7\n")
    inside = mounted / "memory" / "docker" / "abc"
    write(inside, memory__limit_in_bytes=f"{2 * GIB}\n", memory__usage_in_bytes=f"{GIB}\n")
    write(inside, memory__stat=f"inactive_file 1\ntotal_inactive_file {GIB // 2}\ntotal_active_file {GIB // 4}\n")
    write(mounted / "cpu,cpuacct", cpu__cfs_quota_us="-1\n", cpu__cfs_period_us="100000\n")
    write(mounted / "cpu,cpuacct" / "docker" / "abc", cpu__cfs_quota_us="300000\n", cpu__cfs_period_us="100000\n")
    assert process.cpu_quota() == 3.0
    assert process.memory_limit() == 2 * GIB
    assert process.free_memory() == 2 * GIB - GIB // 4


@pytest.mark.parametrize("text", ["", "0::/\n", "nonsense", "4:memory:/gone\n1:cpu:/\n"])
def test_missing_limits_are_none(mounted: Path, text: str) -> None:
    own(mounted, text)
    write(mounted, memory__max="what\n", cpu__max="\n")
    write(mounted / "cpu", cpu__cfs_quota_us="-1\n", cpu__cfs_period_us="0\n")
    assert (process.cpu_quota(), process.memory_limit(), process.free_memory()) == (None, None, None)


def test_threads_keep_to_the_quota(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(16)), raising=False)
    own(mounted, "0::/\n")
    threads.available.cache_clear()
    assert threads.available() == 16
    for quota, cores in (("400000 100000", 4), ("50000 100000", 1), ("1750000 100000", 16), ("299000 100000", 2)):
        write(mounted, cpu__max=quota)
        threads.available.cache_clear()
        assert threads.available() == cores
    threads.available.cache_clear()


SOURCE = Path(process.__file__).parents[1]
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
