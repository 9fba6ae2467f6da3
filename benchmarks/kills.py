"""Kill each long verb by SIGKILL at random moments, and continue it with the same command until it ends.

python benchmarks/kills.py 50
"""

import sys
from pathlib import Path

import tyro
from tyro.conf import Positional

from record import ROOT, record

sys.path.insert(0, str(Path(ROOT)))

from tests.kills import NAMES, run


def main(kills: Positional[int] = 50, seed: int = 0, note: str = "") -> None:
    """Kill each command this many times. Exit with 1 if a file differs from that of an undisturbed run."""
    results = run(dict.fromkeys(NAMES, kills), seed)
    commands = {
        found.command: {
            "killed": dict(sorted(found.killed.items())),
            "moments": found.moments,
            "seconds": round(found.seconds, 1),
            "files_that_differ": len(found.different),
            "checkpoints_that_differ": len(found.checkpoints),
        }
        for found in results
    }
    record("kills", {"kills": kills, "seed": seed, "commands": commands}, note)
    sys.exit(any(found.different or found.checkpoints for found in results))


if __name__ == "__main__":
    tyro.cli(main)
