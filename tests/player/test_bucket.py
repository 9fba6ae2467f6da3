"""A browser plays a reel from a bucket set up as docs/publishing.md describes, while the reel is made and published."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.codec.publish import Publication
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.play.server import Server
from splatreel.storage.address import Address
from tests.codec.reels import add_chapter_group, new_group, new_writer, points
from tests.player.pages import PLAYER, expect_problems, wait_for_picture

pytestmark = pytest.mark.browser


def write_group(writer: ReelWriter, index: int) -> None:
    if index == 0:
        writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(index, 15, 20))


def test_a_reel_in_a_bucket_plays_while_it_grows(page: Page, server: Server, bucket, tmp_path: Path):
    bucket.open_to_pages()
    asked: list[tuple[str, int]] = []
    page.on("response", lambda answer: asked.append((answer.url.removeprefix(bucket.web("")), answer.status)))
    writer = new_writer(tmp_path / "reel", config=EncodeConfig())
    publication = Publication(tmp_path / "reel", Address(bucket.url("show")))
    write_group(writer, 0)
    publication.update()
    page.goto(f"{server.url}?src={bucket.web('show/manifest.json')}")
    wait_for_picture(page)
    assert page.evaluate(f"[{PLAYER}.live, {PLAYER}.duration]") == [True, 0.3]
    write_group(writer, 1)
    publication.update()
    page.wait_for_function(f"{PLAYER}.duration > 0.4")
    write_group(writer, 2)
    writer.finish()
    publication.update()
    page.wait_for_function(f"!{PLAYER}.live && {PLAYER}.duration > 0.6")
    page.evaluate("document.querySelector('splat-reel').currentTime = 0.55")
    page.wait_for_function(f"!{PLAYER}.seeking && !{PLAYER}.waiting && {PLAYER}.stream.held.includes(2)")
    files = [(name, status) for name, status in asked if name.startswith("show/groups/")]
    assert {status for _, status in files} <= {200, 206}
    assert len({name for name, _ in files}) == 3


def test_a_long_show_in_a_bucket_is_followed_while_its_beginning_is_dropped_and_deleted(
    page: Page, server: Server, bucket, tmp_path: Path
):
    """Page names contain their hash too, and a viewer at the live edge never requests a deleted file."""
    bucket.open_to_pages()
    missing: list[str] = []
    page.on("response", lambda answer: missing.append(answer.url) if answer.status >= 400 else None)
    folder, clock = Address(bucket.url("show")), iter(range(1000))
    writer = new_writer(tmp_path / "reel", config=EncodeConfig(), page=2)
    publication = Publication(tmp_path / "reel", folder, keep=3, clock=lambda: next(clock))
    for index in range(6):
        add_chapter_group(writer, index, 4)
        publication.update()
    page.goto(f"{server.url}?src={bucket.web('show/manifest.json')}")
    wait_for_picture(page)
    for index in (6, 7):
        add_chapter_group(writer, index, 4)
        writer.drop_before(index - 3)
        publication.update()
        page.wait_for_function(f"{PLAYER}.duration >= {0.2 * (index + 1)}")
    for _ in range(4):
        publication.update()
    assert not [name for name in folder.sizes() if name.startswith("groups/0001")]
    page.evaluate("document.querySelector('splat-reel').currentTime = 1.5")
    page.wait_for_function(f"{PLAYER}.canPlay && {PLAYER}.currentTime >= 1.5")
    assert missing == []


def test_a_bucket_that_lets_no_page_read_it_is_explained(page: Page, server: Server, bucket, tmp_path: Path):
    expect_problems(page, "CORS", "403", "Failed to load resource")
    bucket.open_to_pages()
    bucket.client.delete_bucket_cors(Bucket=bucket.name)
    writer = new_writer(tmp_path / "reel", config=EncodeConfig())
    write_group(writer, 0)
    writer.finish()
    Publication(tmp_path / "reel", Address(bucket.url("show"))).update()
    page.goto(f"{server.url}?src={bucket.web('show/manifest.json')}")
    alert = page.locator("splat-reel").get_by_role("alert")
    alert.wait_for()
    assert "Access-Control-Allow-Origin" in str(alert.text_content())
