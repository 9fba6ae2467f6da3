"""`splatreel import`: its output, and protection of existing reels."""

import json
import os
import re
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from splatreel.base.errors import ReelError
from splatreel.base.ply_table import read_comments
from splatreel.cli.main import main
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.formats.ply import write_ply
from splatreel.importing.reel import SequenceEncoder
from tests.importing.films import BALL, WALL, cameras, frame, write_film
from tests.importing.test_viewpoints import entry


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    write_film(tmp_path / "film", [frame(number) for number in range(4)])
    return "film"


def test_reel_is_made_and_compared_with_the_files(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path("cameras.json")
    file.write_text(json.dumps([entry(camera, index) for index, camera in enumerate(cameras())]))
    assert main(["import", film, "--out", "reel", "--cameras", str(file), "--fps", "25", "--title", "A ball"]) == 0
    manifest = ReelReader("reel").manifest
    assert (manifest.fps, manifest.frames, len(manifest.cameras)) == (25, 4, 5)
    assert (manifest.layers[0].points, manifest.groups[0].points) == (WALL, BALL)
    assert (manifest.presentation.title, manifest.presentation.poster is not None) == ("A ball", True)
    assert verify_reel("reel").strangers == []
    said = capsys.readouterr().out
    size = sum(entry.bytes for entry in manifest.files)
    assert f"4 frames in {size / 1e6:.3g} MB" in said
    found = re.search(r"have ([0-9.]+) dB PSNR against those of the files \(mean of 4\)", said)
    assert found is not None
    assert float(found[1]) > 40
    assert "splatreel serve reel" in said
    assert "a ring of cameras" not in said


def test_import_without_cameras_reports_the_up_axis(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", film, "--out", "guessed"]) == 0
    assert "with -y up. If that is wrong, name the cameras" in capsys.readouterr().out
    assert main(["import", film, "--out", "told", "--up", "z"]) == 0
    assert "with z up" in capsys.readouterr().out
    assert [ReelReader(reel).manifest.up.tolist() for reel in ("guessed", "told")] == [[0, -1, 0], [0, 0, 1]]


def test_lower_rates_are_smaller_and_farther_from_the_files(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for rate in ("high", "medium", "low"):
        assert main(["import", film, "--out", rate, "--rate", rate]) == 0
        size = sum(entry.bytes for entry in ReelReader(rate).manifest.files)
        decibels = re.search(r"have ([0-9.]+) dB", capsys.readouterr().out)
        assert decibels is not None
        found.append((size, float(decibels[1])))
    assert found == sorted(found, reverse=True)
    assert ReelReader("high").manifest.presentation.title == "film"


def test_import_keeps_existing_reels_and_restarts_interrupted_ones(
    film: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut_off(self: SequenceEncoder, *_: object) -> None:
        raise ReelError("The line is cut.")

    with monkeypatch.context() as patched:
        patched.setattr(SequenceEncoder, "write", cut_off)
        assert main(["import", film, "--out", "reel"]) == 1
    assert main(["import", film, "--out", "reel"]) == 0
    before = Path("reel/manifest.json").read_bytes()
    assert main(["import", film, "--out", "reel", "--rate", "low"]) == 2
    assert "reel: holds a reel already" in capsys.readouterr().err
    assert Path("reel/manifest.json").read_bytes() == before


def test_import_that_is_complete_already_says_so(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A command may be killed just after it finished. A reel that differs only in its texts is not taken for it."""
    assert main(["import", film, "--out", "reel"]) == 0
    before = {file: file.read_bytes() for file in Path("reel").rglob("*") if file.is_file()}
    capsys.readouterr()
    assert main(["import", film, "--out", "reel"]) == 0
    text = capsys.readouterr().out
    assert "reel: was complete already, with the same content" in text
    assert "dB PSNR" in text
    assert main(["import", film, "--out", "reel", "--title", "Another"]) == 2
    assert "reel: holds a reel already" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in Path("reel").rglob("*") if file.is_file()} == before
    assert not list(Path().glob(".*"))


def test_reel_of_a_run_is_not_written_over_while_it_is_made(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", film, "--out", "run/reel"]) == 0
    Path("run/work").mkdir()
    file = Path("run/reel/manifest.json")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"live": True}))
    before = file.read_bytes()
    assert main(["import", film, "--out", "run/reel"]) == 2
    assert "run/reel: holds a reel already" in capsys.readouterr().err
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["film", "--fps", "0"], "--fps 0"),
        (["film", "--fps", "nan"], "--fps nan"),
        (["film", "--up", "w"], "--up w"),
        (["film", "--scale", "0"], "--scale 0"),
        (["film", "--min-opacity", "1.5"], "--min-opacity 1.5"),
        (["film", "--length", "0"], "--length 0"),
        (["film", "--length", "9"], "has 4 frames of its own"),
        (["film", "--crop", "1,2,3"], "write six numbers"),
        (["film", "--crop", "1,1,1,0,2,2"], "is not below its high corner"),
        (["film", "--crop", "50,50,50,51,51,51"], "no frame holds a point"),
        (["missing"], "missing: does not exist"),
        (["film", "--cameras", "missing"], "missing"),
        (["film", "--cameras", "film"], "film: holds none of these"),
    ],
)
def test_impossible_imports_are_refused_and_leave_no_files(
    film: str, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", *arguments, "--out", "reel"]) != 0
    assert said in capsys.readouterr().err
    assert not Path("reel").exists()


@pytest.mark.parametrize("empty", [True, False])
def test_only_frames_with_points_can_share_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], empty: bool
) -> None:
    """A film that begins before something appears was not trained frame by frame."""
    monkeypatch.chdir(tmp_path)
    first = frame(0)
    unrelated = replace(first, means=first.means[::-1] + 0.3, scales=first.scales * 1.7, sh=-first.sh)
    write_film(tmp_path / "film", [first[:0] if empty else unrelated, first])
    assert main(["import", "film", "--out", "reel"]) == 0
    assert ("No point could be followed" in capsys.readouterr().out) != empty


def test_any_name_of_a_folder_becomes_the_title(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    for name, title in ((os.fsdecode(b"caf\xe9"), "caf\ufffd"), ("x" * 250, "x" * 200)):
        shutil.copytree(film, name)
        assert main(["import", name, "--out", "reel"]) == 0
        assert ReelReader("reel").manifest.presentation.title == title
        shutil.rmtree("reel")
    capsys.readouterr()
    for title, said in (("x" * 201, "201 characters, at most 200"), (os.fsdecode(b"\xe9"), "is not text")):
        assert main(["import", film, "--out", "reel", "--title", title]) == 2
        assert f"--title: {said}" in capsys.readouterr().err
        assert not Path("reel").exists()


@pytest.mark.parametrize("packed", [False, True])
def test_marks_of_antialiasing_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], packed: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("film").mkdir()
    for number in range(3):
        write_ply(f"film/f{number}.ply", frame(number), antialias=number < 2)
    if packed:
        with zipfile.ZipFile("film.zip", "w") as archive:
            for number in range(3):
                archive.write(f"film/f{number}.ply")
    assert main(["import", "film.zip" if packed else "film", "--out", "reel"]) == 0
    assert ReelReader("reel").manifest.antialias
    said = capsys.readouterr().out
    assert "mark their points as trained with antialiasing. The reel draws them so" in said
    assert re.search(r"marked differently for antialiasing .*f2\.ply\)", said)
    assert main(["export", "reel", "--out", "again.ply", "--frame", "0"]) == 0
    assert "SplatRenderMode: mip" in read_comments(Path("again.ply"))


def test_memory_limit_is_an_option(film: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", film, "--out", "reel", "--max-memory", "1"]) == 0
    with zipfile.ZipFile("zeros.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("f0.ply", bytes(100_000_000))
    assert main(["import", "zeros.zip", "--out", "other"]) == 1
    said = capsys.readouterr().err
    assert "f0.ply: claims 100,000,000 unpacked bytes" in said
    most = re.search(r"--max-memory (\d+)", said)
    assert most is not None
    assert main(["import", "zeros.zip", "--out", "other", "--max-memory", most[1]]) == 1
    assert "is not a PLY file" in capsys.readouterr().err
    assert main(["import", "zeros.zip", "--out", "other", "--max-memory", "0"]) == 2
