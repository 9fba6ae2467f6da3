"""One HTML file with player and reel, opened from disk."""

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.codec.manifest import edit_reel
from splatreel.play.player_page import write_standalone
from tests.flashes import GOLDEN as SOUND
from tests.player.pages import PLAYER, wait_for_picture

pytestmark = pytest.mark.browser

AUDIO = f"{PLAYER}.soundtrack.audio"


def test_it_plays_and_sounds_from_a_disk_and_asks_the_network_for_nothing(page: Page, tmp_path: Path) -> None:
    reel = shutil.copytree(SOUND, tmp_path / "reel")
    edit_reel(reel, {"title": "Flashes </script><b>"})
    write_standalone(tmp_path / "reel.html", reel)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((tmp_path / "reel.html").as_uri() + "?autoplay=0")
    wait_for_picture(page)
    assert page.title() == "Flashes </script><b>"
    page.locator("splat-reel .start").click()
    page.wait_for_function(f"!{AUDIO}.paused && {AUDIO}.currentTime > 0.05 && {PLAYER}.currentTime > 0.05")
    picture = """(async () => {
        const reel = document.querySelector("splat-reel"), { K, viewmat, width, height } = reel.camera;
        const { data } = await reel.renderAt(2.5, { K, viewmat }, width, height);
        return data.filter((value, i) => i % 4 < 3 && value > 20).length;
    })()"""
    assert page.evaluate(picture) > 2000, "the picture is black"
    page.locator("splat-reel").get_by_role("button", name="Settings").click()
    page.locator("splat-reel").get_by_role("button", name="Camera path").click()
    page.locator("splat-reel .path-panel").get_by_role("button", name="Add this view").click()
    assert page.evaluate("document.querySelector('splat-reel').path.keyframes.length") == 1
    assert [url for url in asked if not url.startswith(("file:", "blob:"))] == []
