"""Plot the bytes that a player downloads for each second of a reel.

python examples/plot_bytes.py out/demo/reel

A group's file counts at the second in which the group starts, and a static layer at the second in which it first appears.
"""

from collections import Counter

import tyro
from tyro.conf import Positional

import splatreel

WIDTH = 60
"""Characters of the longest bar."""


def bytes_per_second(reel: str) -> list[int]:
    """Return the bytes that become necessary in each second of a reel."""
    timeline = splatreel.open_reel(reel)
    found: Counter[int] = Counter()
    for entry in (*timeline.manifest.layers, *timeline.manifest.groups):
        found[int(entry.first_frame / timeline.fps)] += entry.bytes
    return [found[second] for second in range(max(found) + 1)]


def main(reel: Positional[str]) -> None:
    """Print a bar for each second.

    Args:
        reel: Folder or URL of the reel.
    """
    counts = bytes_per_second(reel)
    for second, count in enumerate(counts):
        print(f"{second:5} s {count / 1000:9.1f} kB {'#' * round(WIDTH * count / max(counts))}")
    print(f"mean: {8 * sum(counts) / len(counts) / 1000:.0f} kbit/s")


if __name__ == "__main__":
    tyro.cli(main)
