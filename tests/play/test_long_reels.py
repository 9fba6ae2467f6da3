"""Long reels: retired layers fade out, pages are followed, and a reel may begin at a later frame."""

import json
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.codec.manifest import parse_manifest
from splatreel.codec.reader import ReelReader
from splatreel.formats.ply import read_ply
from splatreel.play.player_page import write_standalone
from splatreel.play.presentation_writer import PresentationWriter
from splatreel.play.served_files import ServedFiles
from splatreel.play.timeline import open_reel
from splatreel.play.viewer import Clock
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import QUICK, add_chapter_group, new_writer
from tests.golden_long import CHAPTER, LONG, WINDOW
from tests.play.test_player_page import Scripts

FPS = 10


def shown_alone(reader: ReelReader, group: int, frame: float) -> Gaussians:
    found = reader.group(group)
    return Gaussians.concatenate([reader.static(group)[0][found.alive], found.at(frame - found.first_frame)])


def sorted_means(points: Gaussians) -> np.ndarray:
    return points.means[np.lexsort(points.means.T)]


@pytest.mark.parametrize(("old", "retired"), [(4, True), (3, False)])
def test_retired_layers_fade_out_and_shared_layers_stay(old, retired):
    """Group 5 is a chapter's first: of the one before it shares six static points with it, of a chapter all twelve."""
    reader, frame = ReelReader(LONG), 2 * old + 2.5
    moment = open_reel(LONG).at(frame / FPS)
    assert moment.fade is not None
    before, after, weight = moment.fade
    assert weight == pytest.approx(0.5)
    for found, group in ((before, old), (after, old + 1)):
        np.testing.assert_array_equal(sorted_means(found), sorted_means(shown_alone(reader, group, frame)))
    alive = [dict(enumerate(reader.group(g).alive)) for g in (old, old + 1)]
    shared = range(6 if retired else 12)
    both = sum(alive[0][i] and alive[1][i] for i in shared)
    count = sum(len(shown_alone(reader, g, frame)) for g in (old, old + 1))
    assert len(moment) == count - both
    assert len(reader.static(old)[0]) == 12
    assert len(reader.static(old + 1)[0]) == (10 if retired else 12)


def test_paged_reel_shows_group_of_each_time():
    timeline, reader = open_reel(LONG), ReelReader(LONG)
    for group, after in pairwise(timeline.manifest.groups):
        frame = after.first_frame - 0.75  # past the cross-fade, which takes a frame
        expected = shown_alone(reader, group.group, frame)
        np.testing.assert_array_equal(sorted_means(timeline.at(frame / FPS)), sorted_means(expected))


def test_trimmed_reel_shows_first_frame_before_its_start(tmp_path: Path):
    writer = new_writer(tmp_path, config=QUICK, page=2)
    for index in range(10):
        add_chapter_group(writer, index, CHAPTER)
    times = (1.0, 1.05, 2.0)
    whole = [open_reel(tmp_path).at(seconds).means for seconds in times]
    writer.drop_before(5)
    timeline = open_reel(tmp_path)
    assert (timeline.manifest.first_frame, timeline.frames, timeline.duration) == (8, 21, 2.1)
    for seconds in (-1.0, 0.0, 0.8):
        np.testing.assert_array_equal(timeline.at(seconds).means, timeline.at(0.8).means)
        assert timeline.at(seconds).fade is None  # the group it would fade from is gone
    for seconds, means in zip(times, whole, strict=True):
        np.testing.assert_array_equal(timeline.at(seconds).means, means)


def test_clock_of_trimmed_reel_stays_within_reel():
    clock = Clock(2.1, start=0.8)
    assert clock.time == 0.8
    clock.advance(1.0)
    assert clock.time == pytest.approx(1.8)
    clock.advance(0.5)
    assert clock.time == pytest.approx(1.0)
    clock.seek(0.1)
    assert clock.time == 0.8
    clock.loop = False
    clock.advance(9.0)
    clock.toggle()
    assert (clock.time, clock.playing) == (0.8, True)


@pytest.mark.parametrize("path", [LONG, WINDOW], ids=["long", "window"])
def test_standalone_page_contains_all_groups_of_paged_reel(path: Path, tmp_path: Path) -> None:
    write_standalone(tmp_path / "page.html", path)
    scripts = Scripts(tmp_path / "page.html")
    manifest, before = (
        parse_manifest(scripts.of("id")["splatreel-manifest"].encode(), "page"),
        ReelReader(path).manifest,
    )
    assert (manifest.layers, manifest.first_group, manifest.pages) == (before.layers, before.first_group, ())
    assert [group.uri for group in manifest.groups] == [group.uri for group in before.groups]
    assert set(scripts.of("data-reel-file")) == manifest.uris


def test_served_files_of_live_reel_follow_its_window(tmp_path: Path) -> None:
    writer = new_writer(tmp_path, config=QUICK, page=2)
    files, named = ServedFiles(tmp_path), []
    for index in range(11):
        add_chapter_group(writer, index, CHAPTER)
        writer.drop_before(index - 5)
        named += sorted(writer.manifest.uris)
        for uri in (*writer.manifest.uris, "manifest.json"):
            assert files.find(uri) == (tmp_path / uri).resolve()
    assert all((files.find(uri) is None) == (uri not in writer.manifest.uris) for uri in named)
    assert len(writer.manifest.pages) == len(files._pages) > 0  # of pages that are gone none is kept
    (tmp_path / "pages" / "000099.json").write_text("{}")
    assert files.find("pages/000099.json") is None


def test_exports_of_trimmed_reel_use_its_own_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(WINDOW), "--out", str(tmp_path / "film.mp4"), "--width", "32"]) == 0
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 13
    assert main(["export", str(WINDOW), "--out", str(tmp_path / "f.ply"), "--frame", "8"]) == 0
    np.testing.assert_allclose(read_ply(tmp_path / "f.ply").means, open_reel(WINDOW).at(0.8).means, atol=1e-6)
    for arguments in (["--out", str(tmp_path / "g.ply"), "--frame", "7"], ["--out", str(tmp_path), "--frames", "7:9"]):
        assert main(["export", str(WINDOW), *arguments]) == 2
        assert "there is no frame 7; choose 8 to 20" in capsys.readouterr().err


def test_info_counts_paged_groups(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(WINDOW)]) == 0
    text = capsys.readouterr().out
    assert "13 frames at 10 a second, 1.30 s" in text
    assert text.count("dynamic points") == 6
    assert "group 4: frames 8 to 10, 3 dynamic points (2,317 bytes), no new static points" in text
    assert main(["info", str(LONG), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (len(found["manifest"]["groups"]), len(found["group_bytes"])) == (10, 10)
    reel = ReelReader(LONG, "high").manifest
    pages = sum(path.stat().st_size for path in (LONG / "pages").iterdir())
    own = (LONG / "manifest.json").stat().st_size
    assert found["bytes"] == sum(file.bytes for file in (*reel.layers, *reel.groups)) + own + pages
    first = [reel.groups[0], *(layer for layer in reel.layers if layer.group == 0)]
    assert found["first_view_bytes"] == own + ReelReader(LONG).manifest.pages[0].bytes + sum(x.bytes for x in first)


def test_info_counts_both_layers_of_group(capsys: pytest.CaptureFixture[str]) -> None:
    layers = [layer for layer in ReelReader(LONG).manifest.layers if layer.group == 0]
    assert main(["info", str(LONG)]) == 0
    assert f"10 new static points ({sum(layer.bytes for layer in layers):,} bytes)" in capsys.readouterr().out


def test_trimmed_reel_gets_poster_and_thumbnails(tmp_path: Path) -> None:
    writer = new_writer(tmp_path, config=QUICK, page=2)
    for index in range(10):
        add_chapter_group(writer, index, CHAPTER)
    writer.drop_before(8)
    PresentationWriter()(writer, None)
    writer.finish()
    presentation = ReelReader(tmp_path).manifest.presentation
    assert presentation.poster is not None
    assert presentation.thumbnails is not None
    assert presentation.thumbnails.count == 7  # one in three frames
