"""`splatreel encode` writes another reel of a run, and never overwrites an existing one."""

import json
import os
import shutil
from pathlib import Path

import pytest

from splatreel.cli.main import main
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.run.pipeline import reconstruct
from splatreel.run.run_folder import lock_reel
from tests.method.captures import WallCapture
from tests.method.small import small


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "run"
    reconstruct(WallCapture(1), out, small({"keyframe.first_iterations": 4}))
    return out


@pytest.fixture
def run(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(made, tmp_path / "run")


def test_other_settings_make_another_reel(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", "run", "--out", "paper", "--codec", "h265"]) == 0
    assert main(["encode", "run", "--out", "small", "--scale-bits", "6", "--sh-entries", "0"]) == 0
    assert verify_reel("small").points == verify_reel(run / "reel").points
    assert verify_reel("small").bytes < verify_reel("paper").bytes
    assert "static points" in capsys.readouterr().out
    assert main(["encode", "run", "--out", "original", "--source", "ori"]) == 0
    assert verify_reel("original").points == verify_reel(run / "reel").points


def test_texts_of_the_run_are_kept_and_images_are_new(run: Path) -> None:
    assert main(["edit", "run", "--title", "A wall", "--licence", "CC0-1.0"]) == 0
    assert main(["encode", "run", "--out", "low", "--rate", "low"]) == 0
    old, new = (ReelReader(reel).manifest.presentation for reel in ("run/reel", "low"))
    assert (new.title, new.licence) == ("A wall", "CC0-1.0")
    assert new.limits == old.limits is not None
    assert new.poster is not None
    assert new.thumbnails is not None
    assert verify_reel("low").strangers == []


def points_of(reel: str) -> int:
    """Bytes of the points of a reel."""
    return sum(entry.bytes for entry in ReelReader(reel).manifest.files)


def test_rates(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sizes = []
    for rate in ("low", "medium", "high"):
        assert main(["encode", "run", "--out", rate, "--rate", rate]) == 0
        sizes.append(points_of(rate))
    assert sizes == sorted(sizes)
    manifest = json.loads(Path("medium/manifest.json").read_text())
    wanted = 8e-6 * (sizes[1] + sizes[2]) / 2 * manifest["fps"] / manifest["frames"]
    assert main(["encode", "run", "--out", "met", "--target-mbps", f"{wanted:.6f}"]) == 0
    assert points_of("met") == pytest.approx((sizes[1] + sizes[2]) / 2, rel=0.05)


def test_renditions(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", "run", "--out", "reel", "--renditions", "low,high"]) == 0
    assert "groups in renditions: high " in capsys.readouterr().out
    sizes = ReelReader("reel").manifest.rendition_bytes()
    assert list(sizes) == ["high", "low"]
    assert sizes["high"] >= sizes["low"]
    assert main(["info", "reel", "--rendition", "low", "--json"]) == 0
    assert sum(json.loads(capsys.readouterr().out)["group_bytes"]) == sizes["low"]
    assert main(["export", "reel", "--rendition", "low", "--frame", "0", "--out", "low.ply"]) == 0
    assert main(["export", "reel", "--rendition", "best", "--frame", "0", "--out", "x.ply"]) == 1


@pytest.mark.parametrize(
    "options",
    [
        ["--codec", "h265", "--rate", "low"],
        ["--codec", "predictive", "--crf", "20"],
        ["--codec", "predictive", "--source", "ori"],
        ["--target-mbps", "0"],
        ["--target-mbps", "1", "--rate", "low"],
        ["--renditions", "high,best"],
        ["--renditions", "high"],
        ["--renditions", "high,low", "--rate", "low"],
        ["--renditions", "high,low", "--target-mbps", "1"],
        ["--renditions", "high,low", "--codec", "h265"],
    ],
)
def test_options_of_another_codec(run: Path, options: list[str]) -> None:
    assert main(["encode", "run", "--out", "x", *options]) == 2
    assert main(["encode", "run", "--out", "x", "--rate", "low", "--set", "encode.coarseness=1"]) == 2
    assert not Path("x").exists()


def test_interrupted_encode_starts_over(run: Path) -> None:
    assert main(["encode", "run", "--out", "other"]) == 0
    manifest = Path("other/manifest.json")
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"live": True}))
    assert main(["encode", "run", "--out", "other"]) == 0
    assert json.loads(manifest.read_text())["live"] is False


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ("run", "is the folder that this command reads. Choose another place"),
        ("run/reel", "is the folder that this command reads. Choose another place"),
        ("run/work", "is the folder that this command reads. Choose another place"),
        ("run/reel/new", "lies in run/reel, which this command reads. Choose a place outside of it"),
        ("second/reel", "holds a reel already. Choose another folder, or delete that reel"),
    ],
)
def test_existing_reels_are_not_overwritten(
    run: Path, out: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(run, "second")
    manifest = Path("second/reel/manifest.json")
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"live": True}))  # as while it is reconstructed
    before = manifest.read_bytes()
    assert main(["encode", "run", "--out", out]) == 2
    assert capsys.readouterr().err == f"Error: --out {out}: {reason}.\n"
    assert manifest.read_bytes() == before
    assert verify_reel("run/reel").groups == 1


@pytest.mark.parametrize("options", [[], ["--codec", "h265"], ["--target-mbps", "2"]])
def test_encode_that_is_complete_already_says_so(
    run: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A command may be killed just after it finished."""
    assert main(["encode", "run", "--out", "other", *options]) == 0
    before = {file: file.read_bytes() for file in Path("other").rglob("*") if file.is_file()}
    capsys.readouterr()
    assert main(["encode", "run", "--out", "other", *options]) == 0
    assert "other: was complete already, with the same content" in capsys.readouterr().out
    assert main(["encode", "run", "--out", "other", "--rate", "low"]) == 2
    assert "other: holds a reel already" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in Path("other").rglob("*") if file.is_file()} == before


@pytest.mark.parametrize(
    ("options", "range"),
    [
        (["--crf", "52"], "0 to 51"),
        (["--position-bits", "3"], "4 to 21"),
        (["--scale-bits", "17"], "1 to 16"),
        (["--sh-entries=-1"], "0 to 65536"),
    ],
)
def test_values_out_of_range(run: Path, options: list[str], range: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", "run", "--out", "x", *options]) == 2
    assert capsys.readouterr().err.endswith(f"is out of range. Choose {range}.\n")
    assert not Path("x").exists()


def test_folder_without_a_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", "run/reel", "--out", "x"]) == 1
    assert capsys.readouterr().err == (
        "Error: run/reel/work: contains no finished group. Run splatreel reconstruct first.\n"
    )


@pytest.mark.skipif(os.name != "posix", reason="locks of folders")
def test_second_encode_at_the_same_time_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with lock_reel(Path("other")):
        assert main(["encode", "run", "--out", "other"]) == 1
        assert (
            "other: another process is writing this reel. Wait for it or choose another --out"
            in capsys.readouterr().err
        )
        assert list(Path("other").iterdir()) == []
    left = Path("other") / "groups" / f".0000.safetensors.{'0' * 16}.tmp"
    left.parent.mkdir()
    left.write_bytes(b"half")
    assert main(["encode", "run", "--out", "other"]) == 0
    assert verify_reel("other").strangers == []


def test_settings_of_a_codec(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A setting of the paper's codec selects that codec, like its options."""
    assert (
        main(["encode", "run", "--out", "six", "--set", "encode.h265.scale_bits=6", "--set", "encode.sh_entries=0"])
        == 0
    )
    assert main(["encode", "run", "--out", "same", "--scale-bits", "6", "--sh-entries", "0"]) == 0
    assert points_of("six") == points_of("same")
    capsys.readouterr()
    refused = {
        "group.length=3": "--set group.length: takes effect in training only. Give a setting of encode.",
        "encode.h265.crf=52": "--set encode.h265.crf 52 is out of range. Choose 0 to 51.",
        "encode.sh_entries=64": "--set encode.sh_entries has no effect with encode.codec=predictive. It needs encode.codec=h265. "
        "Change the other setting too, or leave this one out.",
    }
    for text, message in refused.items():
        assert main(["encode", "run", "--out", "x", "--set", text]) == 2
        assert capsys.readouterr().err == f"Error: {message}\n"
    assert main(["encode", "run", "--out", "x", "--rate", "low", "--set", "encode.h265.crf=30"]) == 2
    assert not Path("x").exists()
