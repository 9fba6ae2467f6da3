"""The player in a frame with `sandbox="allow-scripts"`, which has no origin of its own."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.player_page import STATIC
from tests.golden import GOLDEN, PREDICTIVE
from tests.player.hosts import host
from tests.player.pages import expect_problems

pytestmark = pytest.mark.browser

CORS = {"Access-Control-Allow-Origin": "*"}
FRAME = '<!doctype html><link rel="icon" href="data:," /><iframe sandbox="allow-scripts" src="{src}"></iframe>'
EMBED = """<!doctype html><script type="module" src="player/player.js"></script>
<splat-reel src="reel/manifest.json" controls></splat-reel>"""


@pytest.mark.parametrize("reel", [GOLDEN, PREDICTIVE], ids=["h265", "predictive"])
@pytest.mark.parametrize("src", ["embed.html", "player/index.html?src=../reel/manifest.json"], ids=["element", "page"])
def test_it_plays_in_a_sandboxed_frame(page: Page, tmp_path: Path, reel: Path, src: str) -> None:
    (tmp_path / "player").symlink_to(STATIC)
    (tmp_path / "reel").symlink_to(reel)
    pages = {"/": FRAME.format(src=src), "/embed.html": EMBED}
    with host(tmp_path, pages, CORS) as site:
        page.goto(site)
        frame = page.frames[1]
        element = "document.querySelector('splat-reel')"
        # All of it: what still comes when the page closes is complained about.
        frame.wait_for_function(f"{element}?.player?.canPlay && !{element}.player.busy", timeout=60_000)
        assert frame.evaluate("[self.origin, document.querySelector('splat-reel').error]") == ["null", None]


def test_a_host_that_does_not_admit_sandboxed_frames_is_explained(page: Page, tmp_path: Path) -> None:
    expect_problems(page, "CORS", "Failed to load resource")
    (tmp_path / "reel").symlink_to(GOLDEN)
    with host(STATIC, headers=CORS) as player:
        embed = EMBED.replace("player/player.js", f"{player}player.js")
        with host(tmp_path, {"/": FRAME.format(src="embed.html"), "/embed.html": embed}) as site:
            page.goto(site)
            frame = page.frames[1]
            frame.wait_for_function("document.querySelector('splat-reel')?.error")
            message = frame.evaluate("document.querySelector('splat-reel').error.message")
    assert "does not let sandboxed frames read it" in message
    assert "Access-Control-Allow-Origin" in message
