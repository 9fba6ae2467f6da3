"""Small embeds: messages and controls stay visible, and the page's styles do not reach the controls."""

import re

import pytest
from playwright.sync_api import Locator, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, expect_problems, wait_for_picture
from tests.player.screens import described, gone_second_group

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
SIZES = [(390, 220), (200, 120), (100, 60)]
EMBED = """<!doctype html><html {root}><style>body {{ margin: 0 }} {style}</style><script type="module" src="player.js"></script>
<splat-reel src="{src}" controls share style="width: {w}px; height: {h}px; aspect-ratio: auto"></splat-reel>"""
ON_TOP = """(element) => {
  const { left, top, width, height } = element.getBoundingClientRect();
  element.style.pointerEvents = "auto";
  const found = element.getRootNode().elementFromPoint(left + width / 2, top + height / 2);
  return found !== null && element.contains(found);
}"""


def open_embed(
    page: Page,
    server: Server,
    size: tuple[int, int] = (390, 220),
    src: str = "reel/manifest.json",
    style: str = "",
    root: str = "",
) -> Locator:
    body = EMBED.format(src=src, w=size[0], h=size[1], style=style, root=root)
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    page.goto(server.url + "embed.html")
    page.wait_for_function(f"{REEL}?.player")
    return page.locator("splat-reel")


def assert_in_sight(element: Locator, size: tuple[int, int]) -> None:
    """Assert that an element lies within the embed and that nothing covers its middle."""
    box = element.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["y"] >= 0
    assert box["x"] + box["width"] <= size[0]
    assert box["y"] + box["height"] <= size[1]
    assert element.evaluate(ON_TOP)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("state", ["missing", "stopped"])
def test_an_error_can_be_read_and_tried_again(page: Page, server: Server, size: tuple[int, int], state: str) -> None:
    expect_problems(page, "404")
    if state == "stopped":
        gone_second_group(page)
        reel = open_embed(page, server, size)
        wait_for_picture(page)
        page.evaluate(f"{PLAYER}.currentTime = 0.3")
    else:
        reel = open_embed(page, server, size, src="nowhere/manifest.json")
    panel = reel.get_by_role("alert")
    panel.wait_for()
    assert_in_sight(reel.get_by_role("button", name="Try again"), size)
    heading = panel.get_by_role("heading").bounding_box()
    button = reel.get_by_role("button", name="Try again").bounding_box()
    assert heading
    assert button
    assert heading["y"] >= 0
    assert heading["y"] + heading["height"] <= button["y"] + 1
    details = panel.get_by_text("Details")
    details.evaluate("(element) => element.scrollIntoView({ block: 'end' })")
    assert_in_sight(details, size)
    details.click()
    assert "404" in panel.locator("details div").inner_text()


def test_controls_that_are_of_no_use_make_way_for_an_error(page: Page, server: Server) -> None:
    """A reel that failed has no time and nothing to pause. The card has the whole picture."""
    expect_problems(page, "404")
    page.route("**/groups/*", lambda route: route.fulfill(status=404))
    reel = open_embed(page, server, (480, 270))
    page.evaluate("document.querySelector('splat-reel').play().catch(() => undefined)")
    reel.get_by_role("alert").wait_for()
    assert reel.get_by_role("button", name="Pause").count() == 0
    assert reel.locator(".bar").is_hidden()
    for part in ("h2", "p", "button", "summary"):
        assert_in_sight(reel.get_by_role("alert").locator(part), (480, 270))


@pytest.mark.parametrize("size", [(200, 80), (300, 90), (200, 96)])
def test_an_error_in_a_strip_is_seen_as_a_whole(page: Page, server: Server, size: tuple[int, int]) -> None:
    expect_problems(page, "404")
    reel = open_embed(page, server, size, src="nowhere/manifest.json")
    panel = reel.get_by_role("alert")
    panel.wait_for()
    for part in ("h2", "p", "button", "summary"):
        assert_in_sight(panel.locator(part), size)
    heading, button = panel.locator("h2").bounding_box(), panel.locator("button").bounding_box()
    assert heading
    assert button
    assert heading["x"] + heading["width"] <= button["x"]


def test_texts_and_buttons_grow_with_the_element(page: Page, server: Server) -> None:
    expect_problems(page, "404")
    reel = open_embed(page, server, src="nowhere/manifest.json")
    panel = reel.get_by_role("alert")
    panel.wait_for()
    sizes = []
    for width, height in [(1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (3840, 300)]:
        reel.evaluate(f"(reel) => Object.assign(reel.style, {{ width: '{width}px', height: '{height}px' }})")
        font = panel.locator("p").evaluate("(line) => parseFloat(getComputedStyle(line).fontSize)")
        sizes.append((font, panel.locator("button").evaluate("(button) => button.offsetHeight")))
    assert sizes == [(13, 36), (16.25, 45), (pytest.approx(21.45), 59), (pytest.approx(31.2), 86), (13, 36)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("touch", [False, True])
def test_the_controls_fit(page: Page, server: Server, size: tuple[int, int], touch: bool) -> None:
    if touch:
        page.context.new_cdp_session(page).send("Emulation.setTouchEmulationEnabled", {"enabled": True})
    reel = open_embed(page, server, size)
    wait_for_picture(page)
    buttons = reel.locator(".row button, .seek, .start").locator("visible=true")
    names = [buttons.nth(i).get_attribute("class") for i in range(buttons.count())]
    assert "play" in names
    assert "full" in names
    for i in range(buttons.count()):
        if "start" not in str(names[i]):
            assert_in_sight(buttons.nth(i), size)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")  # from button to button, past those that do not show
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement.checkVisibility()")
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement.className") != "play"


@pytest.mark.parametrize("touch", [False, True])
def test_the_big_button_stays_off_the_bar(page: Page, server: Server, touch: bool) -> None:
    if touch:
        page.context.new_cdp_session(page).send("Emulation.setTouchEmulationEnabled", {"enabled": True})
    reel = open_embed(page, server)
    wait_for_picture(page)
    shown = []
    for width, height in [(390, 240), (390, 220), (390, 200), (320, 180), (200, 120)]:
        reel.evaluate(f"(reel) => Object.assign(reel.style, {{ width: '{width}px', height: '{height}px' }})")
        start, seek = (reel.locator(name).bounding_box() for name in (".start", ".seek"))
        assert start
        assert seek
        shown.append(reel.locator(".seek").is_visible())
        clear = start["y"] + start["height"] < seek["y"] + seek["height"] / 2 - 4  # the line is in its middle
        assert clear or not shown[-1]
    assert shown == [True, not touch, not touch, False, False]
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    reel.locator(".start").wait_for(state="hidden")
    assert reel.locator(".seek").is_visible()


def test_the_columns_of_the_help_begin_at_one_height(page: Page, server: Server) -> None:
    reel = open_embed(page, server, (800, 500))
    page.set_viewport_size({"width": 800, "height": 500})
    wait_for_picture(page)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("?")
    reel.get_by_role("dialog").wait_for()
    tops = [heading.bounding_box() for heading in reel.locator(".dialog h3", has_text=re.compile("Time|View")).all()]
    assert len(tops) == 2
    assert tops[0]
    assert tops[1]
    assert tops[0]["y"] == pytest.approx(tops[1]["y"], abs=0.5)


@pytest.mark.parametrize("size", SIZES[:2])
def test_the_whole_menu_can_be_reached_and_left(page: Page, server: Server, size: tuple[int, int]) -> None:
    reel = open_embed(page, server, size)
    wait_for_picture(page)
    reel.get_by_role("button", name="Settings").click()
    for name in ("Speed", "Keys and gestures"):
        entry = reel.locator(".menu > *", has_text=name)
        entry.scroll_into_view_if_needed()
        assert_in_sight(entry, size)
    page.mouse.click(4, 4)
    assert reel.locator(".menu").is_hidden()


def test_what_is_copied_is_said_over_the_dialog_and_no_line_is_cut(page: Page, server: Server) -> None:
    described(page)
    page.set_viewport_size({"width": 800, "height": 520})
    reel = open_embed(page, server, (800, 500))
    wait_for_picture(page)
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name="Share").click()
    reel.get_by_role("dialog", name="Share").wait_for()
    areas = reel.locator("textarea")
    assert areas.count() == 3
    for i in range(3):
        height, line = areas.nth(i).evaluate(
            "(area) => [area.clientHeight, parseFloat(getComputedStyle(area).lineHeight)]"
        )
        assert height % line == 0
    reel.locator(".copy").first.click()
    toast = reel.locator(".toast.shown")
    toast.wait_for()
    assert toast.evaluate(ON_TOP)


def test_a_page_from_right_to_left_leaves_the_bar_as_it_is(page: Page, server: Server) -> None:
    reel = open_embed(page, server, (480, 320), root='dir="rtl"')
    wait_for_picture(page)
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    assert reel.locator(".bar").get_attribute("dir") == "ltr"
    everything = reel.locator(".bar, .bar .seek, .bar .time, .menu, .dialog, .panel, .gestures")
    assert set(everything.evaluate_all("(all) => all.map((one) => getComputedStyle(one).direction)")) == {"ltr"}
    track = reel.locator(".seek").bounding_box()
    assert track
    page.mouse.click(track["x"] + 0.75 * track["width"], track["y"] + track["height"] / 2)
    part = page.evaluate(f"{PLAYER}.currentTime / {PLAYER}.duration")
    assert part == pytest.approx(0.75, abs=0.05)
    filled = page.evaluate(f"{REEL}.shadowRoot.querySelector('.seek').style.getPropertyValue('--played')")
    assert float(filled.rstrip("%")) == pytest.approx(75, abs=5)
    page.mouse.move(track["x"] + 0.25 * track["width"], track["y"] + track["height"] / 2)
    assert reel.locator(".hint .at").inner_text() == "0:00.1"
    # The present time comes first.
    first = reel.locator(".time").evaluate(
        "(box) => { const range = document.createRange(); range.selectNodeContents(box.firstChild);"
        " return range.getBoundingClientRect().left < box.querySelector('span').getBoundingClientRect().left; }"
    )
    assert first


LOUD = """letter-spacing: 4px; word-spacing: 9px; text-transform: uppercase; line-height: 3; font-variant: small-caps;
font-feature-settings: 'smcp'; font-style: italic; font-weight: 900; text-indent: 20px; text-shadow: 1px 1px red; text-align: right;
white-space: pre; word-break: break-all; hyphens: auto; color: red;"""
NAMES = re.findall(r"([a-z-]+):", LOUD)
STYLES = f"""(all) => all.map((one) => {{
  const style = getComputedStyle(one);
  return [one.localName, ...{NAMES}.map((name) => style.getPropertyValue(name))].join();
}})"""


def test_text_of_the_page_around_does_not_change_the_controls(page: Page, server: Server) -> None:
    found = []
    for style in ("", f"body {{ {LOUD} }} splat-reel {{ {LOUD} }}"):
        reel = open_embed(page, server, (480, 320), style=style)
        wait_for_picture(page)
        page.locator("splat-reel canvas").focus()
        page.keyboard.press("?")
        reel.get_by_role("dialog").wait_for()
        page.keyboard.press("Escape")
        reel.get_by_role("button", name="Settings").click()
        reel.locator(".menu").get_by_role("button", name="Camera path").click()
        reel.locator(".path-panel").wait_for()
        texts = reel.locator(
            ":is(.ui, .gestures, .beyond, .path-panel) :is(p, label, button, select, input, h2, h3, dt, dd, div)"
        )
        found.append(texts.evaluate_all(STYLES))
        page.unroute("**/embed.html")
    assert len(found[0]) > 40
    assert found[0] == found[1]
