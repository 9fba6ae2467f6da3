"""Measure the time to the first frame and of a seek over a slow network: benchmarks/player/start.py --help."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

from http_folder import Line, serve_folder
from playwright.sync_api import Browser, Page, sync_playwright

from run import FLAGS, STATIC, chromium

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from record import record

WATCH = """
window.marks = {};
const mark = (name) => (window.marks[name] ??= Math.round(performance.now()));
/** Wait for pictures that are on their way: reading a pixel does. */
const finish = () => {
  const canvas = reel().shadowRoot.querySelector('canvas');
  canvas.getContext('webgl2').readPixels(0, 0, 1, 1, 6408, 5121, new Uint8Array(4));
};
const reel = () => document.querySelector('splat-reel');
const posters = () => [...document.querySelectorAll('main > img'), ...(reel()?.shadowRoot?.querySelectorAll('img.poster') ?? [])];
let before = 0;
const look = () => {
  const player = reel()?.player;
  const pictures = player?.stage?.pictures ?? 0;
  if (player?.manifest) mark('manifest');
  if (posters().some((image) => image.complete && image.naturalWidth > 0 && image.checkVisibility())) mark('poster');
  if (player?.stream?.loadedLayers.length) mark('layer');
  if (player?.stream?.held.length) mark('group');
  if (pictures > before && !window.marks.whole) {
    finish();
    mark('something');
    if (player.canPlay) mark('whole');
  }
  before = pictures;
  requestAnimationFrame(look);
};
requestAnimationFrame(look);
window.seek = (seconds) => new Promise((resolve) => {
  const element = reel();
  const began = performance.now();
  let sought = false;
  element.addEventListener('seeked', () => (sought = true), { once: true });
  element.currentTime = seconds;
  let pictures = element.player.stage.pictures;
  const wait = () => {
    if (!sought) pictures = element.player.stage.pictures;
    else if (element.player.stage.pictures > pictures) return finish(), resolve(Math.round(performance.now() - began));
    requestAnimationFrame(wait);
  };
  wait();
});
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reel", type=Path, help="a reel's folder")
    parser.add_argument("--size", type=int, nargs=2, default=[640, 360], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--mbit", type=float, default=20.0, help="of the network to the first picture, Mbit/s")
    parser.add_argument("--latency", type=float, default=0.02, help="of every answer of it, seconds")
    parser.add_argument("--times", type=int, default=5, help="how often each is measured")
    parser.add_argument("--gpu", action="store_true", help="let the browser use the graphics device")
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    manifest = json.loads((arguments.reel / "manifest.json").read_text())
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        shutil.copytree(STATIC, folder, dirs_exist_ok=True)
        (folder / "reel").symlink_to(arguments.reel.resolve())
        flags = FLAGS if arguments.gpu else [*FLAGS, "--disable-gpu"]
        browser = driver.chromium.launch(executable_path=chromium(), args=flags)
        runs = [once(browser, folder, manifest, arguments) for _ in range(arguments.times)]
        browser.close()
    values = {name: statistics.median(run[name] for run in runs) for name in runs[0]}
    values |= {"mbit": arguments.mbit, "latency_ms": round(1000 * arguments.latency), "size": arguments.size}
    print(json.dumps(values | {"runs": runs}), flush=True)
    if arguments.record is not None:
        record("player start", values, arguments.record)


def once(browser: Browser, folder: Path, manifest: dict, arguments: argparse.Namespace) -> dict:
    """Return milliseconds. Each page has caches of its own."""
    times = {}
    with serve_folder(folder, Line(arguments.mbit, arguments.latency)) as url:
        page = opened(browser, url, arguments)
        times |= {f"{name}_ms": value for name, value in page.evaluate("window.marks").items()}
        page.context.close()
    line = Line()
    groups = manifest["groups"]
    last = groups[-1]
    line.held = None if len(groups) == 1 else re.compile(re.escape(last["uri"].split("/")[-1]) + "$")
    with serve_folder(folder, line) as url:
        page = opened(browser, url, arguments)
        fps = manifest["fps"]
        times["seek_ms"] = page.evaluate(f"window.seek({(groups[0]['frames'] // 2) / fps})")
        if line.held:
            late = (last["first_frame"] + last["frames"] - 2) / fps
            page.evaluate(f"window.sought = window.seek({late}), 0")
            line.released.set()
            times["seek_outside_ms"] = page.evaluate("window.sought")
        page.context.close()
    return times


def opened(browser: Browser, url: str, arguments: argparse.Namespace) -> Page:
    """Return a page that has drawn its first whole frame."""
    width, height = arguments.size
    page = browser.new_context(viewport={"width": width, "height": height}).new_page()
    page.add_init_script(WATCH)
    page.goto(url + "index.html?autoplay=0")
    page.wait_for_function("window.marks.whole", timeout=120_000)
    return page


if __name__ == "__main__":
    main()
