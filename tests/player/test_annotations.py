"""Annotations: elements of the page at points of the scene, for a part of the time, hidden behind points."""

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_time_pass, open_body

pytestmark = pytest.mark.browser

REEL = """<splat-reel src="reel/manifest.json" style="width: 240px; height: 160px">
  <button slot="annotation-middle" data-position="{}" data-time="0 0.2" onclick="window.clicked = true">Here</button>
  <b slot="annotation-wrong" data-position="1 2">Nowhere</b>
</splat-reel>"""
PIVOT = (
    f"(() => {{ const {{ viewmat: m, state: {{ eye }} }} = {PLAYER}.camera; "
    "return eye.map((x, a) => x + DEPTH * m[8 + a]); })()"
)


def test_an_annotation_stays_at_its_point_and_time(page: Page, server: Server):
    warnings: list[str] = []
    page.on("console", lambda message: warnings.append(message.text))
    open_body(page, server, REEL.format("0 0 0"))
    assert [text for text in warnings if 'data-position="1 2" is not a position' in text]
    # The nearest point that the middle shows, a little before it.
    depth = page.evaluate(f"{PLAYER}.stage.depthAt({PLAYER}.canvas.width / 2, {PLAYER}.canvas.height / 2)")
    move = f"document.querySelector('button').dataset.position = {PIVOT}.join(' ')"
    page.evaluate(move.replace("DEPTH", str(0.99 * depth)))
    here = page.locator("button")
    here.wait_for()
    view = page.evaluate("document.querySelector('splat-reel').camera.K")
    box = here.bounding_box()
    assert box is not None
    middle = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    assert np.allclose(middle, [view[2], view[5]], atol=1.5)
    let_time_pass(page, 600)  # by then the player has hidden what is behind the surface
    here.click()
    assert page.evaluate("window.clicked") is True
    page.evaluate(move.replace("DEPTH", str(2 * depth)))
    page.locator("splat-reel .annotation.behind").wait_for(state="attached")
    here.wait_for(state="hidden")
    page.evaluate(move.replace("DEPTH", str(0.99 * depth)))
    here.wait_for()
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    here.wait_for(state="hidden")
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    here.wait_for()
