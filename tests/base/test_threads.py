"""The number of threads and the thread pool of the kernels."""

import gc
import itertools
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator

import cv2
import pytest

from splatreel.base import threads
from splatreel.base.errors import UsageError
from splatreel.cli.main import main


@pytest.fixture(autouse=True)
def restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name in threads.VARIABLES:
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr(threads, "_limit", None)
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def test_count_is_all_cores_unless_limited() -> None:
    threads.use(None)
    assert threads.count() == threads.available() >= 1


def test_limit_applies_to_loaded_libraries() -> None:
    threads.use(1)
    assert (threads.count(), cv2.getNumThreads()) == (1, 1)


def test_limit_applies_to_torch_where_a_network_has_loaded_it() -> None:
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    try:
        threads.use(1)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


def test_limit_applies_to_libraries_loaded_later() -> None:
    program = (
        "import os; from splatreel.base import threads; threads.use(1)\n"
        "import cv2; print(cv2.getNumThreads(), *(os.environ[name] for name in threads.VARIABLES))"
    )
    assert set(subprocess.check_output([sys.executable, "-c", program], text=True).split()) == {"1"}


@pytest.mark.parametrize("number", [0, -1, 10_000])
def test_limit_rejects_number_out_of_range(number: int) -> None:
    with pytest.raises(
        UsageError, match=rf"--threads {number} is out of range: this process has \d+ cores?\. Choose 1 to"
    ):
        threads.use(number)
    assert threads.count() == threads.available()


def test_threads_option_error_names_the_range(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (["reconstruct", "x", "--out", "y"], ["demo", "--out", "y"], ["evaluate", "x", "y", "--out", "z"]):
        assert main([*verb, "--threads", "10000"]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.startswith("Error: --threads 10000 is out of range")
        assert len(captured.err.splitlines()) == 1


@pytest.mark.parametrize("items", [0, 1, 7, 100])
@pytest.mark.parametrize("workers", [1, 2, 4, 16])
@pytest.mark.parametrize("chunks", [None, 1, 5, 64])
def test_ranges_cover_all_items_once(items: int, workers: int, chunks: int | None) -> None:
    found: list[int] = []
    with threads.limited(workers):
        threads.run_ranges(lambda first, last, into: into.extend(range(first, last)), items, (found,), 1, chunks)
    assert sorted(found) == list(range(items))


def test_few_items_are_not_divided() -> None:
    calls: list[tuple[int, int]] = []
    with threads.limited(4):
        threads.run_ranges(lambda first, last: calls.append((first, last)), 99, (), grain=50)
    assert calls == [(0, 99)]


def test_pool_thread_runs_a_range() -> None:
    """The first range waits for the second one, so it can only end if another thread runs the second one."""
    arrived = threading.Barrier(2)
    with threads.limited(2):
        threads.run_ranges(lambda first, last: arrived.wait(timeout=60), 2, ())
    assert not arrived.broken


def test_pool_raises_error_of_any_range_and_continues() -> None:
    def fail_at(first: int, last: int, bad: int) -> None:
        time.sleep(0.001)
        if first == bad:
            raise ValueError(f"range {bad}")

    with threads.limited(4):
        for bad in range(8):
            with pytest.raises(ValueError, match=f"range {bad}"):
                threads.run_ranges(fail_at, 8, (bad,), 1, 8)
        test_ranges_cover_all_items_once(100, 4, 8)


def test_many_threads_use_the_pool_at_once() -> None:
    totals = [0] * 6
    counter = itertools.count()

    def add(first: int, last: int, into: list[int]) -> None:
        into.append(last - first)
        next(counter)

    def call(k: int) -> None:
        for _ in range(50):
            found: list[int] = []
            threads.run_ranges(add, 40, (found,), 1, 8)
            totals[k] += sum(found)

    with threads.limited(3):
        callers = [threading.Thread(target=call, args=(k,)) for k in range(6)]
        for caller in callers:
            caller.start()
        for caller in callers:
            caller.join()
    assert totals == [50 * 40] * 6


def test_map_returns_results_in_order_and_shares_the_threads() -> None:
    def count_of(number: int) -> tuple[int, int]:
        return number, threads.count()

    with threads.limited(4):
        found = threads.map_parallel(count_of, iter(range(6)))
        assert threads.map_parallel(count_of, []) == []
        assert threads.count() == 4
    assert found == [(0, 1), (1, 1), (2, 1), (3, 1), (4, 2), (5, 4)], "the last items have threads to themselves"


def test_limit_of_a_thread_is_its_own() -> None:
    with threads.limited(4), threads.at_most(3):
        assert threads.count() == 3
        with threads.at_most(0):
            assert threads.count() == 1
        assert threads.count() == 3
        other: list[int] = []
        thread = threading.Thread(target=lambda: other.append(threads.count()))
        thread.start()
        thread.join()
        assert other == [4]


def test_error_waits_for_other_items() -> None:
    """A function that raises leaves no item running, and no later item is begun."""
    begun, ended, arrived = [], [], threading.Barrier(2)

    def work(number: int) -> None:
        begun.append(number)
        if number < 2:
            arrived.wait(timeout=60)
        if number == 0:
            raise KeyboardInterrupt
        time.sleep(0.05)
        ended.append(number)

    with threads.limited(2), pytest.raises(KeyboardInterrupt):
        threads.map_parallel(work, range(50))
    assert sorted(ended) == [number for number in sorted(begun) if number]
    assert len(begun) < 50


def test_nested_regions_leave_no_requests_and_no_arguments_behind() -> None:
    """While all threads are busy with items, requests of kernels within the items must not pile up."""

    class Argument:
        """An object that can be weakly referenced."""

    kept: list[weakref.ref[Argument]] = []

    def item(number: int) -> None:
        with threads.at_most(3):
            for _ in range(100):
                argument = Argument()
                kept.append(weakref.ref(argument))
                threads.run_ranges(lambda first, last, given: None, 9, (argument,), 1, 9)

    with threads.limited(3):
        threads.map_parallel(item, range(12))
    gc.collect()
    assert threads._pool.jobs.qsize() <= threads._pool.size
    assert sum(reference() is not None for reference in kept) == 0


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="only POSIX systems fork")
def test_forked_process_has_its_own_pool() -> None:
    program = (
        "import os; from splatreel.base import threads\n"
        "def run():\n"
        "    found = []\n"
        "    with threads.limited(3): threads.run_ranges(lambda a, b: found.extend(range(a, b)), 30, (), 1, 9)\n"
        "    return sorted(found) == list(range(30))\n"
        "assert run()\n"
        "child = os.fork()\n"
        "if child == 0: os._exit(0 if run() else 3)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))"
    )
    assert (
        subprocess.check_output([sys.executable, "-W", "ignore", "-c", program], text=True, timeout=60).strip() == "0"
    )
