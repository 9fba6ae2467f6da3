"""The player shows a reel of the predictive codec, in a real Chromium, as Python does; no other decoder is fetched for it."""

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason="the browser tests need the playwright package")
from playwright.sync_api import Page

from splatreel.kernels.image import render_image
from splatreel.play.server import Server, serve
from splatreel.play.timeline import open_reel
from tests.golden import PREDICTIVE
from tests.player.pages import open_player
from tests.player.test_browser import picture, psnr

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serve(PREDICTIVE, port=0) as running:
        yield running


def test_pictures_match_the_python_render(page: Page, server: Server) -> None:
    fetched: list[str] = []
    page.on("request", lambda request: fetched.append(request.url))
    reel = open_reel(PREDICTIVE)
    open_player(page, server)
    for seconds in (0.05, 0.225, 0.31):
        camera = reel.manifest.camera
        want = np.clip(render_image(reel.at(seconds), camera, antialias=True), 0, 1)
        assert want.std() > 0.05
        assert psnr(picture(page, seconds, camera), want) >= 45
    assert not [url for url in fetched if "draco" in url or "hevc" in url]
