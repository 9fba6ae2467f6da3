"""Functions of the browser tests that open the player, query it, and wait for it."""

import time
from collections.abc import Callable

from playwright.sync_api import Page

from splatreel.play.server import Server

PLAYER = "document.querySelector('splat-reel').player"
PATIENCE_S = 120.0
"""Seconds after which a condition counts as never met."""
FRAMES = """(count) => new Promise((resolve) => {
  const next = () => (count-- > 0 ? requestAnimationFrame(next) : resolve());
  next();
})"""
MOVING = """[document, ...[...document.querySelectorAll('splat-reel')].map((reel) => reel.shadowRoot)]
  .flatMap((root) => root.getAnimations())
  .some(({ playState, effect }) => playState === 'running' && effect.getComputedTiming().endTime < Infinity)"""
"""Expression that is true while a transition runs, or an animation that ends."""


def open_player(page: Page, server: Server, query: str = "?autoplay=0") -> None:
    """Open the page and wait for the first complete image."""
    page.goto(server.url + query)
    wait_for_picture(page)


def wait_for_picture(page: Page) -> None:
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.canPlay")


def wait_until(page: Page, met: Callable[[], object]) -> None:
    """Wait until a condition holds that Python checks. The page goes on meanwhile."""
    deadline = time.monotonic() + PATIENCE_S
    while not met():
        assert time.monotonic() < deadline, "the condition was never met"
        page.wait_for_timeout(20)


def let_frames_pass(page: Page, count: int = 12) -> None:
    """Wait until the page drew some frames, in each of which the player could have done what a test rules out."""
    page.evaluate(FRAMES, count)


def let_time_pass(page: Page, milliseconds: float) -> None:
    """Wait until the page's clock is past a limit of the player, such as the longest time between two taps."""
    page.wait_for_function(f"performance.now() >= {page.evaluate('performance.now()') + milliseconds}")


def wait_for_transitions(page: Page) -> None:
    """Wait until no part of the page or the player moves or fades."""
    let_frames_pass(page, 2)  # a transition begins with the frame after its cause
    page.wait_for_function(f"!{MOVING}")


def wait_until_near(page: Page, expression: str, expected: float | list[float], margin: float) -> None:
    """Wait until a number, or each of a list, is within a margin of what is expected."""
    values = expected if isinstance(expected, list) else [expected]
    near = f"{values}.every((value, i) => Math.abs(value - [{expression}].flat()[i]) <= {margin})"
    page.wait_for_function(near)


def wait_for_style(page: Page, selector: str, name: str, value: str) -> None:
    """Wait until a part of the player has a computed style."""
    part = f"document.querySelector('splat-reel').shadowRoot.querySelector({selector!r})"
    page.wait_for_function(f"getComputedStyle({part})[{name!r}] === {value!r}")


def expect_problems(page: Page, *parts: str) -> None:
    """Let the page report problems whose text contains one of these parts."""
    page.expected_problems = parts  # pyright: ignore[reportAttributeAccessIssue]


def add_file(page: Page, name: str, text: str) -> None:
    """Let the page find a text file of this name, in any folder."""
    kind = {"html": "text/html", "vtt": "text/vtt"}[name.rsplit(".", 1)[1]]
    page.route(f"**/{name}", lambda route: route.fulfill(content_type=f"{kind}; charset=utf-8", body=text))


def open_body(page: Page, server: Server, body: str, root: str = "") -> None:
    """Open a page that holds the player and this body, and wait for the first complete image. root: attributes of `<html>`."""
    style = "<style>body { margin: 0 }</style><script type='module' src='player.js'></script>"
    add_file(page, "body.html", f"<!doctype html><html {root}>{style}{body}")
    page.goto(server.url + "body.html")
    wait_for_picture(page)
