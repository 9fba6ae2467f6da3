"""The page of the demo in a browser: the sample plays, then the own reel from its first preview on."""

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from splatreel.base.progress import Silent
from splatreel.cli.demo import demo_player
from splatreel.codec.preview import write_preview
from splatreel.play import demo_page
from tests.codec.reels import new_header, points
from tests.golden import PREDICTIVE

pytestmark = pytest.mark.browser
REEL = "window.player.document.querySelector('splat-reel')"
"""The element in the frame of the page."""


def test_the_own_reel_replaces_the_sample_on_request_and_its_previews_in_place(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_page, "SAMPLE", PREDICTIVE)
    page = browser.new_page(viewport={"width": 480, "height": 320})
    with demo_player(Silent(), tmp_path, serve=True) as player:
        assert player is not None
        page.goto(player.page)
        page.wait_for_function(f"{REEL}?.readyState > 2 && !{REEL}.paused")
        write_preview(tmp_path, new_header(), None, points(20))
        page.get_by_role("link", name="Watch your own reel").click()
        for count in (20, 30):
            write_preview(tmp_path, new_header(), None, points(count))
            page.wait_for_function(f"{REEL}?.player?.manifest?.layers[0]?.points === {count} && {REEL}.readyState > 1")
        shutil.copytree(PREDICTIVE, tmp_path / "reel")
        page.wait_for_function(f"{REEL}?.player?.manifest?.groups.length === 2 && !{REEL}.player.live")
        page.wait_for_function(f"{REEL}.readyState > 2")
        assert page.evaluate(f"{REEL}.error") is None
    page.close()
