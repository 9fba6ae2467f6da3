"""`splatreel export`: formats, times and crops of exported Gaussians."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.play.timeline import open_reel
from splatreel.scene.ply import read_ply
from splatreel.scene.remarks import Remarks
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
        ("folder", ["--crop", "sphere:9,9,9,0.1"], "no Gaussian at 0.000 s is within --crop"),
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
