"""`splatreel export`: formats, times and crops of exported Gaussians."""

import gzip
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.formats.ply import read_columns, read_ply
from splatreel.formats.programs import PROGRAMS, FrameKind, ProgramName
from splatreel.formats.registry import FRAME_FORMATS, is_antialiased, read_splats
from splatreel.formats.splat_columns import Remarks
from splatreel.play.gaussian_export import GaussianExport
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.volumes import Sphere
from tests.golden import GOLDEN
from tests.importing.films import frame, write_film


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
    counts = []
    for place in (0, -1):
        points = film.at(film.seconds[place])
        film.write(tmp_path / f"{place}{suffix}", kind, points)
        counts.append(len(points))
    assert counts == [1, 0]
    assert len(read_splats(tmp_path / f"-1{suffix}", None, Remarks())) == 0


@pytest.fixture(scope="module")
def far_reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a reel of SH degree 1, whose origin is far from 0, 0, 0."""
    folder = tmp_path_factory.mktemp("far")
    points = frame(0)
    film = write_film(folder / "film", [replace(points, means=points.means + np.array([4e5, 0, 0], np.float32))])
    assert main(["import", str(film), "--out", str(folder / "reel")]) == 0
    assert open_reel(folder / "reel").manifest.origin.any()
    return folder / "reel"


def test_names_of_programs_are_those_of_the_table() -> None:
    assert set(get_args(ProgramName)) == set(PROGRAMS)
    assert set(get_args(FrameKind)) == set(FRAME_FORMATS)
    assert {kind for program in PROGRAMS.values() for kind in program.formats} <= set(FRAME_FORMATS)


@pytest.mark.parametrize("program", ["unity", "blender"])
def test_ply_for_a_program_has_floats_and_degree_3(
    far_reel: Path, tmp_path: Path, program: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "f.ply"
    assert main(["export", str(far_reel), "--out", str(out), "--frame", "0", "--for", program]) == 0
    columns = read_columns(out)
    assert columns["x"].dtype == np.float32
    assert sum(name.startswith("f_rest_") for name in columns) == 45
    assert "Positions are relative to" in capsys.readouterr().out
    assert main(["export", str(far_reel), "--out", str(out), "--frame", "0"]) == 0
    assert read_columns(out)["x"].dtype == np.float64


def test_spz_for_unity_is_version_2_of_degree_3(tmp_path: Path) -> None:
    assert export(tmp_path / "f.spz", "--frame", "0", "--for", "unity") == 0
    head = gzip.decompress((tmp_path / "f.spz").read_bytes())[:16]
    assert (head[4], head[12]) == (2, 3)


def test_folder_for_a_program_has_its_best_format(tmp_path: Path) -> None:
    for program in PROGRAMS:
        assert export(tmp_path / program, "--frames", "0:1", "--for", program) == 0
        file = next((tmp_path / program).iterdir())
        assert file.name == f"000000{FRAME_FORMATS[PROGRAMS[program].formats[0]].suffix}"


@pytest.mark.parametrize("options", [["--equal-counts"], ["--for", "unreal"], ["--for", "unity", "--format", "spz2"]])
def test_all_files_of_a_folder_have_equal_counts(
    tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(tmp_path / "film", *options) == 0
    counts = [len(read_splats(file, None, Remarks())) for file in sorted((tmp_path / "film").iterdir())]
    plain = [len(moment) for moment in open_reel(GOLDEN)]
    assert len(counts) == len(plain)
    assert set(counts) == {max(plain)}, "the overlap of two groups needs the most"
    assert len(set(plain)) > 1
    assert f"{max(plain):,} Gaussians in each" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["f.ply", "f.4dgs", "f.html", "f.mp4"])
def test_equal_counts_are_for_sequences(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    when = ["--frame", "0"] if name == "f.ply" else []
    assert export(tmp_path / name, "--equal-counts", *when) == 2
    assert "--equal-counts" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("f.sog", ["--frame", "0", "--for", "unity"], "UnityGaussianSplatting reads .ply, .spz"),
        ("f.usdz", ["--for", "blender"], "reads .ply"),
        ("f.html", ["--for", "blender"], "reads .ply"),
        (
            "folder",
            ["--for", "unity", "--format", "spz"],
            "UnityGaussianSplatting reads ply, spz2. Leave out --format spz",
        ),
    ],
)
def test_formats_that_a_program_cannot_read_are_refused(
    tmp_path: Path, name: str, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(tmp_path / name, *options) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("name", "remedy"), [("f.usdc", "a .4dgs file"), ("folder", "--format spz")])
def test_size_of_a_large_export_is_said_before_it_is_written(
    tmp_path: Path, name: str, remedy: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if name.endswith("usdc"):
        pytest.importorskip("pxr")
    assert export(tmp_path / name, "--frames", "0:4") == 0
    assert "writing about" not in capsys.readouterr().out
    monkeypatch.setattr("splatreel.cli.export.LARGE", 10_000)
    assert export(tmp_path / name, "--frames", "0:4") == 0
    said = capsys.readouterr().out
    assert 0 <= said.index("writing about") < said.index("frames 0 to 3")
    assert "--every 2" in said
    assert remedy in said


@pytest.mark.parametrize(("name", "marked"), [("f.ply", True), ("f.sog", True), ("f.spz", True), ("f.splat", False)])
def test_antialiasing_is_marked_or_reported(
    tmp_path: Path, name: str, marked: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = open_reel(GOLDEN)
    antialiased = replace(real.manifest, antialias=True)
    monkeypatch.setattr(Timeline, "manifest", property(lambda reel: antialiased))
    assert export(tmp_path / name, "--frame", "0") == 0
    assert is_antialiased(tmp_path / name, Remarks()) == marked
    assert ("cannot mark" in capsys.readouterr().out) != marked
