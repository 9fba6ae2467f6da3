"""Play a reel in a loop for ten minutes of its time, and record whether memory grows: benchmarks/player/loop.py --help."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

from http_folder import serve_folder
from playwright.sync_api import Browser, Page, sync_playwright

from run import FLAGS, PATIENCE, STATIC, bundle, chromium

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from record import record

WATCH = """
window.held = {};
const gl = WebGL2RenderingContext.prototype;
for (const kind of ["Texture", "Buffer", "Framebuffer", "VertexArray"]) {
  const [make, free] = [gl[`create${kind}`], gl[`delete${kind}`]];
  const all = new Set();
  window.held[kind] = all;
  gl[`create${kind}`] = function () { const made = make.call(this); all.add(made); return made; };
  gl[`delete${kind}`] = function (made) { all.delete(made); free.call(this, made); };
}
"""
"""Script that counts the objects of all WebGL contexts."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reel", type=Path, help="a reel's folder")
    parser.add_argument("--seconds", type=float, default=600.0, help="of the reel's time")
    parser.add_argument("--rate", type=float, default=16.0, help="speed of playback")
    parser.add_argument("--players", nargs="+", choices=("splatreel", "three"), default=("splatreel", "three"))
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        shutil.copytree(STATIC, folder, dirs_exist_ok=True)
        (folder / "reel").symlink_to(arguments.reel.resolve())
        (folder / "scene.json").write_text(json.dumps({"focal": 150, "poses": []}))
        bundle(folder, arguments.players)
        flags = [*FLAGS, "--disable-gpu", "--js-flags=--expose-gc"]
        browser = driver.chromium.launch(executable_path=chromium(), args=flags)
        with serve_folder(folder) as url:
            for player in arguments.players:
                samples = play(browser, f"{url}{player}.html?width=160&height=120", arguments.seconds, arguments.rate)
                values = {"player": player, "rate": arguments.rate, "samples": samples, "grows": growth(samples)}
                print(json.dumps(values), flush=True)
                if arguments.record is not None:
                    record(f"loop {player}", values, arguments.record)


def play(browser: Browser, address: str, seconds: float, rate: float, samples: int = 11) -> list[dict]:
    """Play a page's reel in a loop for these seconds of its time, and return what it holds at even times."""
    page = browser.new_page(viewport={"width": 160, "height": 120})
    page.set_default_timeout(PATIENCE)
    page.add_init_script(WATCH)
    page.goto(address)
    page.wait_for_function("window.bench || window.failure")
    if failure := page.evaluate("window.failure"):
        raise SystemExit(f"{address} failed: {failure}")
    page.evaluate(PLAY, rate)
    found = []
    for number in range(samples):
        page.wait_for_function("least => window.played() >= least", arg=seconds * number / (samples - 1), polling=250)
        found.append(sample(page))
    page.close()
    return found


PLAY = """rate => {
  const { reel } = window.bench;
  Object.assign(reel, { loop: true, muted: true, playbackRate: rate });
  let [played, last] = [0, reel.currentTime];
  reel.addEventListener("timeupdate", () => {
    const now = reel.currentTime;
    played += now >= last ? now - last : reel.duration - last + now;
    last = now;
  });
  window.played = () => played;
  void reel.play();
}"""
"""Script that plays, and counts the seconds of the reel that passed."""


def sample(page: Page) -> dict:
    """Return the size of the JavaScript heap after a collection, WebGL objects, and decoded groups."""
    return page.evaluate(
        """() => {
          gc();
          const objects = Object.fromEntries(Object.entries(held).map(([kind, all]) => [kind, all.size]));
          const { stream } = window.bench.reel.player;
          const heap_bytes = performance.memory.usedJSHeapSize;
          return { seconds: Math.round(played()), heap_bytes, ...objects, groups: stream.held.length };
        }"""
    )


def growth(samples: list[dict]) -> dict:
    """Return how much the largest value of the last third exceeds that of the second, by what is counted."""
    third = len(samples) // 3
    counted = [name for name in samples[0] if name != "seconds"]
    middle, last = samples[third:-third], samples[-third:]
    return {name: max(one[name] for one in last) - max(one[name] for one in middle) for name in counted}


if __name__ == "__main__":
    main()
