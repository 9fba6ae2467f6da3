"""Camera paths in the player: the element's property, playing, and the panel."""

import json
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.film import read_path
from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_player

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"


def path_through_golden(seconds: float, times: tuple[float, float]) -> dict:
    """Return a path from the reel's own camera to one a unit farther away."""
    start = open_reel(GOLDEN).manifest.camera.viewmat.astype(float)
    end = start.copy()
    end[2, 3] += 1
    keyframes = [
        {"at": at, "time": time, "viewmat": pose.ravel().tolist()}
        for at, time, pose in zip((0, seconds), times, (start, end), strict=True)
    ]
    return {"format": "splatreel-path", "version": 1, "loop": False, "keyframes": keyframes}


def test_the_element_takes_a_path_and_plays_it_to_its_end(page: Page, server: Server):
    open_player(page, server)
    path = path_through_golden(0.6, (0.1, 0.4))
    assert page.evaluate(f"{REEL}.path") is None
    page.evaluate(f"path => {{ {REEL}.path = path }}", path)
    assert page.evaluate(f"{REEL}.path") == path
    page.evaluate(f"{REEL}.playPath()")
    assert page.evaluate(f"{PLAYER}.camera.viewmat[11]") == pytest.approx(path["keyframes"][1]["viewmat"][11], abs=1e-5)
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.4)
    assert page.evaluate(f"[{PLAYER}.paused, {PLAYER}.playbackRate, {PLAYER}.loop]") == [True, 1, True]


def test_reel_and_camera_keep_in_step_and_a_still_leg_stands(page: Page, server: Server):
    open_player(page, server)
    path = path_through_golden(0.5, (0, 0.4))
    path["keyframes"].append(path["keyframes"][1] | {"at": 0.9})
    page.evaluate(f"path => {{ {REEL}.path = path }}", path)
    seen = page.evaluate(f"""async () => {{
        const seen = [], done = {REEL}.playPath();
        let over = false;
        done.then(() => (over = true));
        while (!over) {{
            await new Promise(requestAnimationFrame);
            const following = {PLAYER}.camera.following;
            if (following) seen.push([following.at, {PLAYER}.currentTime, {PLAYER}.paused]);
        }}
        return seen;
    }}""")
    at, time, paused = map(np.array, zip(*seen, strict=True))
    # The longest step of a busy machine is a quarter of a second.
    assert np.abs(np.interp(at, [0, 0.5, 0.9], [0, 0.4, 0.4]) - time).max() < 0.26
    assert paused[at > 0.75].all()


def test_a_hand_on_the_camera_or_on_time_ends_it(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"path => {{ {REEL}.path = path }}", path_through_golden(20, (0, 0.4)))
    for hand in (f"{PLAYER}.camera.orbit(0.1, 0)", f"{PLAYER}.currentTime = 0.2", f"{PLAYER}.play()"):
        page.evaluate(f"(window.done = {REEL}.playPath(), undefined)")
        page.wait_for_function(f"{PLAYER}.camera.following?.at > 0.05")
        page.evaluate(hand)
        page.evaluate("window.done")
        assert page.evaluate(f"{REEL}.pathPlayer.playing") is False
        page.evaluate(f"{PLAYER}.pause()")


def test_what_is_no_path_is_refused(page: Page, server: Server):
    open_player(page, server)
    error = page.evaluate(
        f"(() => {{ try {{ {REEL}.path = {{ format: 'x' }} }} catch (error) {{ return error.message }} }})()"
    )
    assert error.startswith('path is not a camera path: its format is "x"')
    assert page.evaluate(f"{REEL}.playPath().catch(error => error.message)").startswith("There is no camera path")


def open_panel(page: Page) -> None:
    page.locator("splat-reel").get_by_role("button", name="Settings").click()
    page.locator("splat-reel").get_by_role("button", name="Camera path").click()
    page.locator("splat-reel .path-panel").wait_for()


def test_the_panel_makes_shows_saves_and_loads_a_path(page: Page, server: Server, tmp_path: Path):
    page.set_viewport_size({"width": 640, "height": 480})
    open_player(page, server)
    open_panel(page)
    panel = page.locator("splat-reel .path-panel")
    panel.get_by_role("button", name="Add this view").click()
    page.evaluate(f"{PLAYER}.currentTime = 0.3; {PLAYER}.camera.orbit(0.5, 0); {PLAYER}.camera.zoom(1.5)")
    panel.get_by_role("button", name="Add this view").click()
    assert page.evaluate(f"{REEL}.path.keyframes.map(k => [k.at, k.time])") == [[0, 0], [0.3, 0.3]]
    panel.get_by_label("Seconds of keyframe 2").fill("1.5")
    panel.get_by_label("Seconds of keyframe 2").press("Enter")
    assert page.evaluate(f"{REEL}.path.keyframes[1].at") == 1.5
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.3), "digits typed into the panel are no keys"
    page.evaluate(f"{PLAYER}.camera.zoom(1.5); {PLAYER}.invalidate()")
    page.wait_for_function(f"{REEL}.shadowRoot.querySelectorAll('.path-drawing text').length === 2")
    assert len(page.locator("splat-reel .path-drawing .curve").get_attribute("d") or "") > 50
    panel.get_by_role("button", name="Return").click()
    panel.get_by_role("switch").click()
    with page.expect_download() as download:
        panel.get_by_role("button", name="Save").click()
    saved = tmp_path / download.value.suggested_filename
    download.value.save_as(saved)
    path = read_path(saved)
    assert (saved.name, path.loop, path.seconds, len(path.keyframes)) == ("camera-path.json", True, 3.5, 3)
    panel.get_by_role("button", name="Delete keyframe 1").click()
    assert page.evaluate(f"{REEL}.path.keyframes.length") == 2
    panel.locator("input[type=file]").set_input_files(saved)
    page.wait_for_function(f"{REEL}.path.keyframes.length === 3")
    panel.get_by_role("button", name="Go to keyframe 1").click()
    start = open_reel(GOLDEN).manifest.camera.viewmat.ravel()
    assert np.allclose(page.evaluate(f"{PLAYER}.camera.viewmat"), start, atol=1e-5)
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps({"format": "splatreel-path", "version": 3}))
    panel.locator("input[type=file]").set_input_files(bad)
    panel.get_by_text("bad.json cannot be loaded. path is not a camera path: its version is 3").wait_for()
    page.keyboard.press("Escape")
    panel.wait_for(state="detached")


def test_the_panel_goes_through_the_captures_cameras(page: Page, server: Server):
    page.set_viewport_size({"width": 640, "height": 480})
    open_player(page, server)
    open_panel(page)
    page.locator("splat-reel .path-panel").get_by_role("button", name="Through the cameras").click()
    reel = open_reel(GOLDEN)
    keyframes = page.evaluate(f"{REEL}.path.keyframes")
    assert keyframes[-1]["time"] == pytest.approx(reel.duration)
    assert len(keyframes) in (len(reel.manifest.cameras), len(reel.manifest.cameras) + 1)
    page.locator("splat-reel .path-panel").get_by_role("button", name="Play").click()
    page.wait_for_function(f"{PLAYER}.camera.following?.at > 0.1")
    page.locator("splat-reel .path-panel").get_by_role("button", name="Stop").click()
    assert page.evaluate(f"{REEL}.pathPlayer.playing") is False
