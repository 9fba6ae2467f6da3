"""Reels of imported films look the same in a real Chromium as in Python: no fades, points appear and disappear."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason="the browser tests need the playwright package")
from playwright.sync_api import Page

from splatreel.base.progress import Silent
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.importing.frames import open_frames
from splatreel.importing.reel import header_of, write_reel
from splatreel.play.server import serve
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import WALL, cameras, frame, write_film
from tests.player.pages import open_player
from tests.player.test_browser import picture, psnr

pytestmark = pytest.mark.browser

FPS = 10


def exchanged(number: int) -> Gaussians:
    """Return the film's frame with its rows shuffled, and with other points in place of those that move."""
    points, rng = frame(number), np.random.default_rng(number)
    scales, sh, moving = points.scales.copy(), points.sh.copy(), np.s_[WALL:]
    scales[moving] *= rng.uniform(0.5, 1, scales[moving].shape)
    sh[moving, 0] += rng.uniform(-0.7, 0.7, sh[moving, 0].shape)
    return replace(points, scales=scales, sh=sh)[rng.permutation(len(points))[number:]]


def test_pictures_match_the_python_render(page: Page, tmp_path: Path) -> None:
    film = open_frames(write_film(tmp_path / "film", [*map(frame, range(4)), *map(exchanged, range(4, 9))]))
    header, limits = header_of(film.read(0), cameras(), None, FPS)
    writer = ReelWriter(tmp_path / "reel", header, config=EncodeConfig(coarseness=0.3))
    write_reel(film, writer, Silent(), limits)
    reel = open_reel(tmp_path / "reel")
    groups = reel.manifest.groups
    assert reel.manifest.overlap == 0
    assert len(groups) >= 2
    assert any(group.points > len(film.read(8)) - WALL for group in groups), "some have points that come and go"
    camera = reel.manifest.camera
    with serve(tmp_path / "reel", port=0) as server:
        open_player(page, server, "?autoplay=0&loop=0")
        for seconds in (0, 0.15, *((group.first_frame + 0.5) / FPS for group in groups), 0.8):
            want = np.clip(reel.render(reel.at(seconds), camera), 0, 1)
            assert want.std() > 0.05
            assert psnr(picture(page, seconds, camera), want) >= 45, seconds
