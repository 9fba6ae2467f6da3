"""The player in a real Chromium: the golden reel's numbers and pictures, seeking, errors, controls."""

import base64
import hashlib
import io
import json
import shutil
from pathlib import Path

import av
import numpy as np
import pytest
from playwright.sync_api import Page
from safetensors import safe_open
from safetensors.numpy import save

from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests.codec.reels import edit_manifest
from tests.golden import GOLDEN
from tests.method.scenes import look_at
from tests.player.pages import PLAYER, let_frames_pass, open_player

pytestmark = pytest.mark.browser

DECODE = """async (source) => {
  const worker = new Worker('/decode-worker.js');
  const reply = await new Promise((resolve) => {
    worker.onmessage = ({data}) => { if (data.file || data.error) resolve(data); };
    worker.postMessage({files: {}});
    worker.postMessage({id: 0, source, page: false});
  });
  if (reply.error) throw new Error(reply.error);
  const {points, alive = [], offsets} = reply.file;
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
    const { appearance } = offsets;
    if (appearance) arrays.shade = values(appearance.data, 4, appearance.min, appearance.step);
  }
  return {alive: Array.from(alive), ...Object.fromEntries(Object.entries(arrays).map(([k, v]) => [k, Array.from(v)]))};
}"""

RENDER = (
    "async ([seconds, pose, width, height]) => {"
    f"const picture = await {PLAYER}.renderAt(seconds, pose, width, height);"
    "let text = ''; for (const byte of picture.data) text += String.fromCharCode(byte); return btoa(text); }"
)


def source(server: Server, uri: str, size: int, sha256: str) -> dict:
    return {"url": f"{server.url}reel/{uri}", "bytes": size, "sha256": sha256}


def picture(page: Page, seconds: float, camera: Camera) -> np.ndarray:
    pose = {"K": camera.K.ravel().tolist(), "viewmat": camera.viewmat.ravel().tolist()}
    data = base64.b64decode(page.evaluate(RENDER, [seconds, pose, camera.width, camera.height]))
    return np.frombuffer(data, np.uint8).reshape(camera.height, camera.width, 4)[..., :3] / 255


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


@pytest.mark.smoke
def test_decodes_the_golden_reel_to_the_expected_numbers(page: Page, server: Server):
    page.goto(server.url + "?autoplay=0")
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    expected = np.load(GOLDEN / "expected.npz")
    compared = 0
    for kind in ("layer", "group"):
        for index, file in enumerate(manifest[f"{kind}s"]):
            arrays = page.evaluate(DECODE, source(server, file["uri"], file["bytes"], file["sha256"]))
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
                tolerance = np.ptp(want, (0, 1)).max() / 500 if name == "shade" else 1e-5  # 8 bits over its range
                assert error.max() <= tolerance, f"{key} differs by {error.max()}"
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
    arrays = page.evaluate(
        DECODE, source(server, "fragmented.safetensors", len(body), hashlib.sha256(body).hexdigest())
    )
    want = np.load(GOLDEN / "expected.npz")["group1.dx"]
    assert np.allclose(np.array(arrays["dx"]).reshape(want.shape), want, atol=1e-5)


def fragmented(mp4: bytes) -> bytes:
    """Return the same tracks with their samples in movie fragments."""
    out = io.BytesIO()
    options = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}
    with av.open(io.BytesIO(mp4)) as source, av.open(out, "w", format="mp4", options=options) as target:
        streams = {stream.index: target.add_stream_from_template(stream) for stream in source.streams}
        for packet in source.demux():  # pyright: ignore[reportAttributeAccessIssue]
            if packet.dts is not None:
                packet.stream = streams[packet.stream.index]
                target.mux(packet)
    return out.getvalue()


@pytest.mark.parametrize("seconds", [0.05, 0.225, 0.3])
def test_pictures_match_the_python_render(page: Page, server: Server, seconds: float):
    reel = open_reel(GOLDEN)
    open_player(page, server)
    for camera in (reel.manifest.camera, reel.manifest.cameras[1].resized(120, 100)):
        want = np.clip(reel.render(reel.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(picture(page, seconds, camera), want) >= 45


def test_what_rests_is_not_drawn_close_to_a_viewer(page: Page, server: Server, tmp_path: Path):
    """The player hides the same static points as Python. At half the distance, the clearance is half as large."""
    shutil.copytree(GOLDEN, tmp_path / "reel")
    clearance = {"focus": [0, 0, 0], "share": 0.9}
    edit_manifest(tmp_path / "reel", lambda d: d.update(clearance=clearance, background=[0.6, 0.3, 0.5]))
    body = (tmp_path / "reel" / "manifest.json").read_bytes()
    page.route("**/reel/manifest.json", lambda route: route.fulfill(body=body, content_type="application/json"))
    reel, whole = open_reel(tmp_path / "reel"), open_reel(GOLDEN)
    open_player(page, server)
    near = look_at([0, 0, -2], width=160, height=120)
    for camera in (reel.manifest.camera, reel.manifest.cameras[1], near):
        for seconds in (0.05, 0.225):
            want, before = (np.clip(r.render(r.at(seconds), camera), 0, 1) for r in (reel, whole))
            assert np.abs(want - before).max() > 0.1
            assert psnr(picture(page, seconds, camera), want) >= 45


def test_seeks_to_any_group_and_back(page: Page, server: Server):
    reel = open_reel(GOLDEN)
    open_player(page, server)
    camera = reel.manifest.camera
    for seconds in (0.39, 0.0, 0.21, 0.39):
        want = np.clip(reel.render(reel.at(seconds), camera), 0, 1)
        assert psnr(picture(page, seconds, camera), want) >= 45, f"at {seconds} s"


def test_plays_loops_and_pauses(page: Page, server: Server):
    open_player(page, server, "")
    page.evaluate(f"{PLAYER}.playbackRate = 0.5")
    page.wait_for_function(f"{PLAYER}.currentTime > 0.25")
    page.wait_for_function(f"{PLAYER}.currentTime < 0.2")
    page.keyboard.press("Tab")
    page.locator("splat-reel").get_by_role("button", name="Pause").click()
    time = page.evaluate(f"{PLAYER}.currentTime")
    let_frames_pass(page)
    assert page.evaluate(f"[{PLAYER}.paused, {PLAYER}.currentTime]") == [True, time]


def test_ends_without_loop(page: Page, server: Server):
    open_player(page, server, "?autoplay=0&loop=0")
    page.evaluate(f"{PLAYER}.play()")
    page.wait_for_function(f"{PLAYER}.ended && {PLAYER}.paused")
    page.evaluate(f"{PLAYER}.play()")
    assert page.evaluate(f"{PLAYER}.currentTime") < 0.3  # it began again


def test_two_hundred_loops_hold_no_more_than_ten(page: Page, server: Server):
    page.set_viewport_size({"width": 160, "height": 120})
    open_player(page, server, "")
    page.evaluate(
        f"(() => {{ window.loops = 0; let last = 0; {PLAYER}.playbackRate = 16;"
        f"{PLAYER}.addEventListener('timeupdate', () => {{"
        f"const now = {PLAYER}.currentTime; if (now < last) window.loops++; last = now; }}); }})()"
    )
    held = "[performance.memory.usedJSHeapSize, " + PLAYER + ".stream.held.length]"
    page.wait_for_function("window.loops >= 10")
    before = page.evaluate(held)
    page.wait_for_function("window.loops >= 210")
    after = page.evaluate(held)
    assert after[0] < before[0] + 5e6
    assert after[1] == before[1] == 2


def test_a_lost_graphics_device_is_said_and_comes_back(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    page.evaluate(f"window.device = {PLAYER}.canvas.getContext('webgl2').getExtension('WEBGL_lose_context')")
    page.evaluate("device.loseContext()")
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "graphics device was lost" in alert.inner_text()
    page.evaluate("device.restoreContext()")
    page.wait_for_function(f"{PLAYER}.canPlay && !{PLAYER}.error")
    assert alert.is_hidden()
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.3)
    reel = open_reel(GOLDEN)
    want = np.clip(reel.render(reel.at(0.3), reel.manifest.camera), 0, 1)
    assert psnr(picture(page, 0.3, reel.manifest.camera), want) >= 45


def test_a_driver_that_refuses_the_shaders_is_said(page: Page, server: Server):
    page.add_init_script("""
      const source = WebGL2RenderingContext.prototype.shaderSource;
      WebGL2RenderingContext.prototype.shaderSource = function (shader, text) {
        source.call(this, shader, text.replace("void main", "void nothing"));
      };
    """)
    page.goto(server.url)
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "graphics driver rejects the player's shaders: ERROR" in str(alert.text_content())
