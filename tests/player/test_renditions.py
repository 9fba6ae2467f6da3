"""Renditions: the choice on a changing network, and the menu."""

import hashlib
import json
import threading
import time
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page
from safetensors import safe_open
from safetensors.numpy import save

from splatreel.play.server import Server
from tests.golden import PREDICTIVE
from tests.player.pages import PLAYER, wait_for_picture

pytestmark = pytest.mark.browser

GROUPS, FPS = 40, 12
PADDING = 50_000
TAKEN = (
    f"(() => {{ window.taken = []; const {{stage, stream}} = {PLAYER}; const add = stage.addGroup.bind(stage);"
    "stage.addGroup = (index, file, layers) => { add(index, file, layers); taken.push([index, stream.renditionOf(index)]); }; })()"
)


class Line:
    """A web server of a folder whose transfers share a given bandwidth, bits per second."""

    def __init__(self, folder: Path) -> None:
        line = self
        self.rate = 20e6
        turn = threading.Lock()

        class Handler(SimpleHTTPRequestHandler):
            def copyfile(self, source, outputfile) -> None:  # pyright: ignore
                while chunk := source.read(2048):
                    with turn:
                        time.sleep(len(chunk) * 8 / line.rate)
                    outputfile.write(chunk)

            def end_headers(self) -> None:
                self.send_header("Access-Control-Allow-Origin", "*")
                self.send_header("Cache-Control", "no-store")
                super().end_headers()

            def log_message(self, format: str, *args: object) -> None: ...

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
        self.url = f"http://127.0.0.1:{self.http.server_address[1]}/manifest.json"
        threading.Thread(target=self.http.serve_forever, daemon=True).start()


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    """A reel of many groups of half a second. `high` is `low` with an unused tensor."""
    manifest = json.loads((PREDICTIVE / "manifest.json").read_text())
    for layer in manifest["layers"]:
        write(tmp_path, layer["uri"], (PREDICTIVE / layer["uri"]).read_bytes())
    first, second = manifest["groups"]
    noise = {"padding": np.random.default_rng(0).integers(0, 256, PADDING, np.uint8)}
    groups = []
    for i in range(GROUPS):
        place, group = {"index": i, "first_frame": 6 * i}, second if i else first
        low = write(tmp_path, f"low/{i}.safetensors", with_header(group["uri"], place))
        high = write(tmp_path, f"high/{i}.safetensors", with_header(group["uri"], place, noise))
        low |= {"points": group["points"]}
        groups.append(group | high | {"first_frame": 6 * i, "renditions": {"low": low}})
    sums = {"high": sum(group["bytes"] for group in groups)}
    sums["low"] = sum(group["renditions"]["low"]["bytes"] for group in groups)
    manifest["groups"], manifest["renditions"] = (
        groups,
        [{"name": name, "bytes": total} for name, total in sums.items()],
    )
    manifest |= {"fps": FPS, "frames": 6 * GROUPS + 2}
    write(tmp_path, "manifest.json", json.dumps(manifest).encode())
    running = Line(tmp_path)
    yield running
    running.http.shutdown()


def with_header(uri: str, changes: dict[str, int], more: dict[str, np.ndarray] | None = None) -> bytes:
    """Return a file of the golden reel with another header, and more tensors."""
    with safe_open(PREDICTIVE / uri, "numpy") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
        metadata = file.metadata()
    header = json.dumps(json.loads(metadata["splatreel"]) | changes)
    return save(tensors | (more or {}), metadata | {"splatreel": header})


def write(folder: Path, uri: str, data: bytes) -> dict[str, Any]:
    """Write a file of a reel, and return its entry."""
    (folder / uri).parent.mkdir(exist_ok=True)
    (folder / uri).write_bytes(data)
    return {"uri": uri, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def open_reel_at(page: Page, server: Server, line: Line, query: str) -> None:
    page.set_viewport_size({"width": 240, "height": 160})
    page.goto(f"{server.url}?src={line.url}&{query}")
    page.wait_for_function("document.querySelector('splat-reel')?.player?.stream")
    page.evaluate(TAKEN)
    wait_for_picture(page)


def test_goes_down_on_a_line_that_becomes_slow_and_comes_back(page: Page, server: Server, line: Line):
    open_reel_at(page, server, line, "loop=1")
    page.wait_for_function("taken.length >= 12 && taken.slice(-6).every(([, name]) => name === 'high')")
    line.rate = 0.25e6
    page.wait_for_function("taken.slice(-2).every(([, name]) => name === 'low')")
    low = page.evaluate(f"{PLAYER}.pause(), taken.slice(-2).map(([index]) => index)")
    line.rate = 20e6
    # What does not show yet is got anew, and what follows in the best at once.
    high = "(low) => [...low, Math.max(...low) + 1].every((group) => {stream}.renditionOf(group) === 'high')"
    page.wait_for_function(high.replace("{stream}", f"{PLAYER}.stream"), arg=low)
    assert page.evaluate(f"{PLAYER}.error") is None


def test_a_rendition_can_be_chosen(page: Page, server: Server, line: Line):
    open_reel_at(page, server, line, "autoplay=0")
    reel = page.locator("splat-reel")
    page.wait_for_function(f"{PLAYER}.stream.renditionOf(3) === 'high'")
    shown = page.evaluate(f"{PLAYER}.shownRendition")
    reel.get_by_role("button", name="Settings").click()
    quality = reel.get_by_label("Quality")
    quality.locator("option").nth(2).wait_for(state="attached")  # the menu is loaded on demand
    assert quality.locator("option").all_inner_texts()[1:] == ["high", "low"]
    quality.select_option("low")
    # The group that the seek below goes to, too: what is here when it comes on screen stays as it is.
    page.wait_for_function(f"[3, 4].every((group) => {PLAYER}.stream.renditionOf(group) === 'low')")
    # What is on screen stays as it is, so that nothing pops.
    element = "document.querySelector('splat-reel')"
    assert page.evaluate(f"[{element}.rendition, {PLAYER}.shownRendition]") == ["low", shown]
    page.evaluate(f"{PLAYER}.currentTime = 2.2")
    page.wait_for_function(f"!{PLAYER}.seeking && {PLAYER}.shownRendition === 'low'")
    assert page.evaluate(f"{element}.stats.rendition") == "low"
    quality.select_option("")
    page.wait_for_function(f"{PLAYER}.stream.renditionOf(6) === 'high'")
    assert page.evaluate(f"[{element}.rendition, {element}.renditions]") == ["auto", ["high", "low"]]
