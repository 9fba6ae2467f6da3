"""Limits of containers and batch jobs, as Linux shows them in files."""

from pathlib import Path

import pytest

from splatreel.base import cgroups, threads

GIB = 1 << 30


@pytest.fixture
def mounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty tree of groups."""
    monkeypatch.setattr(cgroups, "MOUNTED", tmp_path / "cgroup")
    monkeypatch.setattr(cgroups, "OWN", tmp_path / "own")
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
    assert cgroups.cpu_quota() == 2.5
    assert cgroups.memory_limit() == 4 * GIB
    assert cgroups.free_memory() == 2 * GIB


def test_version_2_in_a_container_with_root_group(mounted: Path) -> None:
    own(mounted, "0::/../elsewhere\n")
    write(mounted, cpu__max="50000 100000", memory__max=str(GIB), memory__current=str(GIB // 4))
    assert (cgroups.cpu_quota(), cgroups.memory_limit(), cgroups.free_memory()) == (0.5, GIB, GIB - GIB // 4)


def test_version_1_reads_each_controller(mounted: Path) -> None:
    own(mounted, "9:name=systemd:/\n4:memory:/docker/abc\n3:cpu,cpuacct:/docker/abc\n0::/\n")
    write(mounted / "memory", memory__limit_in_bytes="9223372036854771712\n", memory__usage_in_bytes="7\n")
    inside = mounted / "memory" / "docker" / "abc"
    write(inside, memory__limit_in_bytes=f"{2 * GIB}\n", memory__usage_in_bytes=f"{GIB}\n")
    write(inside, memory__stat=f"inactive_file 1\ntotal_inactive_file {GIB // 2}\ntotal_active_file {GIB // 4}\n")
    write(mounted / "cpu,cpuacct", cpu__cfs_quota_us="-1\n", cpu__cfs_period_us="100000\n")
    write(mounted / "cpu,cpuacct" / "docker" / "abc", cpu__cfs_quota_us="300000\n", cpu__cfs_period_us="100000\n")
    assert cgroups.cpu_quota() == 3.0
    assert cgroups.memory_limit() == 2 * GIB
    assert cgroups.free_memory() == 2 * GIB - GIB // 4


@pytest.mark.parametrize("text", ["", "0::/\n", "nonsense", "4:memory:/gone\n1:cpu:/\n"])
def test_missing_limits_are_none(mounted: Path, text: str) -> None:
    own(mounted, text)
    write(mounted, memory__max="what\n", cpu__max="\n")
    write(mounted / "cpu", cpu__cfs_quota_us="-1\n", cpu__cfs_period_us="0\n")
    assert (cgroups.cpu_quota(), cgroups.memory_limit(), cgroups.free_memory()) == (None, None, None)


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
