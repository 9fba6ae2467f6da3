"""A reel that plays in a loop holds no more after many rounds than after a few."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server, serve
from tests.golden import PREDICTIVE
from tests.player.pages import open_player

pytestmark = [pytest.mark.browser, pytest.mark.slow]

COUNT = """
window.held = new Set();
const gl = WebGL2RenderingContext.prototype;
for (const kind of ["Texture", "Buffer", "Framebuffer", "VertexArray"]) {
  const [make, free] = [gl[`create${kind}`], gl[`delete${kind}`]];
  gl[`create${kind}`] = function () { const made = make.call(this); window.held.add(made); return made; };
  gl[`delete${kind}`] = function (made) { window.held.delete(made); free.call(this, made); };
}
window.rounds = 0;
window.workers = 0;
const Worker = window.Worker;
window.Worker = class extends Worker { constructor(...args) { super(...args); window.workers++; } };
"""
PLAY = """() => {
  const reel = document.querySelector("splat-reel");
  Object.assign(reel, { loop: true, muted: true, playbackRate: 4 });
  let last = 0;
  reel.addEventListener("timeupdate", () => {
    if (reel.currentTime < last) window.rounds++;
    last = reel.currentTime;
  });
  void reel.play();
}"""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serve(PREDICTIVE, port=0) as running:
        yield running


def test_rounds_leave_nothing_behind(page: Page, server: Server) -> None:
    page.add_init_script(COUNT)
    open_player(page, server)
    page.evaluate(PLAY)
    found = []
    for rounds in (6, 30):
        page.wait_for_function("least => window.rounds >= least", arg=rounds)
        script = "[held.size, workers, document.querySelector('splat-reel').player.stream.held.length]"
        found.append(page.evaluate(script))
    (objects, workers, groups), (later_objects, later_workers, later_groups) = found
    assert objects > 10
    assert later_objects <= objects + 4, "some are created when they are first needed, but none in every round"
    assert (later_workers, later_groups) == (workers, groups)
