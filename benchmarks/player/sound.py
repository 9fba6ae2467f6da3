"""Measure the offset between pictures and sound during seeks, rate changes and a stall: benchmarks/player/sound.py --help."""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

from http_folder import Line, serve_folder
from playwright.sync_api import Page, sync_playwright

from run import STATIC, chromium

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.flashes import CLICKS, GOLDEN
from tests.player.pages import PLAYER, wait_for_picture
from tests.player.sync import Sync, listen, measured

from record import record

FLAGS = ["--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
GOAL = 40
"""Milliseconds."""
RATES = (1, 1.5, 0.75, 2, 1, 0.5)
STALL = 2
"""Seconds for which a group is held back."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--size", type=int, nargs=2, default=[480, 320], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--gpu", action="store_true", help="let the browser use the graphics device")
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        shutil.copytree(STATIC, folder, dirs_exist_ok=True)
        shutil.copytree(GOLDEN, folder / "reel")
        browser = driver.chromium.launch(
            executable_path=chromium(), args=FLAGS if arguments.gpu else [*FLAGS, "--disable-gpu"]
        )
        line = Line()
        with serve_folder(folder, line) as url:
            width, height = arguments.size
            page = browser.new_page(viewport={"width": width, "height": height})
            values = summary(run(page, url, line, arguments.seconds)) | {"seconds": arguments.seconds}
        browser.close()
    print(json.dumps(values), flush=True)
    if arguments.record is not None:
        record("player sound", values, arguments.record)


def run(page: Page, url: str, line: Line, seconds: float) -> Sync:
    """Play the golden reel with sound in a loop, with a seek or a rate change every two to four seconds."""
    line.held = re.compile(r"groups/0002")
    page.goto(url + "index.html?autoplay=0")
    wait_for_picture(page)
    page.locator("splat-reel .start").click()
    listen(page)
    page.wait_for_function(f"{PLAYER}.waiting")
    page.wait_for_timeout(1000 * STALL)
    line.released.set()
    chance = random.Random(1)
    end = time.monotonic() + seconds
    for turn in range(1000):
        page.wait_for_timeout(1000 * chance.uniform(2, 4))
        if time.monotonic() > end:
            break
        if turn % 2:
            page.evaluate(f"{PLAYER}.playbackRate = {RATES[turn // 2 % len(RATES)]}")
        else:
            page.evaluate(f"{PLAYER}.currentTime = {chance.uniform(0, 3.7)}")
    return measured(page, CLICKS)


def summary(found: Sync) -> dict:
    """Return offsets in milliseconds; positive if pictures are late."""
    parts = {"pictures": found.pictures, "clock": found.clock}
    return {"clicks": found.clicks, "goal_ms": GOAL} | {name: statistics_of(offsets) for name, offsets in parts.items()}


def statistics_of(offsets: list[float]) -> dict:
    """Return statistics of milliseconds."""
    return {
        "found": len(offsets),
        "within_goal": sum(abs(offset) <= GOAL for offset in offsets),
        "median_ms": round(statistics.median(offsets), 1),
        "deviation_ms": round(statistics.pstdev(offsets), 1),
        "least_ms": round(min(offsets), 1),
        "most_ms": round(max(offsets), 1),
    }


if __name__ == "__main__":
    main()
