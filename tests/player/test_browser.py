"""The player in a real Chromium: the golden reel's numbers and pictures, seeking, errors, controls."""

import base64
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Route
from safetensors import safe_open
from safetensors.numpy import save

from splatreel.kernels.image import render_image
from splatreel.play.server import Server, serve
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests.golden import GOLDEN

pytestmark = pytest.mark.browser

PLAYER = "document.querySelector('splat-reel').player"

DECODE = """async (source) => {
  const worker = new Worker('/decode-worker.js');
  const reply = await new Promise((resolve) => {
    worker.onmessage = ({data}) => { if (data.file || data.error) resolve(data); };
    worker.postMessage({id: 0, source});
  });
  if (reply.error) throw new Error(reply.error);
  const {points, alive, offsets} = reply.file;
  const arrays = {means: points.means, quats: points.quats, scales: points.scales, opacities: points.opacities};
  const rest = points.shDegree ? 3 * ((points.shDegree + 1) ** 2 - 1) : 0;
  arrays.sh = new Float32Array(points.count * (rest + 3));
  for (let i = 0; i < points.count; i++) {
    arrays.sh.set(points.shBase.subarray(3 * i, 3 * i + 3), i * (rest + 3));
    const entry = points.shRest[i] * rest;
    arrays.sh.set(points.codebook.subarray(entry, entry + rest), i * (rest + 3) + 3);
  }
  if (offsets) {
    const values = (q, channels, min, step) => Float32Array.from({length: q.length / 4 * channels}, (_, i) =>
      min[i % channels] + step[i % channels] * q[Math.floor(i / channels) * 4 + i % channels]);
    arrays.dx = values(offsets.dx, 3, offsets.dxMin, offsets.dxStep);
    arrays.dq = values(offsets.dq, 4, offsets.dqMin, offsets.dqStep);
  }
  return {alive: Array.from(alive), ...Object.fromEntries(Object.entries(arrays).map(([k, v]) => [k, Array.from(v)]))};
}"""

RENDER = (
    "async ([seconds, pose, width, height]) => {"
    f"const picture = await {PLAYER}.renderAt(seconds, pose, width, height);"
    "let text = ''; for (const byte of picture.data) text += String.fromCharCode(byte); return btoa(text); }"
)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serve(GOLDEN, port=0) as running:
        yield running


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    page = browser.new_page(viewport={"width": 480, "height": 320})
    problems: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type == "error":
            problems.append(message.text)

    page.on("console", listen)
    page.on("pageerror", lambda error: problems.append(str(error)))
    yield page
    expected = getattr(page, "expected_problem", None)
    page.close()
    assert [text for text in problems if expected is None or expected not in text] == []


def open_player(page: Page, server: Server, query: str = "?autoplay=0") -> None:
    page.goto(server.url + query)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.canPlay", timeout=20_000)


def source(server: Server, uri: str, size: int) -> dict:
    return {"url": f"{server.url}reel/{uri}", "bytes": size, "sha256": None}


def picture(page: Page, seconds: float, camera: Camera) -> np.ndarray:
    pose = {"K": camera.K.ravel().tolist(), "viewmat": camera.viewmat.ravel().tolist()}
    data = base64.b64decode(page.evaluate(RENDER, [seconds, pose, camera.width, camera.height]))
    return np.frombuffer(data, np.uint8).reshape(camera.height, camera.width, 4)[..., :3] / 255


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def test_decodes_the_golden_reel_to_the_expected_numbers(page: Page, server: Server):
    page.goto(server.url + "?autoplay=0")
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    expected = np.load(GOLDEN / "expected.npz")
    compared = 0
    for kind in ("layer", "group"):
        for index, file in enumerate(manifest[f"{kind}s"]):
            arrays = page.evaluate(DECODE, source(server, file["uri"], file["bytes"]))
            for name, values in arrays.items():
                prefix = f"{kind}{index}."
                key = prefix + name if prefix + name in expected else f"{prefix}dynamic.{name}"
                if key not in expected:  # a layer has no alive points of its own
                    assert not values
                    continue
                want = expected[key]
                got = np.array(values).reshape(want.shape)
                if name == "dq":
                    got /= np.linalg.norm(got, axis=-1, keepdims=True)
                error = np.abs(got - want) / np.maximum(np.abs(want), 1)
                assert error.max() <= 1e-5, f"{key} differs by {error.max()}"
                compared += 1
    assert compared == len(expected.files)


def test_decodes_offsets_in_a_fragmented_mp4(page: Page, server: Server):
    path = GOLDEN / "groups" / "0001.safetensors"
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    tensors["offsets"] = np.frombuffer(fragmented(tensors["offsets"].tobytes()), np.uint8)
    body = save(tensors, metadata)
    page.route("**/fragmented.safetensors", lambda route: route.fulfill(body=body))
    page.goto(server.url + "?autoplay=0")
    arrays = page.evaluate(DECODE, source(server, "fragmented.safetensors", len(body)))
    want = np.load(GOLDEN / "expected.npz")["group1.dx"]
    assert np.allclose(np.array(arrays["dx"]).reshape(want.shape), want, atol=1e-5)


def fragmented(mp4: bytes) -> bytes:
    """The same tracks with their samples in movie fragments."""
    out = io.BytesIO()
    options = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}
    with av.open(io.BytesIO(mp4)) as source, av.open(out, "w", format="mp4", options=options) as target:
        streams = {stream.index: target.add_stream_from_template(stream) for stream in source.streams}
        for packet in source.demux():
            if packet.dts is not None:
                packet.stream = streams[packet.stream.index]
                target.mux(packet)
    return out.getvalue()


@pytest.mark.parametrize("seconds", [0.05, 0.225, 0.3])
def test_pictures_match_the_python_render(page: Page, server: Server, seconds: float):
    reel = open_reel(GOLDEN)
    open_player(page, server)
    for camera in (reel.manifest.camera, reel.manifest.cameras[1].resized(120, 100)):
        want = np.clip(render_image(reel.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(picture(page, seconds, camera), want) >= 45


def test_seeks_to_any_group_and_back(page: Page, server: Server):
    reel = open_reel(GOLDEN)
    open_player(page, server)
    camera = reel.manifest.camera
    for seconds in (0.39, 0.0, 0.21, 0.39):
        want = np.clip(render_image(reel.at(seconds), camera), 0, 1)
        assert psnr(picture(page, seconds, camera), want) >= 45, f"at {seconds} s"


def test_plays_loops_and_pauses(page: Page, server: Server):
    open_player(page, server, "")
    page.evaluate(f"{PLAYER}.playbackRate = 0.5")
    page.wait_for_function(f"{PLAYER}.currentTime > 0.25")
    page.wait_for_function(f"{PLAYER}.currentTime < 0.2")
    page.keyboard.press("Tab")
    page.locator("splat-reel").get_by_role("button", name="Pause").click()
    time = page.evaluate(f"{PLAYER}.currentTime")
    page.wait_for_timeout(200)
    assert page.evaluate(f"[{PLAYER}.paused, {PLAYER}.currentTime]") == [True, time]


def test_ends_without_loop(page: Page, server: Server):
    open_player(page, server, "?autoplay=0&loop=0")
    page.evaluate(f"{PLAYER}.play()")
    page.wait_for_function(f"{PLAYER}.ended && {PLAYER}.paused")
    page.evaluate(f"{PLAYER}.play()")
    assert page.evaluate(f"{PLAYER}.currentTime") < 0.3  # it began again


def test_keys_move_time_and_play(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("End")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(open_reel(GOLDEN).duration)
    page.keyboard.press("Home")
    assert page.evaluate(f"{PLAYER}.currentTime") == 0
    page.keyboard.press("Space")
    assert page.evaluate(f"{PLAYER}.paused") is False


def test_the_mouse_moves_the_camera_and_reset_brings_it_back(page: Page, server: Server):
    open_player(page, server)
    pose = f"{PLAYER}.camera.viewmat"
    start = page.evaluate(pose)
    page.mouse.move(200, 100)
    page.mouse.down()
    page.mouse.move(260, 120, steps=4)
    page.mouse.up()
    turned = page.evaluate(pose)
    page.mouse.wheel(0, 200)
    page.wait_for_timeout(50)
    assert not np.allclose(start, turned, atol=0.01)
    assert page.evaluate(pose)[11] != pytest.approx(turned[11])
    page.locator("splat-reel").get_by_role("button", name="Reset view").click()
    page.wait_for_timeout(800)
    assert np.allclose(page.evaluate(pose), start, atol=1e-6)


def test_a_missing_reel_says_so_and_can_be_tried_again(page: Page, server: Server):
    page.expected_problem = "404"
    page.route("**/reel/manifest.json", lambda route: route.fulfill(status=404, body="not here"))
    page.goto(server.url)
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "manifest.json cannot be downloaded: it answered 404" in alert.inner_text()
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
    assert message in alert.inner_text()


def test_a_damaged_group_is_named_and_recovers(page: Page, server: Server):
    whole = (GOLDEN / "groups" / "0001.safetensors").read_bytes()
    damaged = whole[:2000] + bytes(len(whole) - 2000)
    page.route("**/groups/0001.safetensors", lambda route: route.fulfill(body=damaged))
    page.goto(server.url)
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "0001.safetensors" in alert.inner_text()
    page.unroute("**/groups/0001.safetensors")
    alert.get_by_role("button", name="Try again").click()
    page.wait_for_function(f"{PLAYER}.canPlay && {PLAYER}.currentTime > 0.25 && !{PLAYER}.waiting")


def test_a_host_that_stumbles_is_asked_again(page: Page, server: Server):
    page.expected_problem = "500"
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
    page.wait_for_timeout(700)
    shown = page.locator("splat-reel canvas").screenshot()
    assert page.evaluate(f"{PLAYER}.canPlay") is False
    assert len(shown) > 10_000, "the canvas is blank"


def test_a_reel_elsewhere_opens_by_src(page: Page, server: Server, tmp_path: Path):
    shutil.copytree(GOLDEN, tmp_path / "other")
    with serve(tmp_path / "other", port=0) as other:
        open_player(page, server, f"?autoplay=0&src={other.url}reel/manifest.json")
        assert page.evaluate(f"{PLAYER}.manifest.url").startswith(other.url)


def test_the_controls_fit_a_narrow_screen(page: Page, server: Server):
    page.set_viewport_size({"width": 320, "height": 480})
    open_player(page, server)
    for name in ("Play", "Reset view", "Settings", "Fullscreen"):
        box = page.locator("splat-reel .row").get_by_role("button", name=name).bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 320
    assert page.evaluate("document.documentElement.scrollWidth") <= 320
