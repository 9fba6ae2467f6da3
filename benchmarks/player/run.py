"""Draw one scene with this player and with others in one browser: python benchmarks/player/run.py --help."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from http_folder import serve_folder
from playwright.sync_api import Browser, Playwright, sync_playwright

from scene import read_points, write_scene

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from record import record

HERE = Path(__file__).parent
STATIC = HERE.parents[1] / "src" / "splatreel" / "play" / "static"
PLAYERS = ("splatreel", "three", "playcanvas-reel", "spark", "playcanvas", "gaussian-splats-3d")
"""Ours first: the element, the object of three.js and the script of PlayCanvas. The others draw static splats."""
PACKAGES = HERE.parents[1] / "player" / "packages"
OURS = {"three": "three", "playcanvas-reel": "playcanvas"}
"""Pages of our objects in other engines, each with the package and the engine: npm run build --workspaces, in player/."""
PATIENCE = 900_000
"""Milliseconds for a page to load or to draw, since other programs may use the machine."""
WATCH = """<script>
for (const name of ["error", "unhandledrejection"]) addEventListener(name, (e) => (window.failure = String(e.message ?? e.reason)));
</script>"""
"""Script that keeps the failure of a page, so that nobody waits for it."""
FLAGS = [
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-frame-rate-limit",
    "--disable-gpu-vsync",
]
"""Pictures come as fast as they are drawn, not 60 a second at most."""
DEVICES = (
    [],
    ["--use-angle=vulkan", "--enable-features=Vulkan", "--disable-vulkan-surface"],
    ["--use-gl=angle", "--use-angle=gl-egl"],
)
"""Ways to reach the graphics device, in the order they are tried; the last two need no display."""
RENDERER = """() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  return gl ? gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER) : "nothing";
}"""
"""Script that names what draws."""
SOFTWARE = re.compile("nothing|SwiftShader|llvmpipe|softpipe|Software|Basic Render", re.IGNORECASE)
"""Names of what draws without a graphics device."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("points", type=Path, help="npz with means3d [N, 3] and colors [N, 3] of 0..255, or a 3DGS PLY")
    parser.add_argument("--counts", type=int, nargs="+", default=[30_000, 138_000])
    parser.add_argument("--size", type=int, nargs=2, default=[640, 360], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--pictures", type=int, default=30, help="poses of the orbit")
    parser.add_argument("--rounds", type=int, default=3, help="how often all players take their turn")
    parser.add_argument("--players", nargs="+", choices=PLAYERS, default=PLAYERS)
    parser.add_argument(
        "--gpu", action="store_true", help="let the browser use the graphics device; else it draws by software"
    )
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        shutil.copytree(STATIC, folder, dirs_exist_ok=True)
        bundle(folder, arguments.players)
        browser, renderer = launch(driver, arguments.gpu)
        for count in arguments.counts:
            truth = write_scene(read_points(arguments.points), count, folder, arguments.size, arguments.pictures)
            with serve_folder(folder) as url:
                results = turns(browser, url, arguments, truth)
                for player in results:
                    values = {"points": count, "player": player, "size": arguments.size, "renderer": renderer}
                    values |= summary(results, player)
                    print(json.dumps(values), flush=True)
                    if arguments.record is not None:
                        record(f"frame times {player}", values, arguments.record)


def launch(driver: Playwright, gpu: bool) -> tuple[Browser, str]:
    """Return a browser that draws with the graphics device or by software, and the name of what draws."""
    tried = []
    for ways in DEVICES if gpu else [["--disable-gpu"]]:
        flags = [*FLAGS, "--ignore-gpu-blocklist", *ways] if gpu else [*FLAGS, *ways]
        browser = driver.chromium.launch(executable_path=chromium(), args=flags)
        page = browser.new_page()
        renderer = page.evaluate(RENDERER)
        page.close()
        if not gpu or not SOFTWARE.search(renderer):
            return browser, renderer
        browser.close()
        tried.append(renderer)
    raise SystemExit(
        f"The browser reaches no graphics device; it would draw with {'; '.join(dict.fromkeys(tried))}. "
        "Install the device's driver for Vulkan or EGL, or leave --gpu away."
    )


def chromium() -> str | None:
    """Return the browser of this machine; None for Playwright's own."""
    return next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)


def bundle(folder: Path, players: list[str]) -> None:
    """Bundle each player into one script, as its users would."""
    for player in players:
        command = [
            HERE / "node_modules/.bin/esbuild",
            HERE / f"pages/{player}.js",
            "--bundle",
            "--minify",
            "--format=esm",
        ]
        if engine := OURS.get(player):  # one engine for the page and the object
            package = PACKAGES / engine / "dist" / f"{engine}.js"
            command += [f"--alias:@splatreel/{engine}={package}", f"--alias:{engine}={HERE / 'node_modules' / engine}"]
        subprocess.run([*command, "--log-level=error", f"--outfile={folder / player}.page.js"], check=True)
        module = '<script type="module" src="player.js"></script>' if player == "splatreel" else ""
        page = f'<!doctype html><body style="margin: 0">{WATCH}{module}'
        page += f'<script type="module" src="{player}.page.js"></script>'
        (folder / f"{player}.html").write_text(page)


def turns(browser: Browser, url: str, arguments: argparse.Namespace, truth: Path) -> dict[str, list[dict]]:
    """Return each player's results. Players take turns, so that other load on the machine affects all of them."""
    results = {player: [] for player in arguments.players}
    for _ in range(arguments.rounds):
        for player in results:
            results[player].append(measure(browser, url, player, arguments.size, truth))
    return results


def summary(results: dict[str, list[dict]], player: str) -> dict:
    """Return the round with the smallest median, which was disturbed least, and the ratio to the first player by rounds."""
    rounds = [result["frame_ms"] for result in results[player]]
    first = [result["frame_ms"] for result in next(iter(results.values()))]
    ratio = statistics.median(own / other for own, other in zip(rounds, first, strict=True))
    best = min(results[player], key=lambda result: result["frame_ms"])
    return best | {"frame_ms_of_rounds": rounds, "ratio": round(ratio, 2)}


def measure(browser: Browser, url: str, player: str, size: list[int], truth: Path) -> dict:
    """Return milliseconds of a finished frame (median and minimum) and of a sort, and the PSNR against the CPU's image."""
    import numpy as np
    from PIL import Image

    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(PATIENCE)
    page.goto(f"{url}{player}.html?width={size[0]}&height={size[1]}")
    page.wait_for_function("window.bench || window.failure")
    if failure := page.evaluate("window.failure"):
        raise SystemExit(f"The page of {player} failed: {failure}")
    poses = json.loads((truth.parent / "scene.json").read_text())["poses"]
    page.evaluate("pose => window.bench.settle(pose)", poses[0])
    shot = truth.parent / f"{player}.png"
    page.screenshot(path=shot)
    difference = np.asarray(Image.open(shot).convert("RGB"), np.float32) / 255 - np.load(truth)
    times = page.evaluate("window.bench.measure()")
    sorts = page.evaluate("window.bench.sorts()")
    page.close()
    return {
        "frame_ms": round(statistics.median(times), 2),
        "fastest_frame_ms": round(min(times), 2),
        "sort_ms": round(statistics.median(sorts), 2) if sorts else None,
        "psnr": round(float(-10 * np.log10(np.mean(difference**2))), 2),
    }


if __name__ == "__main__":
    main()
