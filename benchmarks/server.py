"""`splatreel serve` under attack: memory of its process, and how long others wait meanwhile.

Loopback and Linux only; it takes about a minute.

    PYTHONPATH=. python benchmarks/server.py [--seconds 5] [--note TEXT]

Each attack (tests/play/attacks.py) meets a server of its own and comes from a process of its own; another process asks for the
manifest every 20 ms. Appends to benchmarks/results.jsonl.
"""

import argparse
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from tests.play import attacks
from tests.play.attacks import ATTACKS, Served

from record import record


def attack(name: str, address: tuple[str, int], seconds: float, opened: Connection) -> None:
    peers = getattr(attacks, name)(address)
    opened.send(len(peers))
    attacks.trickle(peers, seconds)


def waits(victim: Served, goes_on) -> list[float]:
    """Seconds that each request took while `goes_on` says so; infinite for those that failed."""
    found = []
    while goes_on():
        try:
            found.append(victim.ask())
        except OSError:
            found.append(float("inf"))
        time.sleep(0.02)
    return found


def measure(reel: Path, name: str | None, seconds: float) -> dict:
    with attacks.served(reel) as victim:
        idle = victim.peak()
        if name is None:
            end = time.monotonic() + seconds
            found, peers = waits(victim, lambda: time.monotonic() < end), 0
        else:
            receiving, sending = multiprocessing.Pipe(duplex=False)
            attacker = multiprocessing.Process(target=attack, args=(name, victim.address, seconds, sending))
            attacker.start()
            found = waits(victim, attacker.is_alive)
            peers = receiving.recv()
        peak = victim.peak()
    answered = np.array(found)
    return {
        "attack": name or "none",
        "connections": peers,
        "idle_bytes": idle,
        "above_idle_bytes": peak - idle,
        "requests": len(found),
        "failed": int(np.isinf(answered).sum()),
        "ms_median": round(1000 * float(np.median(answered[np.isfinite(answered)])), 1),
        "ms_99": round(1000 * float(np.percentile(answered[np.isfinite(answered)], 99)), 1),
        "ms_longest": round(1000 * float(answered[np.isfinite(answered)].max()), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5, help="that each attack is held")
    parser.add_argument("--note", default="")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        reel = attacks.large_reel(Path(folder))
        for name in (None, *(attack.__name__ for attack in ATTACKS)):
            values = measure(reel, name, options.seconds)
            record("server", values, options.note)
            print(values, flush=True)


if __name__ == "__main__":
    main()
