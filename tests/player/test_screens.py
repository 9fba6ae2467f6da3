"""Every state of the controls looks like its approved picture (tests/data/screens, `make screens`)."""

import json

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser

from splatreel.play.server import Server
from tests.player.screens import SCREENS, STATES, take, text_width

pytestmark = pytest.mark.browser

CELL = 4
"""Pixels of a side of what is compared: the mean of a cell forgives how edges are smoothed."""
DIFFERENT = 0.1
PART = 0.0003
"""Of the cells may differ: less than an icon."""
PART_OF_OTHER_FONTS = 0.06


def cells(picture: np.ndarray) -> np.ndarray:
    """Return the mean colors of cells, [H / CELL, W / CELL, 3], 0..1."""
    height, width = picture.shape[0] // CELL, picture.shape[1] // CELL
    cropped = picture[: height * CELL, : width * CELL].astype(np.float32) / 255
    return cropped.reshape(height, CELL, width, CELL, 3).mean((1, 3))


def different(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of cells that differ."""
    return float((np.abs(cells(a) - cells(b)).max(-1) > DIFFERENT).mean())


def golden(name: str) -> np.ndarray:
    return np.asarray(Image.open(SCREENS / f"{name}.webp").convert("RGB"))


@pytest.fixture(scope="session")
def part(browser: Browser) -> float:
    """Return the share of cells that may differ on this machine."""
    same = json.loads((SCREENS / "font.json").read_text())["text_width"] == text_width(browser)
    return PART if same else PART_OF_OTHER_FONTS


@pytest.mark.parametrize("name", STATES)
def test_looks_as_it_did(browser: Browser, server: Server, name: str, part: float) -> None:
    now, then = take(browser, server.url, STATES[name]), golden(name)
    assert now.shape == then.shape
    found = different(now, then)
    assert found <= part, f"{found:.2%} of {name} differ; look at it, and if it is right: make screens"


def test_the_comparison_sees_an_icon() -> None:
    assert different(golden("paused"), golden("playing")) > PART
    assert different(golden("paused"), golden("paused")) == 0
