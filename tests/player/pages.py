"""Functions of the browser tests that open the player and query it."""

from playwright.sync_api import Page

from splatreel.play.server import Server

PLAYER = "document.querySelector('splat-reel').player"


def open_player(page: Page, server: Server, query: str = "?autoplay=0") -> None:
    """Open the page and wait for the first complete image."""
    page.goto(server.url + query)
    wait_for_picture(page)


def wait_for_picture(page: Page) -> None:
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.canPlay")


def expect_problems(page: Page, *parts: str) -> None:
    """Let the page report problems whose text contains one of these parts."""
    page.expected_problems = parts  # pyright: ignore[reportAttributeAccessIssue]
