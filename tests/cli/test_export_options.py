"""`splatreel export`: formats, times and crops of exported Gaussians."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.frame_formats import FRAME_FORMATS
from splatreel.scene.ply import read_ply
from splatreel.scene.remarks import Remarks
from splatreel.scene.volumes import Sphere
from splatreel.sequence.splat_file import read_splats
from tests.golden import GOLDEN


def export(out: Path, *options: str) -> int:
    return main(["export", str(GOLDEN), "--out", str(out), "--up", "capture", *options])


def test_every_nth_frame_is_numbered_without_gaps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(tmp_path / "few", "--frames", "1:8", "--every", "3", "--format", "sog") == 0
    assert sorted(path.name for path in (tmp_path / "few").iterdir()) == ["000000.sog", "000001.sog", "000002.sog"]
    assert "3 SOG files, frames 1 to 7, every 3" in capsys.readouterr().out
    found = read_splats(tmp_path / "few" / "000001.sog", None, Remarks())
    assert len(found) == len(open_reel(GOLDEN).at(4 / 30))


def test_time_between_two_frames(tmp_path: Path) -> None:
    assert export(tmp_path / "f.ply", "--at", "0.05") == 0
    np.testing.assert_allclose(read_ply(tmp_path / "f.ply").means, open_reel(GOLDEN).at(0.05).means, atol=1e-6)


def test_crop(tmp_path: Path) -> None:
    points = open_reel(GOLDEN).at(0)
    low, high = np.quantile(points.means, [0.25, 0.75], axis=0)
    box = ",".join(f"{value:.6f}" for value in (*low, *high))
    assert export(tmp_path / "f.splat", "--frame", "0", "--crop", f"box:{box}") == 0
    found = read_splats(tmp_path / "f.splat", None, Remarks())
    assert 0 < len(found) < len(points)
    assert (found.means >= low - 1e-4).all()
    assert (found.means <= high + 1e-4).all()


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("f.ply", [], "A file of one frame takes --frame N or --at SECONDS"),
        ("f.ply", ["--frame", "1", "--every", "2"], "neither --frames nor --every"),
        ("f.ply", ["--frame", "1", "--at", "0"], "Leave out one of them"),
        ("f.ply", ["--at", "99"], "lasts from 0 to"),
        ("f.ply", ["--frame", "1", "--format", "sog"], "has another suffix"),
        ("f.usdz", ["--frame", "1"], "--frame and --at are for a file of one frame"),
        ("folder", ["--every", "0"], "--every 0"),
        ("folder", ["--crop", "sphere:9,9,9,0.1"], "no Gaussian from 0.000 to 0.433 s is within --crop"),
        ("f.ply", ["--at", "0.1", "--crop", "sphere:9,9,9,0.1"], "no Gaussian at 0.100 s is within --crop"),
        ("folder", ["--crop", "1,2"], "--crop=1,2: Give box:x,y,z"),
        ("f.mp4", ["--every", "2"], "Leave them out for a film"),
    ],
)
def test_impossible_exports_are_refused(
    tmp_path: Path, name: str, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(tmp_path / name, *options) != 0
    assert said in capsys.readouterr().err
    assert not (tmp_path / name).is_file()


@pytest.mark.parametrize("name", ["f.ply", "f.usdz", "f.4dgs", "folder"])
def test_empty_reel_is_refused_without_blaming_an_option(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Timeline.at
    monkeypatch.setattr(Timeline, "at", lambda reel, seconds: shown(reel, seconds)[:0])
    when = ["--frame", "2"] if name == "f.ply" else []
    for crop in ([], ["--crop", "sphere:0,0,0,9"]):
        assert export(tmp_path / name, *when, *crop) != 0
        said = capsys.readouterr().err
        assert "shows no Gaussian " in said
        assert "--crop" not in said
        assert not (tmp_path / name).is_file()


@pytest.mark.parametrize("kind", ["ply", "compressed-ply", "splat", "sog", "spz", "spz2", "spz4"])
def test_frames_before_something_appears_are_empty_files(tmp_path: Path, kind: str) -> None:
    """The golden reel's moving points leave this box during the film."""
    source = open_reel(GOLDEN)
    film = GaussianExport(source, [frame / source.fps for frame in range(source.frames)], None)
    points, later = film.at(0), film.at(film.seconds[-1])
    gone = next(place for place in points.means if np.abs(later.means - place).max(1).min() > 1e-3)
    film = replace(film, crop=Sphere(gone, 1e-4))
    film.check_content()
    suffix = FRAME_FORMATS[kind].suffix
    counts = [film.write_file(tmp_path / f"{frame}{suffix}", kind, film.seconds[frame]) for frame in (0, -1)]
    assert counts == [1, 0]
    assert len(read_splats(tmp_path / f"-1{suffix}", None, Remarks())) == 0
