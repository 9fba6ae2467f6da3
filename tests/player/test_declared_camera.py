"""Camera attributes: they set view and field of view, follow changes, give way to people and links, and say what is wrong."""

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from splatreel.play.timeline import open_reel
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, let_frames_pass, let_time_pass, open_body, wait_until_near

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"


def reel(attributes: str) -> str:
    return f'<splat-reel src="reel/manifest.json" {attributes} style="width: 240px; height: 160px"></splat-reel>'


def eye(page: Page) -> np.ndarray:
    return np.array(page.evaluate(f"{PLAYER}.camera.state.eye"))


def test_attributes_set_the_view_and_its_lens(page: Page, server: Server):
    open_body(page, server, reel('camera-orbit="180deg auto 50%" field-of-view="60deg"'))
    page.wait_for_function(f"{PLAYER}.camera.fieldOfView !== null")
    own = page.evaluate(f"{PLAYER}.camera.ownState")
    assert page.evaluate(f"{PLAYER}.camera.state.distance") == pytest.approx(own["distance"] / 2)
    up = np.array(open_reel(GOLDEN).manifest.up)
    middle = page.evaluate(f"{PLAYER}.camera.ownState.eye")
    assert (eye(page) - middle) @ up == pytest.approx(0, abs=2)
    fy = page.evaluate(f"{REEL}.camera.K[4]")
    assert fy == pytest.approx(80 / np.tan(np.pi / 6))
    page.evaluate(f"{REEL}.setAttribute('camera-orbit', 'auto auto auto')")
    page.wait_for_function(f"{PLAYER}.camera.state.distance === {own['distance']}")
    page.evaluate(f"{PLAYER}.camera.orbit(0.3, 0); {REEL}.setAttribute('camera-orbit', '90deg auto 200%')")
    let_frames_pass(page)
    assert page.evaluate(f"{PLAYER}.camera.state.distance") == pytest.approx(own["distance"])


def test_a_link_takes_precedence(page: Page, server: Server):
    open_body(page, server, reel('share camera-orbit="90deg auto 50%"'))
    page.wait_for_function(f"{PLAYER}.camera.state.distance < 0.6 * {PLAYER}.camera.ownState.distance")
    page.evaluate(f"{PLAYER}.camera.orbit(0.2, 0.1)")
    link, there = page.evaluate(f"{REEL}.link"), eye(page)
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_function(f"{REEL}?.readyState >= 2")
    wait_until_near(page, f"{PLAYER}.camera.state.eye", there.tolist(), 1e-3)


def test_a_wrong_attribute_is_named(page: Page, server: Server):
    warnings: list[str] = []
    page.on("console", lambda message: warnings.append(message.text))
    open_body(page, server, reel('camera-orbit="45 90deg 2" field-of-view="30deg"'))
    page.wait_for_function(f"{PLAYER}.camera.fieldOfView !== null")
    message = (
        '<splat-reel camera-orbit>: "45" is not an angle. Write it with its unit, such as 45deg or 0.8rad, or auto.'
    )
    assert [text for text in warnings if "splat-reel" in text] == [f"{message} The attribute has no effect."]
    assert page.evaluate(f"{PLAYER}.camera.atStart") is True


def test_auto_rotate_waits_for_people(page: Page, server: Server):
    open_body(page, server, reel('auto-rotate auto-rotate-delay="100" rotation-per-second="90deg"'))
    first = eye(page)
    page.wait_for_function(f"Math.hypot(...{PLAYER}.camera.state.eye.map((x, i) => x - {first.tolist()}[i])) > 0.05")
    page.mouse.move(120, 80)
    page.mouse.down()
    page.mouse.move(125, 80)
    held = eye(page)
    let_time_pass(page, 400)  # the delay of the rotation is over
    assert np.allclose(eye(page), held)
    page.mouse.up()
