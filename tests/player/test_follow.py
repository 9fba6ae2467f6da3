"""A browser plays a capture while it is filmed, reconstructed and served, for half a minute."""

import itertools
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.base.progress import Silent
from splatreel.capture.follower import Follower, open_growing
from splatreel.capture.growth import Growth
from splatreel.codec.reader import ReelReader
from splatreel.play.server import serve
from splatreel.run.live.following import Live, reconstruct_following
from tests.capture.recorder import Recorder
from tests.method.captures import WallCapture
from tests.method.small import small

PLAYER = "document.querySelector('splat-reel')?.player"
"""The page makes its element when it has seen what there is to play."""
FPS, GROUP, SECONDS = 5, 15, 30
POLL = 3.0
"""Seconds between two looks of the player at the manifest."""
WALL = WallCapture(20, speed=0.05)


def film(recorder: Recorder) -> None:
    """Film in real time."""
    begun = time.monotonic()
    for number in range(FPS * SECONDS):
        time.sleep(max(begun + number / FPS - time.monotonic(), 0))
        recorder.write(1)
    recorder.end()


def follow(folder: Path, out: Path) -> None:
    config = small({"group.length": GROUP, "group.overlap": 2, "group.iterations_per_frame": 1, "group.tracks": False})
    growth = Growth(folder, 60)
    with (
        closing(open_growing(folder, growth, lambda _: None, held_out=[])) as capture,
        Follower(capture, growth, lambda _: None) as follower,
    ):
        reconstruct_following(follower, out, config, Live("draft", keep=20), progress=Silent())


@pytest.mark.slow
@pytest.mark.browser
def test_a_live_reel_is_followed_while_it_is_filmed_and_stands_still_no_longer_than_a_group(
    page: Page, tmp_path: Path
) -> None:
    def picture(camera: int, frame: int) -> np.ndarray:
        there, back = divmod(frame, 20)
        return WALL.read(19 - back if there % 2 else back, 1, [WALL.cameras[camera].name])[0, 0]

    recorder = Recorder(tmp_path / "show", "ts", picture, cameras=WALL.cameras, fps=FPS)
    reel = tmp_path / "out" / "reel"
    threads = [
        threading.Thread(target=film, args=(recorder,)),
        threading.Thread(target=follow, args=(recorder.folder, tmp_path / "out")),
    ]
    threads[0].start()
    while not recorder.written[0]:
        time.sleep(0.05)
    threads[1].start()
    while not (reel / "manifest.json").exists():
        assert threads[1].is_alive()
        time.sleep(0.1)
    looks: list[tuple[float, float, float]] = []  # when, what is shown, what there is to show; seconds
    with serve(reel, port=0) as server:
        page.goto(f"{server.url}?loop=0&muted=1")
        ended = False
        while not ended:
            state = page.evaluate(f"(p => p?.canPlay ? [p.currentTime, p.ended] : null)({PLAYER})")
            manifest = ReelReader(reel).manifest
            if state is not None:
                looks.append((time.monotonic(), state[0], manifest.frames / FPS))
                ended = state[1]
            time.sleep(0.1)
    for thread in threads:
        thread.join()
    assert looks[-1][1] == looks[-1][2] == SECONDS
    assert looks[0][1] < SECONDS / 2, "it was watched while it was filmed"
    # How fast groups are made depends on the machine; what there is must be shown. It is known to the player a look later.
    length, waiting = GROUP / FPS, 0.0
    for (before, shown, there), (now, next_shown, _) in itertools.pairwise(looks):
        waiting = waiting + now - before if next_shown == shown < there else 0.0
        assert waiting < length + POLL
