"""Browser tests wait for conditions, never for a fixed time."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.player.pages import MOVING, let_frames_pass, let_time_pass, open_player, wait_for_transitions, wait_until

HERE = Path(__file__).parent


def test_no_test_waits_for_a_fixed_time() -> None:
    """`wait_until` looks again after some milliseconds. No other file may wait so."""
    fixed = re.compile(r"\.wait_for_timeout\(")
    waiting = [path.name for path in HERE.rglob("*.py") if fixed.search(path.read_text(encoding="utf-8"))]
    assert waiting == ["pages.py"]


@pytest.mark.browser
def test_waits_end_when_their_condition_holds(page: Page, server: Server) -> None:
    open_player(page, server)
    page.evaluate("window.frames = 0; (function count() { frames++; requestAnimationFrame(count); })()")
    begun = page.evaluate("frames")
    let_frames_pass(page, 5)
    assert page.evaluate("frames") >= begun + 5
    now = page.evaluate("performance.now()")
    let_time_pass(page, 60)
    assert page.evaluate("performance.now()") >= now + 60
    looks = iter([False, False, True])
    wait_until(page, lambda: next(looks))
    assert list(looks) == []


@pytest.mark.browser
def test_transitions_of_the_player_are_seen(page: Page, server: Server) -> None:
    open_player(page, server)
    move = "(canvas) => { canvas.animate({ opacity: [1, 0.5] }, DURATION); }"
    canvas = page.locator("splat-reel canvas").first
    canvas.evaluate(move.replace("DURATION", "{ duration: 1e6, iterations: Infinity }"))
    wait_for_transitions(page)
    canvas.evaluate(move.replace("DURATION", "200"))
    assert page.evaluate(MOVING)
    wait_for_transitions(page)
    assert not page.evaluate(MOVING)
