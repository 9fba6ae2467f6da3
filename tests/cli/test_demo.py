"""The main job, whole, on a capture so small that it is quick: film, reconstruct, encode, evaluate, continue."""

from __future__ import annotations

import dataclasses
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
from splatreel.cli import demo
from splatreel.cli.demo import DemoPlayer
from splatreel.cli.main import main
from splatreel.cli.options import with_set
from splatreel.codec.preview import write_preview
from splatreel.config import preset
from splatreel.play import demo_page
from splatreel.run import groups
from tests.codec.reels import new_header, points, write_reel
from tests.golden import PREDICTIVE
from tests.method.small import small


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"keyframe.first_iterations": 150, "keyframe.refine_iterations": 20, "keyframe.max_points": 3000}
    config = small({**few, "keyframe.sh_degree": 3, "group.length": 4, "group.iterations_per_frame": 5})
    monkeypatch.setattr(demo, "configure", lambda *_: config)


def test_demo_makes_no_trial_of_novel_views_by_default() -> None:
    config = demo.demo_config("standard", 3)
    assert (config.seed, config.check_coverage) == (3, False)
    assert dataclasses.replace(config, check_coverage=True) == dataclasses.replace(preset("standard"), seed=3)
    assert with_set(config, ("check_coverage=true",)).check_coverage


@pytest.mark.slow
@pytest.mark.smoke
def test_demo_makes_a_reel_and_a_report_and_is_continued(
    tiny: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(groups, "FIRST_AFTER", 0.0)
    arguments = ["demo", "--out", str(tmp_path / "demo"), "--width", "64", "--frames", "8"]
    assert main(arguments) == 0
    said = capsys.readouterr()
    report = json.loads((tmp_path / "demo" / "report.json").read_text())
    manifest = json.loads((tmp_path / "demo" / "reel" / "manifest.json").read_text())
    assert (report["frames"], report["width"], report["height"]) == (8, 64, 48)
    assert report["psnr"] > 18  # about 21.7; the mean color alone has 13.7
    assert report["psnr"] == pytest.approx(report["psnr_undecoded"], abs=0.5)
    assert report["peak_memory_bytes"] > 0
    assert {"capture", "keyframe", "group", "encode", "evaluate"} <= set(report["seconds"])
    assert [c["name"] for c in report["cameras"]] == ["cam00", "cam07"]
    assert len(manifest["groups"]) == 2
    assert manifest["live"] is False
    assert manifest["title"] == "A toy room"
    assert {"poster", "thumbnails", "sound", "limits"} <= set(manifest)
    assert "Sound: camera cam" in said.err
    assert "splatreel serve" in said.out  # no terminal here: it ends by itself
    named = [
        line.split(": ")[1] for line in said.out.splitlines() if line.startswith(("Report: ", "Images ", "Reel: "))
    ]
    assert len(named) == 3
    assert all(Path(path).exists() for path in named)
    assert "Your own reel is being made now" in said.out
    assert "Watch your own reel, first its keyframe, later moving: http://127.0.0.1:" in said.err
    assert said.err.count("training the first keyframe: ") == 1, "one line per stage"
    assert not (tmp_path / "demo" / "work" / "preview").exists()

    assert main(["edit", str(tmp_path / "demo"), "--title", "My room"]) == 0
    assert main(arguments) == 0
    assert json.loads((tmp_path / "demo" / "reel" / "manifest.json").read_text())["title"] == "My room"
    again = json.loads((tmp_path / "demo" / "report.json").read_text())
    assert again["psnr"] == report["psnr"]
    assert "keyframe:" not in capsys.readouterr().err
    assert main(["verify", str(tmp_path / "demo")]) == 0


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
    with demo.demo_player(lines, tmp_path, serve=True) as player:
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
    with demo.demo_player(lines, tmp_path, serve=True) as player:
        assert player is not None
        assert "finished reel" not in capsys.readouterr().out
        assert "sample" not in get(player.page)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_browser_opens_at_a_terminal_only(
    sample: Path, lines: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setattr(demo, "open_browser", opened.append)
    with demo.demo_player(lines, tmp_path, serve=True) as player:
        assert player is not None
    assert opened == ([player.page] if terminal else [])


def test_the_demo_goes_on_where_no_server_can_listen(
    sample: Path, lines: Lines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise UsageError("Cannot listen on 127.0.0.1:0.")

    monkeypatch.setattr("splatreel.play.server._listen", refuse)
    with demo.demo_player(lines, tmp_path, serve=True) as player:
        assert player is None
    assert "without a player. Cannot listen" in said(lines)
    with demo.demo_player(lines, tmp_path, serve=False) as player:
        assert player is None


def test_a_reel_that_was_finished_before_is_not_announced(sample: Path, lines: Lines, tmp_path: Path) -> None:
    write_reel(tmp_path / "reel")
    player = DemoPlayer(lines, tmp_path)
    with player.server:
        player.stage("comparing", 1)
        player.update(1)
    assert "Watch your own" not in said(lines)
