"""The player in a frame with `sandbox="allow-scripts"`, which has no origin of its own."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.player_page import STATIC
from tests.golden import GOLDEN, PREDICTIVE
from tests.player.hosts import host

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
