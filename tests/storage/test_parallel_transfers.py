import subprocess
import sys
import threading
import time

import pytest

from splatreel.storage.parallel_transfers import transfer_in_threads


def test_each_item_is_transferred_once_in_parallel():
    together, seen, most = threading.Barrier(3), [], 0
    working = set()

    def work(item):
        nonlocal most
        working.add(item)
        most = max(most, len(working))
        if item < 3:
            together.wait(120)  # three of them come together, or it breaks
        working.discard(item)
        seen.append(item)

    assert sorted(transfer_in_threads(work, range(20), 3)) == list(range(20))
    assert sorted(seen) == list(range(20))
    assert most == 3


def test_error_stops_new_transfers_and_waits_for_running_ones():
    begun, ended, first = [], [], threading.Event()

    def work(item):
        begun.append(item)
        if item == 0:
            first.wait(120)
            raise ValueError("cut")
        first.set()
        time.sleep(1)  # meanwhile the other thread fails
        ended.append(item)

    with pytest.raises(ValueError, match="cut"):
        list(transfer_in_threads(work, range(50), 2))
    assert begun == [0, 1]
    assert ended == [1]


def test_no_items_need_no_threads():
    assert list(transfer_in_threads(print, [], 4)) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_interrupt_does_not_wait_for_a_hanging_transfer():
    code = "import signal, sys, threading\nfrom splatreel.storage.parallel_transfers import transfer_in_threads\n"
    code += "signal.signal(signal.SIGALRM, signal.default_int_handler); signal.setitimer(signal.ITIMER_REAL, 0.2)\n"
    code += "try: list(transfer_in_threads(lambda _: threading.Event().wait(), range(9), 2))\n"
    code += "except KeyboardInterrupt: sys.exit(130)"
    assert subprocess.run([sys.executable, "-c", code], timeout=300, check=False).returncode == 130
