"""Damaged or hostile files given to commands: an error that names the file, at once and without a traceback."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import ReelError, UsageError
from splatreel.cli.main import main
from splatreel.codec.document import parse_object
from splatreel.formats.ply import write_ply
from splatreel.play.film import CameraPath, Keyframe, film_along_path
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import cameras, frame, write_film

GOLDEN = Path(__file__).parent.parent / "data" / "golden"
posix = pytest.mark.skipif(os.name != "posix", reason="pipes and devices")


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) != 0
    error = capsys.readouterr().err
    assert "Error: " in error
    assert "Traceback" not in error
    return error


def params(path: Path, **changes: np.ndarray) -> None:
    arrays = {
        "means3D": np.zeros((2, 5, 3), np.float32),
        "rgb_colors": np.zeros((2, 5, 3), np.float32),
        "unnorm_rotations": np.ones((2, 5, 4), np.float32),
        "logit_opacities": np.zeros((5, 1), np.float32),
        "log_scales": np.zeros((5, 3), np.float32),
    }
    np.savez(path, **(arrays | changes))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "changes",
    [
        {"means3D": np.zeros((2, 5, 3), complex)},
        {"log_scales": np.zeros((5, 3), "datetime64[s]")},
        {"logit_opacities": np.zeros((5, 1), bool)},
        {"rgb_colors": np.full((2, 5, 3), "0.5")},
    ],
    ids=["complex", "dates", "bool", "strings"],
)
def test_arrays_of_odd_types(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, np.ndarray]
) -> None:
    params(tmp_path / "params.npz", **changes)
    said = refused(capsys, "import", str(tmp_path), "--out", str(tmp_path / "reel"))
    assert f"{tmp_path / 'params.npz'}: {next(iter(changes))} is of" in said


def test_encrypted_archive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params(tmp_path / "params.npz")
    with zipfile.ZipFile(tmp_path / "params.npz") as file:
        first = file.infolist()[0]
    data = bytearray((tmp_path / "params.npz").read_bytes())
    data[first.header_offset + 6] |= 1
    data[data.index(b"PK\1\2") + 8] |= 1
    (tmp_path / "params.npz").write_bytes(bytes(data))
    assert "encrypted" in refused(capsys, "import", str(tmp_path), "--out", str(tmp_path / "reel"))


def test_frames_without_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "frame0.ply", Gaussians.empty(0))
    write_ply(tmp_path / "frame1.ply", Gaussians.empty(0))
    assert "no frame holds a point" in refused(capsys, "import", str(tmp_path), "--out", str(tmp_path / "reel"))


@posix
def test_pipe_among_the_frames_is_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_film(tmp_path, [frame(0)])
    os.mkfifo(tmp_path / "frame0001.ply")
    assert "frame0001.ply" in refused(capsys, "import", str(tmp_path), "--out", str(tmp_path / "reel"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 2000 + "]" * 2000, "nested more than 64 deep"),
        ('[{"width": "96"}]', "is not a cameras.json"),
        ("[" + "{}," * 20_000 + "{}]", "expected a list of up to 10000 cameras"),
    ],
)
def test_invalid_camera_files_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    film, file = write_film(tmp_path / "film", [frame(0)]), tmp_path / "cameras.json"
    file.write_text(text)
    found = refused(capsys, "import", str(film), "--out", str(tmp_path / "reel"), "--cameras", str(file))
    assert said in found
    assert str(file) in found


def camera_path(file: Path, at: float) -> Path:
    viewmat = np.eye(4).ravel().tolist()
    keyframes = [{"at": seconds, "time": 0, "viewmat": viewmat} for seconds in (0, at)]
    file.write_text(json.dumps({"format": "splatreel-path", "version": 1, "keyframes": keyframes}))
    return file


@posix
@pytest.mark.parametrize("kind", ["device", "pipe", "long"])
def test_camera_paths_that_never_end(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    file = tmp_path / "path.json"
    if kind == "pipe":
        os.mkfifo(file)
    given = {"device": Path("/dev/zero"), "pipe": file}.get(kind) or camera_path(file, 1e6)
    film = tmp_path / "film.mp4"
    said = refused(capsys, "export", str(GOLDEN), "--out", str(film), "--path", str(given))
    assert ("at most 1,000,000" if kind == "long" else "pipe or a device") in said
    assert not film.exists()


def test_views_along_a_path_are_made_when_they_are_drawn() -> None:
    lens = cameras()[0]
    pose = lens.viewmat.astype(np.float64)
    shots = film_along_path(CameraPath([Keyframe(0, 0, pose), Keyframe(30_000, 5, pose)]), lens, 30)
    assert len(shots) == 900_001
    assert shots[900_000][0] == pytest.approx(5)
    assert len(shots[1:3]) == 2
    with pytest.raises(IndexError):
        shots[900_001]
    with pytest.raises(UsageError, match="at most 1,000,000"):
        film_along_path(CameraPath([Keyframe(0, 0, pose), Keyframe(1e6, 5, pose)]), lens, 30)


def test_manifest_of_millions_of_objects_is_refused_before_they_are_made() -> None:
    with pytest.raises(ReelError, match="more than 2,000,000 values"):
        parse_object(b'{"layers": [' + b"{}," * 2_000_000 + b"{}]}")


def test_name_with_a_nul(capsys: pytest.CaptureFixture[str]) -> None:
    assert "a NUL character" in refused(capsys, "export", str(GOLDEN), "--out", "a\0b")


@posix
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams(tmp_path: Path, closed: str) -> None:
    """Printed text is dropped. It does not end up in the next file that is opened."""
    out = tmp_path / "frame.ply"
    command = f'"$0" -m splatreel export "$1" --frame 0 --out "$2" {closed}'
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        ["sh", "-c", command, sys.executable, str(GOLDEN), str(out)], capture_output=True, text=True, env=environment
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    assert out.read_bytes().startswith(b"ply\n")
