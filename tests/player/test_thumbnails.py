"""Thumbnails over the seek bar: the right one of the right sheet, loaded on demand."""

import hashlib
import io
import json

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import CDPSession, Page, Route

from splatreel.play.server import Server
from tests.golden import GOLDEN
from tests.player.pages import (
    add_file,
    let_frames_pass,
    open_body,
    open_player,
    wait_for_style,
    wait_for_transitions,
    wait_until,
)

pytestmark = pytest.mark.browser

COUNT, COLUMNS, ROWS = 6, 2, 2
SIZE = (64, 48)


def color(index: int) -> tuple[int, int, int]:
    return (40 * index, 200 - 30 * index, 90)


def sheet(number: int) -> bytes:
    """Return a sheet of plain colors, one per thumbnail. The last sheet has one row."""
    left = min(COUNT - number * COLUMNS * ROWS, COLUMNS * ROWS)
    picture = Image.new("RGB", (COLUMNS * SIZE[0], -(-left // COLUMNS) * SIZE[1]))
    for k in range(left):
        place = (k % COLUMNS * SIZE[0], k // COLUMNS * SIZE[1])
        picture.paste(Image.new("RGB", SIZE, color(number * COLUMNS * ROWS + k)), place)
    out = io.BytesIO()
    picture.save(out, "PNG")
    return out.getvalue()


def add_thumbnails(page: Page) -> list[str]:
    """Give the golden reel thumbnails, and return the requests for them."""
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    seconds = manifest["frames"] / manifest["fps"] / COUNT
    sheets = [
        {"uri": f"thumbnails/{i}.png", "bytes": len(sheet(i)), "sha256": hashlib.sha256(sheet(i)).hexdigest()}
        for i in range(2)
    ]
    manifest["thumbnails"] = {"width": SIZE[0], "height": SIZE[1], "columns": COLUMNS, "rows": ROWS, "count": COUNT}
    manifest["thumbnails"] |= {"seconds": seconds, "sheets": sheets}
    asked: list[str] = []

    def answer(route: Route) -> None:
        asked.append(route.request.url.rsplit("/", 1)[1])
        route.fulfill(content_type="image/png", body=sheet(int(asked[-1][0])))

    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.route("**/thumbnails/*", answer)
    return asked


def shown(page: Page) -> np.ndarray:
    """Return the color in the middle of the thumbnail."""
    image = page.locator("splat-reel .thumbnail img")
    image.wait_for()
    wait_until(page, lambda: image.evaluate("(image) => image.complete"))
    wait_for_transitions(page)
    picture = np.asarray(Image.open(io.BytesIO(page.locator("splat-reel .thumbnail").screenshot())).convert("RGB"))
    assert np.allclose(picture.shape[1::-1], SIZE, atol=1)  # a pixel may be cut in two
    return picture[SIZE[1] // 2, SIZE[0] // 2]


def test_the_thumbnail_of_the_time_under_the_mouse(page: Page, server: Server):
    asked = add_thumbnails(page)
    open_player(page, server)
    assert asked == []
    track = page.locator("splat-reel .seek").bounding_box()
    assert track is not None
    for index in (0, 1, 3, 5, 2):
        page.mouse.move(track["x"] + track["width"] * (index + 0.1) / COUNT, track["y"] + track["height"] / 2)
        assert np.abs(shown(page).astype(int) - color(index)).max() < 6
    hint = page.locator("splat-reel .hint").bounding_box()
    assert hint is not None
    assert hint["x"] >= 0
    assert hint["y"] + hint["height"] <= track["y"] + track["height"] / 2
    assert asked[:2] == ["0.png", "1.png"]


def test_a_finger_on_the_seek_bar_sees_it_too(phone: Page, server: Server, fingers: CDPSession):
    add_thumbnails(phone)
    open_player(phone, server)
    seek = phone.locator("splat-reel .seek").bounding_box()
    assert seek is not None
    y = seek["y"] + seek["height"] / 2
    for kind, part in (("touchStart", 0.05), ("touchMove", 0.3), ("touchMove", 0.85)):
        points = [{"x": seek["x"] + seek["width"] * part, "y": y}]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        let_frames_pass(phone, 3)
    assert np.abs(shown(phone).astype(int) - color(5)).max() < 6
    wait_for_style(phone, ".hint", "opacity", "1")
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait_for_style(phone, ".hint", "opacity", "0")


@pytest.mark.parametrize("size", [(480, 320), (300, 170)])
def test_a_title_of_a_chapter_does_not_push_the_thumbnail_out(page: Page, server: Server, size: tuple[int, int]):
    add_thumbnails(page)
    title = "The locomotive leaves the station at midnight"
    add_file(page, "chapters.vtt", f"WEBVTT\n\n00:00.000 --> 00:00.400\n{title}")
    style = f"width: {size[0]}px; height: {size[1]}px; aspect-ratio: auto"
    track = '<track kind="chapters" src="chapters.vtt">'
    open_body(page, server, f'<splat-reel src="reel/manifest.json" controls style="{style}">{track}</splat-reel>')
    page.wait_for_function("document.querySelector('splat-reel').player.tracks?.chapters.length === 1")
    # Low embeds show no bar below the big button.
    page.evaluate("document.querySelector('splat-reel').currentTime = 0.1")
    seek = page.locator("splat-reel .seek").bounding_box()
    assert seek
    for part in (0.05, 0.3, 0.31):
        page.mouse.move(seek["x"] + part * seek["width"], seek["y"] + seek["height"] / 2)
        page.locator("splat-reel .thumbnail img").wait_for()
        boxes = [page.locator(f"splat-reel {name}").bounding_box() for name in (".hint", ".thumbnail", ".chapter")]
        assert all(boxes)
        hint, image, text = (box for box in boxes if box)
        assert min(hint["x"], hint["y"]) >= 0
        assert hint["y"] + hint["height"] <= seek["y"] + seek["height"] / 2
        assert text["width"] <= max(image["width"], 96) + 1
        assert image["y"] + image["height"] <= text["y"]
