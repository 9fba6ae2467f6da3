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
