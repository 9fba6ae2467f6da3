"""Fixtures of the browser tests: a headless Chromium with software WebGL 2, a page that must report no problem, a server."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from splatreel.play.server import Server, serve
from tests.golden import GOLDEN

if TYPE_CHECKING:
    from playwright import sync_api as playwright
else:
    playwright = pytest.importorskip("playwright.sync_api", reason="the browser tests need the playwright package")

FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync", "--disable-gpu"]
PATIENCE = 120_000
"""Milliseconds."""


@pytest.fixture(scope="session")
def browser() -> Iterator[playwright.Browser]:
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next((found for found in map(shutil.which, names) if found), None)
    if path is None:
        pytest.skip("the browser tests need Chromium (apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=FLAGS)
        running.new_page = partial(_patient, running.new_page)
        running.new_context = partial(_patient, running.new_context)
        yield running
        running.close()


def _patient(make: Callable[..., Any], **options: Any) -> Any:
    """Make a page or a context with long timeouts, because a busy machine draws a few images per second.

    The page's policy forbids the `eval` by which tests wait; test_origins.py lets it hold.
    """
    made = make(**{"bypass_csp": True} | options)
    made.set_default_timeout(PATIENCE)
    return made


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    with serve(GOLDEN, port=0) as running:
        yield running


@pytest.fixture
def bypass_csp() -> bool:
    """True to ignore a page's Content-Security-Policy."""
    return True


@pytest.fixture
def page(browser: playwright.Browser, bypass_csp: bool) -> Iterator[playwright.Page]:
    """A page. The test fails if the page reports a problem that `expect_problems` did not name."""
    page = browser.new_page(viewport={"width": 480, "height": 320}, bypass_csp=bypass_csp)
    problems: list[str] = []

    def listen(message: playwright.ConsoleMessage) -> None:
        if message.type == "error":
            problems.append(message.text)

    page.on("console", listen)
    page.on("pageerror", lambda error: problems.append(str(error)))
    yield page
    expected = getattr(page, "expected_problems", ())
    page.close()
    assert [text for text in problems if not any(part in text for part in expected)] == []


@pytest.fixture
def phone(browser: playwright.Browser) -> Iterator[playwright.Page]:
    """A page on a touch screen."""
    page = browser.new_page(viewport={"width": 320, "height": 480}, has_touch=True, is_mobile=True)
    yield page
    page.close()


@pytest.fixture
def fingers(phone: playwright.Page) -> playwright.CDPSession:
    """Touches the phone's screen."""
    return phone.context.new_cdp_session(phone)
