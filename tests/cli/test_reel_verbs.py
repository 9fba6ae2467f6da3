"""The verbs that read a reel, on the golden one."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from splatreel.cli.main import main
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import turn_upright, turned
from tests.formats.test_glb import read_glb
from tests.golden import PREDICTIVE

GOLDEN = Path(__file__).parent.parent / "data" / "golden"


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(GOLDEN)]) == 0
    text = capsys.readouterr().out
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    assert f"{manifest['frames']} frames at {manifest['fps']:g} a second" in text
    assert text.count("dynamic points") == len(manifest["groups"])
    layers, groups = (sum(file["bytes"] for file in manifest[kind]) for kind in ("layers", "groups"))
    assert f"layers {layers:,} (" in text
    assert f"groups {groups:,} (" in text


def test_info_draws_the_rate_over_time(capsys: pytest.CaptureFixture[str]) -> None:
    """Six frames at 30 a second play from the first group, eight from the second."""
    assert main(["info", str(GOLDEN)]) == 0
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    bars = [line for line in capsys.readouterr().out.splitlines() if " s  " in line]
    rates = [
        8e-6 * (manifest["groups"][i]["bytes"] + manifest["layers"][i]["bytes"]) * 30 / n for i, n in ((0, 6), (1, 8))
    ]
    assert [float(bar.split()[0]) for bar in bars] == [0, 0.2]
    assert [float(bar.split()[2]) for bar in bars] == pytest.approx(rates, abs=0.006)
    lengths = [bar.count("█") + bar.count("░") for bar in bars]
    assert lengths[1] / lengths[0] == pytest.approx(rates[1] / rates[0], abs=0.05)


def test_info_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(GOLDEN), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    assert values["manifest"]["groups"] == manifest["groups"]
    files = [GOLDEN / "manifest.json", *(GOLDEN / f["uri"] for f in manifest["layers"] + manifest["groups"])]
    assert values["bytes"] == sum(f.stat().st_size for f in files)


def test_info_describes_sound(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(GOLDEN.parent / "golden-sound")]) == 0
    text = capsys.readouterr().out
    assert "sound: 4.00 s, 1 channel, 51 kbit/s, heard from 1, 0, 0" in text
    size = sum(path.stat().st_size for path in (GOLDEN.parent / "golden-sound").rglob("*") if path.is_file())
    assert f"{size:,} bytes to watch once, {size / 4:,.0f} for each second of video" in text
    assert "images and sound" in text
    assert main(["info", str(GOLDEN)]) == 0
    assert "sound" not in capsys.readouterr().out


def test_verify_finds_a_flipped_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(GOLDEN)]) == 0
    assert "complete and undamaged" in capsys.readouterr().out
    shutil.copytree(GOLDEN, tmp_path / "reel")
    (tmp_path / "reel" / "groups" / "more.bin").write_bytes(b"x")
    assert main(["verify", str(tmp_path)]) == 0
    ignored = "that the manifest does not name, which players never read: expected.json, expected.npz, groups/more.bin"
    assert ignored in capsys.readouterr().out
    (tmp_path / "reel" / "groups" / "more.bin").unlink()
    file = next((tmp_path / "reel" / "groups").iterdir())
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert main(["verify", str(tmp_path)]) == 1  # the folder that holds the reel will do
    assert file.name in capsys.readouterr().err


def test_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("splatreel.formats.ply")
    target = tmp_path / "made" / "frame.ply"
    assert main(["export", str(GOLDEN), "--frame", "3", "--out", str(target)]) == 0
    assert target.read_bytes().startswith(b"ply\n")
    assert "Gaussians of frame 3" in capsys.readouterr().out
    assert main(["export", str(GOLDEN), "--frame", "999", "--out", str(target)]) == 2
    frames = json.loads((GOLDEN / "manifest.json").read_text())["frames"]
    assert capsys.readouterr().err == f"Error: {GOLDEN}: there is no frame 999; choose 0 to {frames - 1}.\n"


def test_export_to_a_format_that_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--frame", "3"], []):
        assert main(["export", str(GOLDEN), *option, "--out", str(tmp_path / "x.obj")]) == 2
        error = capsys.readouterr().err
        assert "x.obj: .obj is not an export format. Name a .ply" in error
        assert "--frame" not in error


def test_export_to_other_formats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(GOLDEN), "--frame", "3", "--out", str(tmp_path / "f.spz")]) == 0
    assert (tmp_path / "f.spz").read_bytes()[:2] == b"\x1f\x8b"
    assert main(["export", str(GOLDEN), "--frames", "0:2", "--format", "glb", "--out", str(tmp_path / "many")]) == 0
    assert "2 GLB files" in capsys.readouterr().out
    files = sorted((tmp_path / "many").iterdir())
    assert [p.read_bytes()[:4] for p in files] == [b"glTF"] * 2
    reel, (document, arrays) = open_reel(GOLDEN), read_glb(files[0])
    assert document["nodes"] == [{"mesh": 0}]
    upright = turned(reel.at(0), turn_upright(reel.manifest.up, np.array([0.0, 1, 0])))
    np.testing.assert_allclose(arrays["POSITION"], upright.means, atol=1e-5, err_msg="the reel's up is glTF's, y")


def test_export_of_many_frames_and_of_a_film(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(GOLDEN), "--frames", "2:4", "--out", str(tmp_path / "frames")]) == 0
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == ["000002.ply", "000003.ply"]
    film = tmp_path / "film.mp4"
    assert main(["export", str(GOLDEN), "--frames", "0:2", "--width", "64", "--out", str(film)]) == 0
    assert film.stat().st_size > 1000
    capsys.readouterr()
    assert main(["export", str(GOLDEN), "--frames", "0:999", "--out", str(film)]) == 2
    assert "there is no frame 998" in capsys.readouterr().err


def test_export_of_a_film_along_a_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    viewmat = open_reel(GOLDEN).manifest.camera.viewmat.ravel().tolist()
    keyframes = [{"at": 0.2 * i, "time": 0.1 * i, "viewmat": viewmat} for i in range(2)]
    path = tmp_path / "path.json"
    path.write_text(json.dumps({"format": "splatreel-path", "version": 1, "loop": False, "keyframes": keyframes}))
    export = ["export", str(GOLDEN), "--width", "32", "--path", str(path), "--out"]
    assert main([*export, str(tmp_path / "film.mp4")]) == 0
    assert "7 frames" in capsys.readouterr().out
    assert main([*export, str(tmp_path / "film.mp4"), "--frames", "0:2"]) == 2
    assert main([*export, str(tmp_path / "files")]) == 2
    path.write_text(path.read_text().replace('"at": 0.2', '"at": -1'))
    assert main([*export, str(tmp_path / "film.mp4")]) == 2
    assert "path.json is not a camera path: at of keyframe 1 is -1. Give" in capsys.readouterr().err
    assert main(["export", str(GOLDEN), "--out", str(tmp_path / "one.ply")]) == 2
    assert "--frame N" in capsys.readouterr().err


def test_export_of_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "made" / "reel.html"
    assert main(["export", str(PREDICTIVE), "--out", str(page)]) == 0
    assert f"{page}: player and reel, 0." in capsys.readouterr().out
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert main(["export", str(PREDICTIVE), "--out", str(page), "--frames", "0:2"]) == 2
    assert "holds the whole reel" in capsys.readouterr().err


def test_edit_changes_the_texts_of_a_reel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reel = tmp_path / "run" / "reel"
    shutil.copytree(GOLDEN, reel)
    assert main(["edit", str(tmp_path / "run"), "--title", " Balls ", "--author", "Ä. Nobody", "--licence", "CC0"]) == 0
    assert f"{reel}: title Balls" in capsys.readouterr().out
    assert main(["edit", str(reel), "--description", "Two balls </title>", "--author", ""]) == 0
    found = open_reel(reel).manifest
    said = found.presentation
    assert (said.title, said.author, said.licence) == ("Balls", "", "CC0")
    assert said.description == "Two balls </title>"
    assert found.groups == open_reel(GOLDEN).manifest.groups
    assert main(["verify", str(reel)]) == 0
    capsys.readouterr()
    assert main(["info", str(reel)]) == 0
    assert "  title: Balls\n" in capsys.readouterr().out


def test_edit_refuses_impossible_texts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(GOLDEN, tmp_path / "reel")
    before = (tmp_path / "reel" / "manifest.json").read_bytes()
    assert main(["edit", str(tmp_path / "reel")]) == 2
    assert main(["edit", str(tmp_path / "reel"), "--title", "x" * 201]) == 2
    assert "--title: 201 characters, at most 200" in capsys.readouterr().err
    assert (tmp_path / "reel" / "manifest.json").read_bytes() == before
    assert main(["edit", str(tmp_path / "none"), "--title", "x"]) == 1
    (tmp_path / "reel" / "manifest.json").write_bytes(before.replace(b'"live": false', b'"live": true'))
    assert main(["edit", str(tmp_path / "reel"), "--title", "x"]) == 1
    assert "is still being written" in capsys.readouterr().err


@pytest.fixture
def forged(tmp_path: Path) -> Path:
    """A reel whose texts contain terminal control sequences."""
    reel = shutil.copytree(GOLDEN, tmp_path / "reel")
    change(reel, generator="\x1b]0;owned\x07\x1b[2J", title="caf\u00e9 \u202egnp.exe", author="\u9b5a")
    return reel


def change(reel: Path, **fields: object) -> None:
    manifest = json.loads((reel / "manifest.json").read_text())
    (reel / "manifest.json").write_text(json.dumps(manifest | fields))


def test_texts_of_a_reel_do_not_reach_the_terminal_as_commands(
    forged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(forged)]) == 0
    text = capsys.readouterr().out
    assert r"made by \x1b]0;owned\x07\x1b[2J" in text
    assert r"title: caf\u00e9 \u202egnp.exe".replace(r"\u00e9", "\u00e9") in text
    (forged / "\x1b[31mred").write_text("")
    assert main(["verify", str(forged)]) == 0
    assert r"\x1b[31mred" in capsys.readouterr().out
    assert main(["verify", f"{forged}\x1b[2J"]) == 1
    assert "\x1b" not in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_info_in_an_ascii_terminal(forged: Path, encoding: str) -> None:
    command = [sys.executable, "-m", "splatreel", "info", str(forged)]
    found = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding}, check=True)
    text = found.stdout.decode(encoding)
    assert r"author: \u9b5a" in text
    assert "####" in text


def test_unpaired_surrogate_is_refused(forged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(forged, title="\ud800")
    assert main(["info", str(forged)]) == 1
    assert r"manifest.json: holds half a character (\ud800)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"frames": 1 << 40}, "says it has 1099511627776 frames, its groups hold"),
        ({"camera": {"name": "", "width": 8, "height": 8, "K": [0] * 9, "viewmat": [0] * 16}}, "focal lengths 0 and 0"),
    ],
)
def test_manifest_that_cannot_be_exported(
    forged: Path, tmp_path: Path, fields: dict, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    change(forged, **fields)
    assert main(["export", str(forged), "--out", str(tmp_path / "frames")]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("width", ["0", "-3", "15", "1000000"])
def test_film_of_no_possible_size(width: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(GOLDEN), "--out", str(tmp_path / "film.mp4"), f"--width={width}"]) == 2
    assert f"--width {width}: films are 16 to 8192 pixels wide and high" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["film.mp4", "frames", "one.ply"])
def test_where_nothing_can_be_written(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / "file" / name
    assert main(["export", str(GOLDEN), "--out", str(out), *(["--frame", "0"] if name == "one.ply" else [])]) == 1
    assert str(tmp_path / "file") in capsys.readouterr().err
