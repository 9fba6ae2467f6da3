"""The size of the JavaScript that a viewer downloads before the first image."""

import gzip
import re

from splatreel.play.player_page import STATIC

MAX_BYTES = 81 * 1024
"""Gzipped, for a reel of the predictive codec. Features that are not always used belong into parts (player/build.mjs)."""
FIRST = ("player.js", "decode-worker.js", "sort-worker.js")


def test_the_first_image_takes_little_javascript() -> None:
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    early = "".join(re.findall(r"<script[^>]*>(.*?)</script>", page, re.S))
    scripts = {name: (STATIC / name).read_bytes() for name in FIRST} | {"index.html": early.encode()}
    sizes = {name: len(gzip.compress(data, 9)) for name, data in scripts.items()}
    assert sum(sizes.values()) <= MAX_BYTES, sizes
