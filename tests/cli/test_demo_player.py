"""The demo's page: the sample plays from the first second, the user's own reel from its first keyframe."""

import io
import json
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from splatreel.base.display import Lines
from splatreel.base.errors import UsageError
from splatreel.cli import demo_player
from splatreel.cli.demo_player import DemoPlayer
from splatreel.codec.preview import write_preview
from splatreel.play import demo_page
from tests.codec.reels import new_header, points, write_reel
from tests.golden import PREDICTIVE


@pytest.fixture
def sample(monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(demo_page, "SAMPLE", PREDICTIVE)
    return PREDICTIVE


@pytest.fixture
def lines() -> Iterator[Lines]:
    made = Lines(io.StringIO())
    yield made
    made.close()


def said(lines: Lines) -> str:
    assert isinstance(lines._stream, io.StringIO)
    return lines._stream.getvalue()


def get(url: str) -> str:
    with urllib.request.urlopen(url, timeout=60) as answer:
        return answer.read().decode()


def test_page_plays_the_sample_and_links_to_the_own_reel_once_it_can_be_watched(
    sample: Path, lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with demo_player.demo_player(lines, tmp_path, serve=True) as player:
        assert player is not None
        url = player.server.url
        assert f"A finished reel of this scene plays at {player.page}" in capsys.readouterr().out
        player.stage("training the first keyframe", 4)
        page = get(player.page)
        assert 'src="./?src=sample/manifest.json&amp;muted=1"' in page
        assert 'href="./"' not in page
        assert "training the first keyframe" in page
        assert json.loads(get(f"{url}sample/manifest.json")) == json.loads((sample / "manifest.json").read_text())
        with pytest.raises(urllib.error.HTTPError):
            get(f"{url}reel/manifest.json")
        write_preview(tmp_path, new_header(), None, points(20))
        player.update(1)
        player.update(2)
        assert said(lines).count(f"Watch your own reel, first its keyframe, later moving: {url}") == 1
        page = get(player.page)
        assert '<a href="./" target="player">' in page
        assert "training the first keyframe: 50 %" in page
        assert json.loads(get(f"{url}reel/manifest.json"))["live"] is True
        write_reel(tmp_path / "reel")
        assert len(json.loads(get(f"{url}reel/manifest.json"))["groups"]) == 2
        player.finish()
        assert "(finished)" in get(player.page)
    with pytest.raises(OSError):
        get(player.page)


def test_a_package_without_the_sample_shows_the_own_reel_only(
    lines: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo_page, "SAMPLE", tmp_path / "none")
    with demo_player.demo_player(lines, tmp_path, serve=True) as player:
        assert player is not None
        assert "finished reel" not in capsys.readouterr().out
        assert "sample" not in get(player.page)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_browser_opens_at_a_terminal_only(
    sample: Path, lines: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setattr(demo_player, "open_browser", opened.append)
    with demo_player.demo_player(lines, tmp_path, serve=True) as player:
        assert player is not None
    assert opened == ([player.page] if terminal else [])


def test_the_demo_goes_on_where_no_server_can_listen(
    sample: Path, lines: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise UsageError("Cannot listen on 127.0.0.1:0.")

    monkeypatch.setattr("splatreel.play.server._listen", refuse)
    with demo_player.demo_player(lines, tmp_path, serve=True) as player:
        assert player is None
    assert "without a player. Cannot listen" in said(lines)
    with demo_player.demo_player(lines, tmp_path, serve=False) as player:
        assert player is None


def test_a_reel_that_was_finished_before_is_not_announced(sample: Path, lines: Lines, tmp_path: Path) -> None:
    write_reel(tmp_path / "reel")
    player = DemoPlayer(lines, tmp_path)
    with player.server:
        player.stage("comparing", 1)
        player.update(1)
    assert "Watch your own" not in said(lines)
