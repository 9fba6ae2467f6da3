"""axe-core finds no fault in the reel's page, in any state, in light and dark colors."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from splatreel.play.server import Server
from tests.player import screens
from tests.player.pages import wait_for_transitions

pytestmark = pytest.mark.browser

AXE = Path(__file__).parents[2] / "player" / "node_modules" / "axe-core" / "axe.min.js"
RUN = """() => axe.run(document).then(({violations}) =>
  violations.flatMap(({id, nodes}) => nodes.map(({target, failureSummary}) => [id, target.flat().join(" "), failureSummary])))"""


@pytest.fixture
def wide(browser: Browser) -> Iterator[Page]:
    if not AXE.is_file():
        pytest.skip("axe-core is not installed (npm ci in player/)")
    page = browser.new_page(viewport={"width": 800, "height": 600}, reduced_motion="reduce")
    yield page
    page.close()


def assert_accessible(page: Page, state: str) -> None:
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        wait_for_transitions(page)
        assert page.evaluate(RUN) == [], f"{state}, {scheme}"


def go(page: Page, server: Server, query: str = screens.GIVEN) -> None:
    page.goto(server.url + query)
    page.wait_for_function("document.querySelector('splat-reel')?.player")


def test_in_use(wide: Page, server: Server):
    """One page goes through the states of playback."""
    screens.described(wide)
    go(wide, server)
    screens.fresh(wide)
    assert_accessible(wide, "start")
    screens.play(wide)
    assert_accessible(wide, "playing")
    screens.begin(wide)
    wide.keyboard.press("i")
    assert_accessible(wide, "statistics")
    wide.keyboard.press("Shift")  # the controls have gone to sleep
    wide.locator("splat-reel").get_by_role("button", name="Settings").click()
    wide.locator("splat-reel .menu").wait_for()
    assert_accessible(wide, "menu")
    wide.keyboard.press("Escape")
    wide.keyboard.press("?")
    wide.locator("splat-reel").get_by_role("dialog").wait_for()
    assert_accessible(wide, "help")
    wide.keyboard.press("Escape")
    for entry in ("Share", "About this reel"):
        screens.opened(entry)(wide)
        assert_accessible(wide, entry)
        wide.keyboard.press("Escape")
    screens.thumbnail(wide)
    assert_accessible(wide, "thumbnail")
    wide.evaluate("document.querySelector('splat-reel').player.canvas.focus()")
    wide.keyboard.press("g")
    wide.locator("splat-reel .walk").wait_for()
    assert_accessible(wide, "walk")
    wide.keyboard.press("g")
    screens.path(wide)
    assert_accessible(wide, "camera path")


def test_without_a_reel(wide: Page, server: Server):
    screens.no_reel(wide)
    go(wide, server, "?autoplay=0")
    screens.ask(wide)
    assert_accessible(wide, "ask")


@pytest.mark.parametrize(
    ("before", "act"),
    [
        pytest.param(screens.no_second_group, screens.wait, id="waiting"),
        pytest.param(screens.no_reel, screens.detail, id="error"),
        pytest.param(screens.gone_second_group, screens.stop, id="stopped"),
        pytest.param(screens.live_reel, screens.hint, id="live and hint"),
    ],
)
def test_otherwise(wide: Page, server: Server, before: Callable[[Page], None], act: Callable[[Page], None]):
    before(wide)
    go(wide, server)
    act(wide)
    assert_accessible(wide, act.__name__)


def test_axe_sees_into_the_player(wide: Page, server: Server):
    go(wide, server)
    screens.fresh(wide)
    wide.locator("splat-reel .settings").evaluate(
        "(button) => ['aria-label', 'title'].forEach((name) => button.removeAttribute(name))"
    )
    with pytest.raises(AssertionError, match="button-name"):
        assert_accessible(wide, "unnamed")
