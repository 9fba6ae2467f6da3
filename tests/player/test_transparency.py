"""Transparent reels show the page behind the points; joined reels do not cross-fade."""

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import serve
from splatreel.play.timeline import Timeline, open_reel
from tests.edit.clips import edit, write_reel
from tests.player.pages import PLAYER, open_player
from tests.player.test_browser import RENDER

pytestmark = pytest.mark.browser
SIZE = 160, 120


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel", 2)


def pixels(page: Page, reel: Timeline, frame: int) -> np.ndarray:
    """Return the player's RGBA bytes of a frame, [H, W, 4]."""
    camera = reel.manifest.camera.resized(*SIZE)
    pose = {"K": camera.K.ravel().tolist(), "viewmat": camera.viewmat.ravel().tolist()}
    data = base64.b64decode(page.evaluate(RENDER, [frame / reel.fps, pose, *SIZE]))
    return np.frombuffer(data, np.uint8).reshape(SIZE[1], SIZE[0], 4)


def test_empty_pixels_of_a_transparent_reel_have_no_alpha(reel: Path, page: Page, tmp_path: Path) -> None:
    clear = edit(reel, tmp_path / "clear", "crop=sphere:0,0,0,0.8", "background=transparent")
    with serve(tmp_path / "clear", port=0) as server:
        open_player(page, server)
        found = pixels(page, clear, 0)
        assert page.evaluate("document.querySelector('splat-reel').matches(':state(clear)')")
        assert (
            page.evaluate("getComputedStyle(document.querySelector('splat-reel')).backgroundColor")
            == "rgba(0, 0, 0, 0)"
        )
    camera = clear.manifest.camera.resized(*SIZE)
    black, white = (Timeline.render(_on(clear, color), clear.at(0), camera) for color in ((0, 0, 0), (1, 1, 1)))
    alpha = 1 - (white - black).mean(-1)
    assert (found[alpha < 1e-3, 3] == 0).all()
    assert (alpha < 1e-3).sum() > 1000
    assert np.abs(found[..., 3] / 255 - alpha).mean() < 0.02
    whole = found[..., :3] / 255 * found[..., 3:] / 255
    assert np.abs(whole - black.clip(0, 1)).mean() < 0.02


def _on(reel: Timeline, color: tuple[float, float, float]) -> Timeline:
    """Return the reel before a background color."""
    other = open_reel(Path(reel.reel.name).parent)
    other.reel.manifest = replace(other.reel.manifest, background=color)
    return other


def test_the_attribute_makes_any_reel_transparent(reel: Path, page: Page) -> None:
    original = open_reel(reel)
    with serve(reel, port=0) as server:
        open_player(page, server)
        assert (pixels(page, original, 0)[..., 3] == 255).all()
        page.evaluate("document.querySelector('splat-reel').setAttribute('transparent', '')")
        assert pixels(page, original, 7)[0, 0, 3] == 0
        page.evaluate("document.querySelector('splat-reel').removeAttribute('transparent')")
        assert (pixels(page, original, 7)[..., 3] == 255).all()
        assert not page.evaluate(f"{PLAYER}.transparent")


def test_joined_reels_have_a_hard_cut_in_the_player(reel: Path, page: Page, tmp_path: Path) -> None:
    joined = edit(reel, tmp_path / "joined", f"join={write_reel(tmp_path / 'other', 2, seed=9)}")
    with serve(tmp_path / "joined", port=0) as server:
        open_player(page, server)
        for frame in (11, 12, 13, 19):
            truth = joined.render(joined.at(frame / joined.fps), joined.manifest.camera.resized(*SIZE)).clip(0, 1)
            error = np.square(pixels(page, joined, frame)[..., :3] / 255 - truth).mean()
            assert -10 * np.log10(error) > 35, frame
