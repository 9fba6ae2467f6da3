"""The web player as files for a site."""

import base64
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.manifest import edit_reel, parse_manifest
from splatreel.play import player_page
from splatreel.play.player_page import STATIC, copy_player, write_standalone
from tests.golden import GOLDEN, PREDICTIVE, write_golden


def test_the_player_is_copied_over_an_older_one(tmp_path: Path) -> None:
    folder = tmp_path / "site" / "player"
    copy_player(folder)
    (folder / "player.js").write_text("old", encoding="utf-8")
    copy_player(str(folder))
    assert {path.name for path in folder.iterdir()} == {path.name for path in STATIC.iterdir()}
    assert (folder / "player.js").read_bytes() == (STATIC / "player.js").read_bytes()


HOSTILE = "</title></script><script>alert(1)</script><!--"


class Scripts(HTMLParser):
    """Every script of a page: attributes and text."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.found: list[tuple[dict[str, str | None], str]] = []
        self._open = False
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open = tag == "script"
        if self._open:
            self.found.append((dict(attrs), ""))

    def handle_data(self, data: str) -> None:
        if self._open:
            attributes, text = self.found[-1]
            self.found[-1] = attributes, text + data

    def handle_endtag(self, tag: str) -> None:
        self._open = False

    def of(self, attribute: str) -> dict[str | None, str]:
        """Text by an attribute's value, of those that have it."""
        return {found[attribute]: text for found, text in self.found if attribute in found}


@pytest.fixture
def reel(tmp_path: Path) -> Path:
    return shutil.copytree(PREDICTIVE, tmp_path / "reel")


def test_standalone_page_contains_reel_and_player(reel: Path, tmp_path: Path) -> None:
    edit_reel(reel, {"title": HOSTILE, "description": HOSTILE})
    size = write_standalone(tmp_path / "made" / "reel.html", reel)
    page = tmp_path / "made" / "reel.html"
    scripts = Scripts(page)
    assert size == page.stat().st_size
    manifest = parse_manifest(scripts.of("id")["splatreel-manifest"].encode(), "page")
    assert manifest.presentation.title == HOSTILE
    files = {uri: base64.b64decode(text) for uri, text in scripts.of("data-reel-file").items()}
    assert files == {file.uri: (reel / file.uri).read_bytes() for file in manifest.files}
    player = set(scripts.of("data-player-file"))
    assert player >= {"decode-worker.js", "share.js", "sort-worker.js"}
    assert not any(name.startswith(player_page.EXCLUDED) for name in player)
    kinds = [attributes.get("type") for attributes, _ in scripts.found]
    assert kinds == ["application/json", *["text/plain"] * (len(files) + len(player)), "module"]
    text = page.read_text(encoding="utf-8")
    assert "<!--" not in text
    assert 'data-src="embedded:"' in text
    assert "data-early" not in text


def test_standalone_page_takes_one_rendition_and_ends_live_reel(tmp_path: Path) -> None:
    write_golden(tmp_path / "reel", "predictive", ("high", "low"))
    file = tmp_path / "reel" / "manifest.json"
    file.write_text(file.read_text().replace('"live": false', '"live": true'))
    for rendition, name in ((None, "0000.safetensors"), ("low", "0000.low.safetensors")):
        write_standalone(tmp_path / "page.html", tmp_path / "reel", rendition)
        scripts = Scripts(tmp_path / "page.html")
        manifest = json.loads(scripts.of("id")["splatreel-manifest"])
        assert manifest["groups"][0]["uri"] == f"groups/{name}"
        assert f"groups/{name}" in scripts.of("data-reel-file")
        assert len(scripts.of("data-reel-file")) == len(manifest["groups"]) + len(manifest["layers"])
        assert manifest["live"] is False
        assert "renditions" not in manifest


def test_standalone_page_refuses_unsupported_reels(reel: Path, tmp_path: Path) -> None:
    with pytest.raises(ReelError, match=r"uses the paper's codec.*splatreel encode"):
        write_standalone(tmp_path / "page.html", GOLDEN)
    file = reel / "groups" / "0000.safetensors"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ReelError, match="the manifest says"):
        write_standalone(tmp_path / "page.html", reel)
    assert not (tmp_path / "page.html").exists()


def test_standalone_page_escapes_script_ends(reel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    static = shutil.copytree(player_page.STATIC, tmp_path / "static")
    (static / "player.js").write_text('const t="</Script><!--",r=/<\\/script>/')
    monkeypatch.setattr(player_page, "STATIC", static)
    write_standalone(tmp_path / "page.html", reel)
    assert Scripts(tmp_path / "page.html").of("type")["module"] == 'const t="<\\/Script>\\x3c!--",r=/<\\/script>/'
    (static / "index.html").write_text("<main></main>")
    with pytest.raises(ReelError, match="Build the player again"):
        write_standalone(tmp_path / "page.html", reel)
