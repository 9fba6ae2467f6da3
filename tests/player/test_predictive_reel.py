"""A reel of the predictive codec looks the same in a real Chromium as in Python, and loads no other decoder."""

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason="the browser tests need the playwright package")
from playwright.sync_api import Page, Route

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


SPY = """
const {compile, Instance} = WebAssembly;
WebAssembly.compile = (bytes) => ALLOWED ? compile(bytes) : Promise.reject(new Error("not by this page's policy"));
WebAssembly.Instance = function (...parts) {
  const instance = new Instance(...parts);
  console.log(Object.keys(instance.exports).includes("lod") ? "kernels started" : "something else started");
  return instance;
};
"""


@pytest.mark.parametrize("allowed", [True, False])
def test_decodes_by_webassembly_where_it_may(page: Page, server: Server, allowed: bool) -> None:
    def spied(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, body=SPY.replace("ALLOWED", str(allowed).lower()) + answer.text())

    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.route("**/decode-worker.js", spied)
    open_player(page, server)
    assert ("kernels started" in said) is allowed


def test_pictures_match_the_python_render(page: Page, server: Server) -> None:
    fetched: list[str] = []
    page.on("request", lambda request: fetched.append(request.url))
    reel = open_reel(PREDICTIVE)
    open_player(page, server)
    for seconds in (0.05, 0.225, 0.31):
        camera = reel.manifest.camera
        want = np.clip(reel.render(reel.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(picture(page, seconds, camera), want) >= 45
    assert not [url for url in fetched if "draco" in url or "hevc" in url]
