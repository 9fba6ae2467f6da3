import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from splatreel.base import process
from splatreel.base.process import check_address_space, steady_clock

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
