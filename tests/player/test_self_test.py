"""The self-test page on a simulated phone: each gesture is ticked off once the reel has followed it."""

import re
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest
from playwright.sync_api import Browser, CDPSession, Page
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_frames_pass
from tests.player.test_accessibility import AXE, RUN
from tests.player.test_gestures import touch

pytestmark = pytest.mark.browser

NAMES = ["First picture", "Frame time", "Drag", "Pinch", "Double tap", "Sound", "Rotation"]


@pytest.fixture
def phone(browser: Browser) -> Iterator[Page]:
    page = browser.new_page(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    yield page
    page.close()


def wait_for_step(page: Page, name: str, timeout: float | None = None) -> None:
    page.wait_for_function(f"document.querySelector('[aria-current=step]')?.textContent === '{name}'", timeout=timeout)


def result(page: Page) -> dict[str, str]:
    """Return the rows of the result."""
    page.locator(".result").wait_for()
    text = page.locator("textarea").input_value()
    return dict(re.findall(r"^\| (.*?) \| (.*) \|$", text, re.M))


def double_tap_until(page: Page, name: str, x: int, y: int) -> None:
    """Double-tap the reel in its first view until the next step begins. On a busy machine two taps may be too far apart."""
    for _ in range(20):
        page.evaluate(f"{PLAYER}.camera.reset()")
        page.wait_for_function(f"{PLAYER}.camera.glide === null")
        for _ in range(2):
            page.touchscreen.tap(x, y)
        with suppress(PlaywrightTimeoutError):
            wait_for_step(page, name, timeout=2000)
            return
    pytest.fail("the double tap does nothing")


def skip_all(page: Page, since: int = 2) -> None:
    for name in NAMES[since:]:
        wait_for_step(page, name)
        page.get_by_role("button", name="Skip").click()


def test_a_phone_passes_all_tests(phone: Page, fingers: CDPSession, server: Server) -> None:
    phone.goto(f"{server.url}self-test.html")
    wait_for_step(phone, "Drag")
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    x, y = 195, 150
    touch(fingers, "touchStart", (x, y))
    for part in np.linspace(0.1, 1, 10):
        touch(fingers, "touchMove", (x + 120 * part, y))
        let_frames_pass(phone, 1)
    touch(fingers, "touchEnd")
    wait_for_step(phone, "Pinch")
    for kind, half in (("touchStart", 40), ("touchMove", 60), ("touchMove", 80)):
        touch(fingers, kind, (x, y - half), (x, y + half))
    touch(fingers, "touchEnd")
    wait_for_step(phone, "Double tap")
    double_tap_until(phone, "Sound", x, y)
    phone.get_by_role("button", name="Play", exact=True).click()
    phone.get_by_role("button", name="I heard it").click()
    wait_for_step(phone, "Rotation")
    phone.set_viewport_size({"width": 844, "height": 390})
    found = result(phone)
    assert {name: found[name].split(":")[0] for name in NAMES} == dict.fromkeys(NAMES, "passed")
    assert re.search(r"median \d+\.\d ms, 95th percentile \d+\.\d ms; \d+ pictures in 4 s", found["Frame time"])
    assert re.search(r"decoded files \d\.\d MB, scripts \d+\.\d MB of at most", found["Memory"])
    assert re.search(r"texture size \d{4,}", found["WebGL limits"])
    assert "median" in found["Decode time"]
    assert found["Problems"] == "none"
    assert "390 x 844 to 844 x 390" in found["Rotation"]
    phone.get_by_role("button", name="Copy").click()
    phone.get_by_text(re.compile("^(Copied|Selected)")).wait_for()


def test_tests_can_be_skipped_or_reported_as_broken(page: Page, server: Server) -> None:
    page.goto(f"{server.url}self-test.html")
    wait_for_step(page, "Drag")
    page.get_by_role("button", name="It does not work").click()
    skip_all(page, since=3)
    found = result(page)
    assert found["Drag"] == "failed"
    assert [found[name] for name in NAMES[3:]] == ["skipped"] * 4


def test_a_reel_that_cannot_be_played_ends_at_once_with_its_error(page: Page, server: Server) -> None:
    page.expected_problems = ("404",)  # pyright: ignore[reportAttributeAccessIssue]
    page.goto(f"{server.url}self-test.html?src=reel/none.json")
    found = result(page)
    assert found["First picture"].startswith("failed: ")
    assert found["Drag"] == "skipped: the reel cannot be played"
    assert "404" in found["Problems"]


def test_the_page_is_accessible(page: Page, server: Server) -> None:
    if not AXE.is_file():
        pytest.skip("axe-core is not installed (npm ci in player/)")
    page.goto(f"{server.url}self-test.html")
    wait_for_step(page, "Drag")
    page.evaluate(AXE.read_text())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate(RUN) == []
    skip_all(page)
    page.locator(".result").wait_for()
    assert page.evaluate(RUN) == []
