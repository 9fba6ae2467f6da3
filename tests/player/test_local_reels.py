"""Local reels: a dropped zip, a chosen folder or zip, and other files."""

import json
import shutil
from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.golden import GOLDEN, PREDICTIVE
from tests.player.pages import PLAYER, expect_problems, open_player, wait_for_picture

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"

DROP = """async ([address, name]) => {
    const bytes = await (await fetch(address)).arrayBuffer(), data = new DataTransfer();
    data.items.add(new File([bytes], name));
    const host = document.querySelector("splat-reel"), options = { dataTransfer: data, bubbles: true, cancelable: true };
    const shown = !host.dispatchEvent(new DragEvent("dragover", options));
    host.dispatchEvent(new DragEvent("drop", options));
    return shown;
}"""


def serve_file(page: Page, path: Path) -> None:
    page.route(f"**/{path.name}", lambda route: route.fulfill(body=path.read_bytes()))


def zipped(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.make_archive(str(tmp_path / "reel"), "zip", folder.parent, folder.name))


def test_a_zip_that_is_dropped_plays_instead_of_what_played(page: Page, server: Server, tmp_path: Path):
    open_player(page, server)
    serve_file(page, zipped(PREDICTIVE, tmp_path))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    assert page.evaluate(DROP, ["/reel.zip", "reel.zip"])
    page.wait_for_function(f"{REEL}.srcObject !== null && {PLAYER}.canPlay")
    assert page.evaluate(f"{PLAYER}.manifest.url") == "file:///reel.zip/manifest.json"
    assert page.evaluate(f"{REEL}.currentSrc") == ""
    page.evaluate(f"{PLAYER}.currentTime = 0.4")
    page.wait_for_function(f"!{PLAYER}.seeking")
    assert [url for url in asked if "groups" in url or "layers" in url] == []


def test_what_is_no_reel_says_what_it_is_and_the_reel_plays_on(page: Page, server: Server, tmp_path: Path):
    open_player(page, server)
    cut = tmp_path / "cut.zip"
    cut.write_bytes(zipped(GOLDEN, tmp_path).read_bytes()[:-30])
    (tmp_path / "scene.ply").write_bytes(b"ply")
    sheet = page.locator("splat-reel .drop")
    for name, message in [
        ("cut.zip", "it was cut off"),
        ("scene.ply", "That is not a reel: scene.ply is a single static scene"),
    ]:
        serve_file(page, tmp_path / name)
        page.evaluate(DROP, [f"/{name}", name])
        sheet.get_by_text(message).wait_for()
        sheet.click(position={"x": 4, "y": 4})
        sheet.wait_for(state="hidden")
    assert page.evaluate(f"[{PLAYER}.canPlay, {REEL}.srcObject]") == [True, None]


def test_a_damaged_file_of_a_reel_on_this_machine_is_an_error_at_once(page: Page, server: Server, tmp_path: Path):
    expect_problems(page, "checksum")
    folder = shutil.copytree(GOLDEN, tmp_path / "golden")
    file = folder / json.loads((folder / "manifest.json").read_text())["groups"][0]["uri"]
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    open_player(page, server)
    page.locator("splat-reel input.folder").set_input_files(folder)
    page.wait_for_function(f"{PLAYER}.error !== null")
    assert "its checksum differs from the manifest" in page.evaluate(f"{PLAYER}.error.message")


def test_the_page_asks_for_a_reel_where_it_has_none_and_plays_the_folder_that_is_chosen(page: Page, server: Server):
    expect_problems(page, "404")
    page.route("**/reel/manifest.json", lambda route: route.fulfill(status=404))
    page.goto(server.url + "?autoplay=0")
    sheet = page.locator("splat-reel .drop")
    sheet.get_by_role("button", name="Open a zip").wait_for()
    assert page.locator("splat-reel .panel").is_hidden()
    sheet.locator("input.folder").set_input_files(GOLDEN)
    wait_for_picture(page)
    assert sheet.is_hidden()
    assert page.evaluate(f"{PLAYER}.manifest.files.name") == GOLDEN.name


def test_a_link_to_a_reel_that_is_missing_asks_for_none(page: Page, server: Server):
    expect_problems(page, "404")
    page.goto(server.url + "?src=none/manifest.json")
    page.locator("splat-reel .panel").wait_for()
    assert page.locator("splat-reel .drop").is_hidden()
