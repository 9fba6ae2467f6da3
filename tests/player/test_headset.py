"""Virtual reality with a simulated headset: two eyes side by side in one framebuffer."""

import base64

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_player, wait_until

pytestmark = pytest.mark.browser

SIDE = 120
APART = 0.064
HEADSET = """
(() => {
  const side = SIDE, apart = APART;
  const move = (x, y, z) => new Float32Array([1,0,0,0, 0,1,0,0, 0,0,1,0, x,y,z,1]);
  const shift = (x, y, z) => ({matrix: move(x, y, z), inverse: {matrix: move(-x, -y, -z)}});
  const projectionMatrix = new Float32Array([1.5,0,0,0, 0,1.5,0,0, 0,0,-1,-1, 0,0,-0.02,0]);
  const views = [-1, 1].map((eye) => ({eye, projectionMatrix, transform: shift(eye * apart / 2, 1.6, 0)}));
  class Session extends EventTarget {
    updateRenderState({baseLayer}) { window.layer = baseLayer; }
    async requestReferenceSpace(type) { if (type !== window.space) throw new DOMException('no', 'NotSupportedError'); return {}; }
    requestAnimationFrame(draw) {
      return window.requestAnimationFrame((now) => draw(now, {getViewerPose: () => ({transform: shift(0, 1.6, 0), views})}));
    }
    async end() { this.dispatchEvent(new Event('end')); }
  }
  window.space = 'local-floor';
  window.XRWebGLLayer = class {
    constructor(session, gl) {
      this.gl = gl;
      this.framebuffer = gl.createFramebuffer();
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, 2 * side, side);
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    }
    getViewport(view) { return {x: view.eye < 0 ? 0 : side, y: 0, width: side, height: side}; }
    pixels() {
      const {gl} = this, data = new Uint8Array(8 * side * side);
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.readPixels(0, 0, 2 * side, side, gl.RGBA, gl.UNSIGNED_BYTE, data);
      return btoa(String.fromCharCode(...data));
    }
  };
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
  Object.defineProperty(navigator, 'xr', {value: {
    isSessionSupported: async (mode) => mode === 'immersive-vr',
    requestSession: async () => (window.session = new Session()),
  }});
})();
""".replace("SIDE", str(SIDE)).replace("APART", str(APART))


def eyes(page: Page) -> tuple[np.ndarray, np.ndarray]:
    """Return the images of the left and the right eye, [SIDE, SIDE, 3] each."""
    data = np.frombuffer(base64.b64decode(page.evaluate("layer.pixels()")), np.uint8)
    both = data.reshape(SIDE, 2 * SIDE, 4)[::-1, :, :3] / 255
    return both[:, :SIDE], both[:, SIDE:]


def wait_for_headset(page: Page) -> None:
    """Wait until the headset shows its third image; the page has drawn some of its own before."""
    page.wait_for_function(f"{PLAYER}.presented")
    drawn = page.evaluate(f"{PLAYER}.stage.pictures")
    page.wait_for_function(f"{PLAYER}.stage.pictures > {drawn} + 3 && !{PLAYER}.seeking")


def expect_eyes(page: Page, *wanted: np.ndarray) -> None:
    """Wait until the left and the right eye see these images, which a busy machine sorts and draws late."""

    def error() -> float:
        return max(float(np.mean((got - want) ** 2)) for got, want in zip(eyes(page), wanted, strict=True))

    wait_until(page, lambda: -10 * np.log10(error()) > 40)


def expected(side: int, seconds: float = 0.0) -> np.ndarray:
    """Return the CPU's image of an eye beside the reel's camera, whose median distance to the center is two meters."""
    reel = open_reel(GOLDEN)
    middle = np.asarray(reel.manifest.bounds).mean(0)
    meters = 2 / np.sort([np.linalg.norm(camera.center - middle) for camera in reel.manifest.cameras])[1]
    start = reel.manifest.camera
    viewmat = start.viewmat.copy()
    viewmat[0, 3] -= side * APART / 2 / meters
    K = np.array([[0.75 * SIDE, 0, SIDE / 2], [0, 0.75 * SIDE, SIDE / 2], [0, 0, 1]])
    return np.clip(reel.render(reel.at(seconds), Camera("eye", viewmat, K, SIDE, SIDE)), 0, 1)


@pytest.mark.parametrize("space", ["local-floor", "local"])
def test_each_eye_sees_its_own_picture(page: Page, server: Server, space: str):
    page.add_init_script(HEADSET)
    open_player(page, server)
    page.evaluate(f"window.space = '{space}'")
    page.locator("splat-reel").get_by_role("button", name="Enter VR").click()
    wait_for_headset(page)
    if space == "local":  # its origin is where the eyes are: the pretended head stands 1.6 m above that
        assert eyes(page)[0].mean() < expected(-1).mean() / 2
        return
    left, right = expected(-1), expected(1)
    assert min(left.std(), right.std()) > 0.05
    assert np.abs(left - right).mean() > 0.003, "the eyes see the same"
    expect_eyes(page, left, right)


def test_where_groups_meet_either_eye_sees_their_pictures_fade(page: Page, server: Server):
    page.add_init_script(HEADSET)
    open_player(page, server)
    page.evaluate(f"window.space = 'local-floor'; {PLAYER}.currentTime = 0.225")
    page.locator("splat-reel").get_by_role("button", name="Enter VR").click()
    wait_for_headset(page)
    expect_eyes(page, expected(-1, 0.225), expected(1, 0.225))
    for side, got in zip((-1, 1), eyes(page), strict=True):
        assert -10 * np.log10(np.mean((got - expected(side)) ** 2)) < 35


def test_a_pinch_plays_and_leaving_goes_back_to_the_page(page: Page, server: Server):
    page.add_init_script(HEADSET)
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("v")
    wait_for_headset(page)
    page.evaluate("session.dispatchEvent(new Event('select'))")
    page.wait_for_function(f"{PLAYER}.currentTime > 0.05 && !{PLAYER}.paused")
    page.evaluate("session.dispatchEvent(new Event('select'))")
    assert page.evaluate(f"{PLAYER}.paused") is True
    page.locator("splat-reel").get_by_role("button", name="Leave VR").click()
    page.wait_for_function(f"!{PLAYER}.presented")
    pictures = page.evaluate(f"{PLAYER}.stage.pictures")
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    page.wait_for_function(f"{PLAYER}.stage.pictures > {pictures}")
    page.locator("splat-reel").get_by_role("button", name="Enter VR").wait_for()


def test_without_a_headset_there_is_no_button(page: Page, server: Server):
    open_player(page, server)
    assert page.locator("splat-reel .headset").is_hidden()
    page.keyboard.press("v")
    assert page.evaluate(f"{PLAYER}.presented") is False


def test_a_headset_that_refuses_is_explained_to_people(page: Page, server: Server):
    warnings: list[str] = []
    page.on("console", lambda message: warnings.append(message.text) if message.type == "warning" else None)
    page.add_init_script(HEADSET)
    open_player(page, server)
    page.evaluate(
        "void (navigator.xr.requestSession = async () => { throw new DOMException('no', 'NotAllowedError') })"
    )
    page.keyboard.press("v")
    toast = page.locator("splat-reel .toast.shown")
    toast.wait_for()
    assert toast.inner_text() == "The headset cannot be used. Connect it, and let this page use it."
    assert "Immersive vr cannot start: no" in warnings
