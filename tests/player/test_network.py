"""The player on bad networks and unusual hosts: it waits, retries, continues at the right time, and reports failures."""

import hashlib
import json
import shutil
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route
from safetensors import safe_open
from safetensors.numpy import save

from splatreel.play import web_app
from splatreel.play.served_files import open_file
from splatreel.play.server import Server, serve
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, expect_problems, let_frames_pass, open_player, wait_for_picture, wait_until

pytestmark = pytest.mark.browser

GROUP = "groups/0001.safetensors"


def test_a_missing_reel_says_so_and_can_be_tried_again(page: Page, server: Server):
    expect_problems(page, "404")
    page.route("**/reel/manifest.json", lambda route: route.fulfill(status=404, body="not here"))
    page.goto(server.url + "?src=reel/manifest.json")
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "manifest.json cannot be downloaded: it answered 404" in str(alert.text_content())
    page.unroute("**/reel/manifest.json")
    alert.get_by_role("button", name="Try again").click()
    page.wait_for_function(f"{PLAYER}.canPlay")
    assert alert.is_hidden()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 9}, "version 9"),
        ({"format": "mp4"}, "not a reel"),
        ({"groups": []}, "no group yet"),
        ({"fps": "fast"}, "fps"),
    ],
)
def test_a_bad_manifest_is_explained(page: Page, server: Server, change: dict, message: str):
    manifest = json.loads((GOLDEN / "manifest.json").read_text()) | change
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.goto(server.url)
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert message in str(alert.text_content())


def test_a_damaged_group_is_named_and_recovers(page: Page, server: Server):
    whole = (GOLDEN / "groups" / "0001.safetensors").read_bytes()
    damaged = whole[:2000] + bytes(len(whole) - 2000)
    page.route("**/groups/0001.safetensors", lambda route: route.fulfill(body=damaged))
    page.goto(server.url)
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "0001.safetensors" in str(alert.text_content())
    page.unroute("**/groups/0001.safetensors")
    alert.get_by_role("button", name="Try again").click()
    page.wait_for_function(f"{PLAYER}.canPlay && {PLAYER}.currentTime > 0.25 && !{PLAYER}.waiting")


def test_a_host_that_stumbles_is_asked_again(page: Page, server: Server):
    expect_problems(page, "500")
    asked: list[str] = []

    def stumble(route: Route) -> None:
        asked.append(route.request.url)
        if len(asked) == 1:
            route.fulfill(status=500)
        else:
            route.continue_()

    page.route("**/groups/0000.safetensors", stumble)
    open_player(page, server)
    assert len(asked) == 2


def test_layers_show_before_the_first_group(page: Page, server: Server):
    page.route("**/groups/*", lambda route: None)  # never answered
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player?.manifest && {PLAYER}.waiting")
    canvas = page.locator("splat-reel canvas")
    wait_until(page, lambda: len(canvas.screenshot()) > 10_000)  # it is smaller while the canvas is blank
    assert page.evaluate(f"{PLAYER}.canPlay") is False


def test_a_reel_elsewhere_opens_by_src(page: Page, server: Server, tmp_path: Path):
    shutil.copytree(GOLDEN, tmp_path / "other")
    with serve(tmp_path / "other", port=0, cors=True) as other:
        open_player(page, server, f"?autoplay=0&src={other.url}reel/manifest.json")
        assert page.evaluate(f"{PLAYER}.manifest.url").startswith(other.url)


def test_a_host_that_forbids_reading_is_named(page: Page, server: Server):
    expect_problems(page, "CORS policy", "ERR_FAILED")
    handler = partial(SimpleHTTPRequestHandler, directory=str(GOLDEN))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page.goto(f"{server.url}?src=http://127.0.0.1:{other.server_address[1]}/manifest.json")
        alert = page.locator("splat-reel").get_by_role("alert")
        alert.wait_for()
        other.shutdown()
    assert "Access-Control-Allow-Origin" in str(alert.text_content())


@pytest.mark.parametrize("fault", ["cut off", "one byte changed"])
def test_a_transfer_that_breaks_is_repaired(page: Page, server: Server, fault: str):
    whole = (GOLDEN / GROUP).read_bytes()
    broken = whole[: len(whole) // 2] if fault == "cut off" else whole[:-1] + bytes([whole[-1] ^ 1])
    ranges: list[str | None] = []

    def answer(route: Route) -> None:
        ranges.append(route.request.headers.get("range"))
        if len(ranges) == 1:
            route.fulfill(body=broken)
        else:
            route.continue_()

    page.route(f"**/{GROUP}", answer)
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    page.wait_for_function(f"!{PLAYER}.seeking && !{PLAYER}.waiting")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.3)
    assert ranges == [None, f"bytes={len(broken)}-" if fault == "cut off" else None]


def test_a_stalled_transfer_waits_says_so_and_goes_on_at_the_right_time(page: Page, server: Server):
    held: list[Route] = []
    page.route(f"**/{GROUP}", lambda route: held.append(route))
    open_player(page, server, "")
    page.wait_for_function(f"{PLAYER}.waiting && {PLAYER}.currentTime > 0.1")
    stopped = page.evaluate(f"{PLAYER}.currentTime")
    page.locator("splat-reel .wait").wait_for()
    let_frames_pass(page)
    assert page.evaluate(f"{PLAYER}.currentTime") == stopped
    for route in held:
        route.continue_()
    page.unroute(f"**/{GROUP}")
    page.wait_for_function(f"!{PLAYER}.waiting && {PLAYER}.currentTime > {stopped}")
    assert page.locator("splat-reel .center .panel").is_hidden()


def test_offline_and_back(page: Page, server: Server):
    expect_problems(page, "ERR_INTERNET_DISCONNECTED")
    held: list[Route] = []
    loaded: list[str] = []
    page.on("requestfinished", lambda request: loaded.append(request.url))
    page.route("**/groups/*", lambda route: held.append(route))
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player?.manifest && {PLAYER}.waiting")
    wait_until(page, lambda: held and any(url.endswith(".wasm") for url in loaded))  # the player itself is loaded
    page.context.set_offline(True)
    for route in held:
        route.abort("internetdisconnected")
    page.wait_for_function(f"{PLAYER}.notice !== null")
    page.unroute("**/groups/*")
    page.context.set_offline(False)
    wait_for_picture(page)
    assert page.evaluate(f"{PLAYER}.error") is None


def test_a_seek_gives_up_what_is_no_longer_needed(page: Page, server: Server):
    held: list[Route] = []
    page.route("**/groups/0000.safetensors", lambda route: held.append(route))
    with page.expect_request("**/groups/0000.safetensors"):
        page.goto(server.url + "?autoplay=0&loop=0")
    page.evaluate(f"{PLAYER}.currentTime = 0.39")
    wait_for_picture(page)
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.39)
    assert len(held) == 1


def test_retry_goes_on_where_it_broke(page: Page, server: Server):
    expect_problems(page, "404")
    page.route(f"**/{GROUP}", lambda route: route.fulfill(status=404))
    open_player(page, server)
    page.evaluate("document.querySelector('splat-reel').camera = {viewmat: [1,0,0,0.5, 0,1,0,0, 0,0,1,4, 0,0,0,1]}")
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    page.unroute(f"**/{GROUP}")
    alert.get_by_role("button", name="Try again").click()
    wait_for_picture(page)
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.3)
    assert page.evaluate(f"{PLAYER}.camera.viewmat")[3] == pytest.approx(0.5)


def test_a_live_reel_is_joined_at_its_edge_and_followed(page: Page, server: Server):
    whole = json.loads((GOLDEN / "manifest.json").read_text())
    frames = whole["groups"][0]["frames"]
    early = whole | {"live": True, "frames": frames, "groups": whole["groups"][:1]}
    early["layers"] = [layer for layer in whole["layers"] if layer["group"] == 0]
    none = early | {"frames": 0, "groups": [], "layers": []}
    states = [none, early, whole]
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=states[0]))
    page.goto(server.url + "?loop=0")
    page.wait_for_function("document.querySelector('splat-reel')?.player?.notice?.startsWith('Live')")
    states.pop(0)
    wait_for_picture(page)
    page.locator("splat-reel .live:not([hidden])").wait_for(state="attached")
    assert page.evaluate(f"{PLAYER}.duration") == pytest.approx(frames / whole["fps"])
    page.wait_for_function(f"{PLAYER}.currentTime === {PLAYER}.duration && !{PLAYER}.paused")
    states.pop(0)
    page.wait_for_function(f"!{PLAYER}.live && {PLAYER}.ended")
    assert page.evaluate(f"{PLAYER}.duration") == pytest.approx(whole["frames"] / whole["fps"])


def test_groups_that_memory_does_not_hold_are_dropped_and_fetched_again(page: Page, server: Server):
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    first, second = manifest["groups"]
    step = second["first_frame"]
    groups, files = [], {}
    for i in range(6):
        group = second if i else first
        with safe_open(GOLDEN / group["uri"], "numpy") as file:
            metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = json.dumps(json.loads(metadata["splatreel"]) | {"index": i, "first_frame": i * step})
        uri, body = f"groups/{i:04d}.safetensors", save(tensors, metadata | {"splatreel": header})
        files[Path(uri).name] = body
        named = {"uri": uri, "bytes": len(body), "sha256": hashlib.sha256(body).hexdigest()}
        groups.append(group | named | {"first_frame": i * step})
    manifest |= {"groups": groups, "frames": 5 * step + second["frames"]}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.route("**/groups/*", lambda route: route.fulfill(body=files[route.request.url.rpartition("/")[2]]))
    open_player(page, server, "?autoplay=0&loop=0")
    room = (
        3 * max(first["points"], second["points"]) * (92 + 24 * second["frames"])
    )  # bytes of memory that three groups take
    page.evaluate(f"{PLAYER}.stream.budget = {room}")
    page.evaluate(
        f"(() => {{ window.taken = []; const {{stage}} = {PLAYER}; const add = stage.addGroup.bind(stage);"
        "stage.addGroup = (index, file, layers) => { taken.push(index); add(index, file, layers); }; })()"
    )
    middle = 0.5 * step / manifest["fps"]
    for group in (0, 2, 5, 1, 3, 0):
        page.evaluate(f"{PLAYER}.currentTime = {middle + group * step / manifest['fps']}")
        ahead = min(group + 1, 5)
        settled = f"!{PLAYER}.seeking && !{PLAYER}.waiting && {PLAYER}.stream.held.includes({ahead})"
        page.wait_for_function(settled)
        held = page.evaluate(f"{PLAYER}.stream.held")
        assert group in held
        assert len(held) <= 3
    assert page.evaluate("taken.includes(0)"), "the first group is fetched again"
    page.evaluate(f"{PLAYER}.currentTime = 0; {PLAYER}.play()")
    page.wait_for_function(f"{PLAYER}.ended")


class _Slow(SimpleHTTPRequestHandler):
    """Transfers of 1 Mbit/s each, after 300 ms."""

    def copyfile(self, source, outputfile) -> None:  # pyright: ignore
        time.sleep(0.3)
        while chunk := source.read(8192):
            outputfile.write(chunk)
            time.sleep(len(chunk) * 8 / 1e6)

    def end_headers(self) -> None:
        self.send_header("Access-Control-Allow-Origin", "*")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None: ...


def test_a_slow_network_shows_that_it_waits_and_loses_no_time(page: Page, server: Server):
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Slow, directory=str(GOLDEN))) as slow:
        threading.Thread(target=slow.serve_forever, daemon=True).start()
        page.goto(f"{server.url}?loop=0&src=http://127.0.0.1:{slow.server_address[1]}/manifest.json")
        page.locator("splat-reel .wait").wait_for()
        page.wait_for_function(f"{PLAYER}.ended")
        assert page.locator("splat-reel .wait").is_hidden()
        # A busy machine hands over late and then all at once; without the brake it would be hundreds of megabits.
        assert 0.05e6 < page.evaluate(f"{PLAYER}.stats.throughput") < 2e7
        slow.shutdown()


def test_the_script_of_the_decode_workers_is_fetched_once(page: Page, server: Server, monkeypatch: pytest.MonkeyPatch):
    asked: list[str] = []

    def open_counted(path: Path) -> object:
        asked.append(path.name)
        return open_file(path)

    monkeypatch.setattr(web_app, "open_file", open_counted)
    open_player(page, server)
    page.wait_for_function(f"{PLAYER}.session.decoders.workers.length === 2 && !{PLAYER}.busy")
    assert asked.count("decode-worker.js") == 1
    assert asked.count("player.js") == 1
