"""The player's panel for crops and marks: what it previews, prints and saves is what `splatreel edit` does."""

import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, Page

from splatreel.edit.operations import apply_operations, read_edit_list
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.server import serve
from splatreel.play.timeline import open_reel
from tests.edit.clips import edit, write_reel
from tests.player.pages import PLAYER, open_player, wait_until
from tests.player.test_transparency import SIZE, pixels

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel", 2)


@pytest.fixture
def panel(reel: Path, page: Page) -> Iterator[Locator]:
    """The open panel."""
    page.set_viewport_size({"width": 960, "height": 600})
    with serve(reel, port=0) as server:
        open_player(page, server)
        element = page.locator("splat-reel")
        element.get_by_role("button", name="Settings").click()
        element.get_by_role("button", name="Crop and clean").click()
        panel = element.get_by_role("region", name="Crop and clean")
        panel.wait_for()
        yield panel


@pytest.mark.parametrize("size", [(360, 640), (640, 360)])
def test_the_panel_leaves_most_of_a_phone_to_the_picture_and_folds(
    panel: Locator, page: Page, size: tuple[int, int]
) -> None:
    width, height = size
    page.set_viewport_size({"width": width, "height": height})
    box = panel.bounding_box()
    assert box
    assert box["width"] * box["height"] < 0.4 * width * height
    panel.get_by_role("button", name="Crop and clean").click()
    folded = panel.bounding_box()
    assert folded
    assert folded["height"] < 70
    assert panel.get_by_role("button", name="Mark floaters").is_hidden()
    panel.get_by_role("button", name="Crop and clean").click()
    assert panel.bounding_box() == box
    assert page.locator("splat-reel .start").is_hidden(), "a handle lies in the middle"


def operations(panel: Locator) -> list[str]:
    """Return the operations of the command that the panel shows."""
    words = shlex.split(panel.get_by_role("textbox", name="Command").input_value())
    assert words[:3] == ["splatreel", "edit", "REEL"]
    assert words[-2:] == ["--out", "EDITED"]
    return words[3:-2]


def wait_for_pixels(page: Page, reel: Path, met: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Return the pixels of frame 3 once they meet a condition."""
    seen = np.zeros(0)

    def is_met() -> bool:
        nonlocal seen
        seen = pixels(page, open_reel(reel), 3)
        return met(seen)

    wait_until(page, is_met)
    return seen


def composed(pixels: np.ndarray) -> np.ndarray:
    """Return colors [H, W, 3], 0..1, before black."""
    return pixels[..., :3] / 255 * pixels[..., 3:] / 255


def test_preview_is_what_the_command_makes(panel: Locator, page: Page, reel: Path, tmp_path: Path) -> None:
    panel.get_by_role("spinbutton", name="High x of the box").fill("0.4")
    panel.get_by_role("spinbutton", name="Low y of the box").fill("-0.6")
    panel.get_by_role("switch", name="Transparent").check()
    wanted = operations(panel)
    assert [text.partition("=")[0] for text in wanted] == ["crop", "background"]
    made = edit(reel, tmp_path / "made", *wanted)
    truth = made.render(made.at(3 / made.fps), made.manifest.camera.resized(*SIZE)).clip(0, 1)
    whole = wait_for_pixels(page, reel, lambda seen: -10 * np.log10(np.square(composed(seen) - truth).mean()) > 30)
    panel.get_by_role("button", name="Before").click()
    before = wait_for_pixels(page, reel, lambda seen: (seen[..., 3] == 255).all())
    assert np.abs(composed(before) - composed(whole)).mean() > 0.02


def test_a_dragged_handle_moves_a_face(panel: Locator, page: Page) -> None:
    handle = page.locator("splat-reel .edit-drawing circle[aria-label='Face of the box: low x']")
    before, place = operations(panel), handle.bounding_box()
    assert place is not None
    page.mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    page.mouse.down()
    page.mouse.move(place["x"] + place["width"] / 2 + 30, place["y"] + place["height"] / 2, steps=3)
    page.mouse.up()
    after = operations(panel)
    old, new = ([float(value) for value in text[0].removeprefix("crop=box:").split(",")] for text in (before, after))
    assert new[0] > old[0]
    assert new[1:] == old[1:]
    handle.press("ArrowLeft")
    assert float(operations(panel)[0].removeprefix("crop=box:").split(",")[0]) < new[0]


def test_marks_are_saved_in_a_list_that_the_command_reads(
    panel: Locator, page: Page, reel: Path, tmp_path: Path
) -> None:
    panel.get_by_role("switch", name="Crop to the box").uncheck()
    assert operations_are_empty(panel)
    panel.get_by_role("button", name="Mark floaters").click()
    page.mouse.move(440, 300)
    page.mouse.down()
    page.mouse.move(500, 320, steps=4)
    page.mouse.up()
    panel.get_by_role("button", name="Only now").first.click()
    with page.expect_download() as saved:
        panel.get_by_role("button", name="Save the list").click()
    file = tmp_path / "edits.json"
    saved.value.save_as(file)
    assert saved.value.suggested_filename == "edits.json"
    found = read_edit_list(file)
    assert found == operations(panel)
    assert found[0].startswith("remove=sphere:")
    assert found[0].endswith("@0:6")
    clip, whole = apply_operations(ReelClip(reel), found), ReelClip(reel)
    assert len(clip.group(0).group.dynamic) + sum(flags.sum() for flags in clip.group(0).alive.values()) < len(
        whole.group(0).group.dynamic
    ) + sum(flags.sum() for flags in whole.group(0).alive.values())


def operations_are_empty(panel: Locator) -> bool:
    """Return true if there is nothing to do."""
    return panel.get_by_role("textbox", name="Command").input_value() == ""


def test_closing_shows_everything_again(panel: Locator, page: Page, reel: Path) -> None:
    panel.get_by_role("switch", name="Transparent").check()
    page.keyboard.press("Escape")
    panel.wait_for(state="detached")
    assert page.locator("splat-reel .edit-drawing").count() == 0
    original = open_reel(reel)
    truth = original.render(original.at(0), original.manifest.camera.resized(*SIZE)).clip(0, 1)
    assert -10 * np.log10(np.square(pixels(page, original, 0)[..., :3] / 255 - truth).mean()) > 35
    assert not page.evaluate(f"{PLAYER}.transparent")
