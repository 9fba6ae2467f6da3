"""@splatreel/three in a real Chromium: the element's picture, depth against meshes, transforms, rays, effects, and freed memory."""

import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.timeline import open_reel
from tests.golden import PREDICTIVE
from tests.player.engines import (
    GREEN,
    expect_errors_as_events,
    expect_meshes_to_hide_splats,
    expect_snippet_to_draw,
    expect_time_to_end,
    open_reel_in,
    pixels_of,
    write_site,
)
from tests.player.hosts import host
from tests.player.test_browser import psnr

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a folder with the page, the built package, three.js and a reel."""
    folder = tmp_path_factory.mktemp("three")
    build = write_site(folder, "three", "reel-object")
    shutil.copytree(build, folder / "three")
    shutil.copytree(build.parent / "examples" / "jsm", folder / "addons")
    with host(folder) as address:
        yield address


@pytest.fixture
def opened(page: Page, site: str) -> Page:
    return open_reel_in(page, site)


def test_pictures_are_those_of_the_element(opened: Page) -> None:
    """The element's pictures equal those of Python (test_predictive_reel.py). The golden reel cross-fades from 0.2 to 0.267 s."""
    timeline = open_reel(PREDICTIVE)
    for seconds, least in ((0.05, 40), (0.31, 40), (0.225, 30)):
        found = pixels_of(opened, f"picture(reel, {seconds})")
        camera = timeline.manifest.camera
        want = np.clip(timeline.render(timeline.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(found, want) >= least, seconds
    assert opened.evaluate("events")[:2] == ["loadedmetadata", "canplay"]


def test_moved_scaled_and_turned_reels_look_the_same(opened: Page) -> None:
    before = pixels_of(opened, "picture(reel, 0.05)")
    opened.evaluate("reel.position.set(3, -2, 5), reel.rotation.set(0.4, 1.1, -0.3), reel.scale.setScalar(2.5)")
    after = pixels_of(opened, "(reel.viewFromStart(camera), pixels())")
    assert np.abs(after - before).max() < 0.05
    assert pixels_of(opened, "(reel.visible = false, pixels())").max() == 0


@pytest.mark.parametrize("query", ["", "?reversed"])
def test_meshes_hide_splats_behind_them_only(page: Page, site: str, query: str) -> None:
    open_reel_in(page, site + query)
    expect_meshes_to_hide_splats(page)


def test_splats_that_write_depth_hide_what_is_drawn_later(opened: Page) -> None:
    pixels_of(opened, "picture(reel, 0.05)")
    later = pixels_of(opened, "(addPlane({ transparent: true })(20), pixels())")
    assert np.abs(later - GREEN).max() < 0.01
    hidden = pixels_of(opened, "(reel.depthWrite = true, pixels())")
    assert (np.abs(hidden - GREEN).max(-1) > 0.05).mean() > 0.05


BACKDROP = """() => {
  scene.background = new THREE.Color(0.5, 0.2, 0.1);
  const solid = new THREE.Mesh(new THREE.BoxGeometry(1, 1, 1), new THREE.MeshBasicMaterial({ color: 0x4060ff }));
  solid.position.copy(camera.position).addScaledVector(camera.getWorldDirection(new THREE.Vector3()), 3);
  const later = new THREE.Mesh(solid.geometry, new THREE.MeshBasicMaterial({ color: 0xffffff, transparent: true }));
  later.position.copy(solid.position).add(new THREE.Vector3(0.8, 0.3, 0));
  later.scale.setScalar(0.3);
  later.renderOrder = 1;
  scene.add(solid, later);
  return picture(reel, 0.05);
}"""


@pytest.mark.parametrize(
    ("options", "least"),
    [("{}", 45), ("{ strength: 0 }", 45), ("{ type: THREE.UnsignedByteType }", 35), ("{ samples: 4 }", 28)],
)
def test_effects_leave_the_colors_of_splats(opened: Page, options: str, least: float) -> None:
    """Splats are before a background, around a mesh, and behind one that is drawn later."""
    plain = pixels_of(opened, BACKDROP)
    assert plain.std() > 0.05
    effects = pixels_of(opened, f"(useEffects({options}), pixels())")
    # Targets with 8 bits hold few dark linear colors. Samples smooth the edges of the box.
    assert psnr(effects, plain) >= least
    hidden = pixels_of(opened, "(reel.visible = false, pixels())")
    assert psnr(effects, hidden) < 30, "splats are drawn"
    again = pixels_of(opened, "(reel.visible = true, drawWith(camera), pixels())")
    assert psnr(again, plain) >= 50, "the state of three.js is restored"


def test_bloom_makes_splats_shine(opened: Page) -> None:
    plain = pixels_of(opened, "picture(reel, 0.05)")
    bloom = pixels_of(opened, "(useEffects({ strength: 1 }), pixels())")
    assert bloom.mean() > 1.1 * plain.mean()
    assert (bloom >= plain - 0.03).mean() > 0.99


def test_splats_that_write_depth_do_so_in_effects(opened: Page) -> None:
    pixels_of(opened, "picture(reel, 0.05)")
    later = pixels_of(opened, "(useEffects(), addPlane({ transparent: true })(20), pixels())")
    assert np.abs(later - GREEN).max() < 0.01
    hidden = pixels_of(opened, "(reel.depthWrite = true, pixels())")
    assert (np.abs(hidden - GREEN).max(-1) > 0.05).mean() > 0.05


def test_parts_of_render_targets_hold_a_reel_each(opened: Page) -> None:
    """Two viewports of a target, which a later pass shows."""
    whole = pixels_of(opened, "picture(reel, 0.05)")
    halves = pixels_of(
        opened,
        """() => {
          const target = new THREE.WebGLRenderTarget(320, 120, { type: THREE.HalfFloatType });
          const material = new THREE.MeshBasicMaterial({ map: target.texture });
          const screen = new THREE.Scene().add(new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material));
          const flat = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1);
          drawWith(() => {
            renderer.setRenderTarget(target);
            renderer.autoClear = false;
            renderer.clear();
            target.scissorTest = true;
            for (const left of [0, 160]) {
              target.viewport.set(left, 0, 160, 120);
              target.scissor.set(left, 0, 160, 120);
              renderer.setRenderTarget(target);
              renderer.render(scene, camera);
            }
            renderer.setRenderTarget(null);
            renderer.autoClear = true;
            material.map.repeat.x = 0.5;
            material.map.offset.x = 0.5;
            material.map.magFilter = material.map.minFilter = THREE.NearestFilter;
            renderer.render(screen, flat);
          });
          return pixels();
        }""",
    )
    assert psnr(halves, whole) >= 45


def test_an_orthographic_camera_sees_the_reel(opened: Page) -> None:
    """Its picture is that of a perspective camera far away; meshes hide splats behind them; rays meet splats."""
    opened.evaluate(
        "window.forward = camera.getWorldDirection(new THREE.Vector3()), window.eye = camera.position.clone()"
    )
    pixels_of(opened, "picture(reel, 0.05)")
    far = pixels_of(
        opened,
        """() => {
          const lens = new THREE.PerspectiveCamera((2 * Math.atan(1.5 / 1000) * 180) / Math.PI, 4 / 3, 900, 1100);
          lens.quaternion.copy(camera.quaternion);
          lens.position.copy(eye).addScaledVector(forward, 4 - 1000);
          drawWith(lens);
          return pixels();
        }""",
    )
    flat = pixels_of(
        opened,
        """() => {
          window.lens = new THREE.OrthographicCamera(-2, 2, 1.5, -1.5, 0.01, 100);
          lens.quaternion.copy(camera.quaternion);
          lens.position.copy(eye);
          drawWith(lens);
          return pixels();
        }""",
    )
    assert far.std() > 0.05
    assert psnr(flat, far) >= 35
    front = pixels_of(opened, "(window.move = addPlane(), move(1), pixels())")
    assert np.abs(front - GREEN).max() < 0.01
    middle = pixels_of(opened, "(move(4), pixels())")
    behind = pixels_of(opened, "(move(50), pixels())")
    assert np.abs(middle - behind).mean() > 0.01
    assert np.abs(middle - GREEN).mean() > 0.01
    distance = opened.evaluate(
        """() => {
          const ray = new THREE.Raycaster();
          ray.setFromCamera(new THREE.Vector2(0, 0), lens);
          return ray.intersectObject(reel)[0]?.distance ?? null;
        }"""
    )
    assert 2 < distance < 6


def test_fog_colors_splats_by_their_distance(opened: Page) -> None:
    clear = pixels_of(opened, "picture(reel, 0.05)")
    solid = clear.sum(-1) > 0.3
    thick = pixels_of(opened, "(scene.fog = new THREE.Fog(0x8040c0, 0.1, 0.2), pixels())")
    color = np.array([0x80, 0x40, 0xC0]) / 255
    hue = thick / np.maximum(thick.sum(-1, keepdims=True), 0.01)
    assert np.abs(hue - color / color.sum())[solid].max() < 0.03, "darker where the black background shows through"
    assert psnr(pixels_of(opened, "(scene.fog = new THREE.Fog(0x8040c0, 50, 90), pixels())"), clear) > 50
    thin = pixels_of(opened, "(scene.fog = new THREE.FogExp2(0x8040c0, 0.2), pixels())")
    assert 0.02 < np.abs(thin - clear)[solid].mean() < np.abs(thick - clear)[solid].mean()
    assert psnr(pixels_of(opened, "(reel.material.fog = false, pixels())"), clear) > 50


def test_a_clone_plays_for_itself(opened: Page) -> None:
    before = pixels_of(opened, "picture(reel, 0.05)")
    opened.evaluate(
        """async () => {
          Object.assign(reel, { opacity: 0.9, loop: true, depthWrite: true });
          reel.scale.setScalar(2);
          window.copy = reel.clone();
          reel.dispose();
          scene.remove(reel);
          scene.add(copy);
          await until(() => copy.canPlay || copy.error);
        }"""
    )
    same = "[copy.error, copy.opacity, copy.loop, copy.depthWrite, copy.muted, copy.scale.x, copy.currentTime]"
    assert opened.evaluate(same) == [None, 0.9, True, True, True, 2, 0.05]
    after = pixels_of(opened, "(copy.opacity = 1, copy.viewFromStart(camera), pixels())")
    assert psnr(after, before) > 40


def test_the_snippet_of_the_docs_shows_the_reel(page: Page, site: str) -> None:
    expect_snippet_to_draw(page, site, "three")


def test_rays_meet_splats(opened: Page) -> None:
    hits = opened.evaluate(
        """async () => {
          await picture(reel, 0.05);
          const ray = new THREE.Raycaster();
          const hit = (x, y) => (ray.setFromCamera(new THREE.Vector2(x, y), camera), ray.intersectObject(reel)[0]?.distance ?? null);
          const before = hit(0, 0);
          reel.scale.setScalar(2);
          reel.viewFromStart(camera);
          await pixels();
          const twice = hit(0, 0);
          camera.lookAt(camera.position.clone().multiplyScalar(2));
          camera.updateMatrixWorld();
          return [before, twice, hit(0, 0)];
        }"""
    )
    assert 2 < hits[0] < 6
    assert abs(hits[1] - 2 * hits[0]) < 0.05 * hits[0]
    assert hits[2] is None


def test_time_passes_and_ends(opened: Page) -> None:
    expect_time_to_end(opened)


def test_dispose_frees_all(opened: Page) -> None:
    counts = opened.evaluate(
        """async () => {
          reel.dispose();  // it may still upload groups
          scene.remove(reel);
          const gl = renderer.getContext();
          const held = new Set();
          for (const kind of ["Texture", "Buffer", "Framebuffer", "VertexArray", "Program"]) {
            const [make, free] = [gl[`create${kind}`].bind(gl), gl[`delete${kind}`].bind(gl)];
            gl[`create${kind}`] = () => { const made = make(); held.add(made); return made; };
            gl[`delete${kind}`] = (made) => { held.delete(made); free(made); };
          }
          const terminated = [];
          const terminate = Worker.prototype.terminate;
          Worker.prototype.terminate = function () { terminated.push(this); terminate.call(this); };
          const other = await openReel("reel/manifest.json", { loop: true, autoplay: true });
          const during = held.size;
          other.dispose();
          scene.remove(other);
          return [during, held.size, terminated.length, (await pixels()).length];
        }"""
    )
    assert counts[0] > 10
    assert counts[1] <= 3  # those of three.js for the material and the empty geometry
    assert counts[2] >= 2


def test_errors_are_events(page: Page, site: str) -> None:
    expect_errors_as_events(page, site)


PROMISES = """async (reel, dispose) => {
  const outcome = (promise) => promise.then(() => "done", ({ name, message }) => `${name}: ${message}`);
  const interrupted = outcome(reel.play());
  reel.pause();
  const started = outcome(reel.play());
  await until(() => !reel.paused && reel.currentTime > 0);
  dispose();
  return [await interrupted, await started, await outcome(reel.whenReady()), await outcome(reel.play())];
}"""


def expect_promises(found: list[str]) -> None:
    """Check the outcomes of an interrupted and a running `play()`, and of `whenReady()` and `play()` after the end."""
    assert found[0].startswith("AbortError")
    assert found[1] == "done"
    assert "disposed" in found[2]
    assert found[3].startswith("NotSupportedError")


def test_playing_is_a_promise_and_a_disposed_reel_is_never_ready(opened: Page) -> None:
    expect_promises(opened.evaluate(f"({PROMISES})(reel, () => (reel.dispose(), scene.remove(reel)))"))
    waiting = "(reel) => [reel.whenReady(), reel.dispose()][0].then(() => 'done', ({ message }) => message)"
    assert "disposed" in opened.evaluate(f"({waiting})(new reel.constructor('reel/manifest.json'))")


def test_a_second_renderer_is_told_to_take_a_clone(opened: Page) -> None:
    with opened.expect_console_message(lambda message: message.type == "warning") as told:
        opened.evaluate(
            """async () => {
              const other = new THREE.WebGLRenderer();
              for (let i = 0; i < 3; i++) other.render(scene, camera);
              other.dispose();
            }"""
        )
    assert "reel/manifest.json is drawn by one renderer only" in told.value.text
    assert "reel.clone()" in told.value.text
