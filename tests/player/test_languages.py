"""Texts in the language of the page or the browser, each within its control, and Arabic from right to left."""

import pytest
from playwright.sync_api import Browser, Page

from splatreel.play.server import Server
from tests.player.pages import let_frames_pass, open_body, open_player

pytestmark = pytest.mark.browser

REEL = '<splat-reel src="reel/manifest.json" controls style="width: 390px; height: 220px; aspect-ratio: auto"></splat-reel>'
CUT = """(all) => all.filter((one) => one.clientWidth > 0 && (one.scrollWidth > one.clientWidth + 1))
  .map((one) => one.textContent)"""
PLAY = {
    "ar": "تشغيل",
    "de": "Abspielen",
    "es": "Reproducir",
    "fr": "Lire",
    "ja": "再生",
    "pt": "Reproduzir",
    "zh": "播放",
}


@pytest.mark.parametrize("language", PLAY)
def test_a_page_in_another_language(page: Page, server: Server, language: str):
    open_body(page, server, REEL, f'lang="{language}"')
    reel = page.locator("splat-reel")
    reel.locator(f'.play[aria-label="{PLAY[language]}"]').wait_for()
    reel.locator(".settings").click()
    menu = reel.locator(".menu")
    menu.wait_for()
    assert menu.locator("label, button.wide").evaluate_all(CUT) == []
    assert "Speed" not in menu.inner_text()
    expected = "rtl" if language == "ar" else "ltr"
    assert menu.evaluate("(menu) => getComputedStyle(menu).direction") == expected
    assert reel.locator(".row").evaluate("(row) => getComputedStyle(row).direction") == "ltr"
    menu.locator("[name=help]").click()
    dialog = reel.get_by_role("dialog")
    dialog.wait_for()
    assert dialog.evaluate_all(CUT) == []
    assert "Play or pause" not in dialog.inner_text()


def test_the_nearest_language_is_the_elements(page: Page, server: Server):
    open_body(page, server, f'<div lang="fr">{REEL}</div>', 'lang="de"')
    page.locator('splat-reel .play[aria-label="Lire"]').wait_for()
    assert page.locator("splat-reel canvas").get_attribute("aria-label").startswith("Vidéo volumétrique. Glisser")  # pyright: ignore[reportOptionalMemberAccess]


def test_the_bundled_page_has_the_language_of_the_browser(browser: Browser, server: Server):
    page = browser.new_page(viewport={"width": 480, "height": 320}, locale="es-MX")
    open_player(page, server)
    page.locator('splat-reel .play[aria-label="Reproducir"]').wait_for()
    assert page.evaluate("document.documentElement.lang") == "es"
    page.close()


def test_without_its_file_the_texts_are_english(page: Page, server: Server):
    page.expected_problems = ("404",)  # pyright: ignore[reportAttributeAccessIssue]
    page.route("**/language-de.js", lambda route: route.fulfill(status=404, body=""))
    with page.expect_response("**/language-de.js"):
        open_body(page, server, REEL, 'lang="de"')
    let_frames_pass(page)
    assert page.locator("splat-reel .play").get_attribute("aria-label") == "Play"


@pytest.mark.parametrize("language", PLAY)
def test_the_editor_has_the_language_of_the_page(page: Page, server: Server, language: str):
    open_body(page, server, REEL.replace("220px", "700px"), f'lang="{language}"')
    reel = page.locator("splat-reel")
    reel.locator(f'.play[aria-label="{PLAY[language]}"]').wait_for()
    reel.locator(".settings").click()
    reel.locator(".menu [name=edit]").click()
    panel = reel.locator(".path-panel")
    panel.wait_for()
    assert panel.locator("label, legend, h2, button").evaluate_all(CUT) == []
    assert not {"Crop", "Box", "Mark", "Before", "Command", "Save", "Drag"} & set(panel.inner_text().split())
    labels = reel.locator(".corners input, .edit-drawing circle").evaluate_all(
        "(all) => all.map((one) => one.getAttribute('aria-label'))"
    )
    assert len(set(labels)) == 12
    assert not [label for label in labels if "box" in label]
    assert panel.evaluate("(one) => getComputedStyle(one).direction") == ("rtl" if language == "ar" else "ltr")
    assert panel.locator(".command").evaluate("(one) => getComputedStyle(one).direction") == "ltr"
