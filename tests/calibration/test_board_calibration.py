import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.board_calibration import calibrate_by_board
from splatreel.calibration.boards.board import Board, parse_board
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.colmap_model import import_pycolmap
from splatreel.cli.main import main
from tests.capture import folders
from tests.capture.boards import FilmedBoard, moves

BOARD = Board(6, 8, 0.09)
pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def film() -> FilmedBoard:
    return FilmedBoard(import_pycolmap(), [-35, 0, 40])


@pytest.fixture(scope="module")
def videos(film: FilmedBoard, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return videos of a board; `cam02` sees it in the last frames only."""
    return film.write(tmp_path_factory.mktemp("board") / "videos", BOARD, moves(BOARD, 20, 40, reach=0.4))


@pytest.mark.slow
def test_videos_of_a_board_calibrate_a_capture(
    film: FilmedBoard, videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene is filmed later, and shows no texture."""
    scene = tmp_path / "scene"
    scene.mkdir()
    for name in film.lenses:
        folders.write_video(scene / f"{name}.mp4", [folders.frame(0, t, 480, 360) for t in range(3)])
    assert main(["capture", "calibrate", str(scene), "--board", "6x8:0.09", "--board-videos", str(videos)]) == 0
    said = capsys.readouterr().out
    assert "3 cameras, up to 2.6" in said
    assert "either half of the frames gives the same poses within" in said
    assert not (videos / "sparse").exists()
    capture = open_capture(scene, held_out=[])
    assert capture.points is None
    assert [camera.name for camera in capture.cameras] == list(film.lenses)
    first = np.linalg.inv(capture.camera("cam00").viewmat.astype(np.float64))
    for name in film.lenses:
        known, found = film.from_first(name), (capture.camera(name).viewmat @ first)[:3]
        assert np.degrees(Rotation.from_matrix(known[:, :3] @ found[:, :3].T).magnitude()) < 1
        assert np.linalg.norm(known[:, :3].T @ known[:, 3] - found[:, :3].T @ found[:, 3]) < 0.04
    assert main(["capture", "calibrate", str(scene), "--board", "6x8:0.09"]) == 1
    assert "is calibrated already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_camera_without_the_board_and_another_dictionary_are_named(videos: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(videos, tmp_path / "videos")
    folders.write_video(folder / "cam02.mp4", [folders.frame(0, 0, 480, 360)] * 20)
    with pytest.raises(CaptureError, match=r"It is in no frame of cam02\. Check .*--leave-out cam02"):
        calibrate_by_board(folder, BOARD, Silent())
    with pytest.raises(
        CaptureError, match=r"no frame \(other frames show markers of the dictionary 4X4_1000\) of cam00; no"
    ):
        calibrate_by_board(folder, Board(6, 8, 0.09, "6X6_50"), Silent())
    assert not (folder / "sparse").exists()


def test_videos_of_the_board_need_the_cameras_names(tmp_path: Path) -> None:
    for folder, prefix in (("scene", "cam"), ("boards", "phone")):
        (tmp_path / folder).mkdir()
        for c in range(3):
            folders.write_video(tmp_path / folder / f"{prefix}{c}.mp4", [folders.frame(c, 0)])
    with pytest.raises(
        CaptureError, match=r"in no video of cam0, cam1, cam2; there are phone0, phone1, phone2\. Name each"
    ):
        calibrate_by_board(tmp_path / "scene", BOARD, Silent(), tmp_path / "boards")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--board-videos", "x"], "--board-videos needs the board that they show"),
        (["--board", "5x7:0.03", "--also", "x"], "--board gives lenses, poses and meters"),
        (["--distance", "a", "b", "2", "--scale-board", "5x7:0.03"], "Leave out one of them"),
        (["--board", "5x7"], "'5x7' is not understood"),
        (["--scale-board", "5x7"], "'5x7' is not understood"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    for c in range(3):
        folders.write_video(tmp_path / f"cam{c}.mp4", [folders.frame(c, 0)])
    assert main(["capture", "calibrate", str(tmp_path), *options]) == 2
    assert said in capsys.readouterr().err


def png(width: int, height: int, content: bytes = b"") -> bytes:
    """Return a PNG file that claims a size."""
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", content), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in parts
    )


BLACK = zlib.compress(bytes(48 * (1 + 3 * 64)))
BOMB = zlib.compress(bytes(3 * 20_000 * 1_000))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("0.png", b"", r"0\.png: cannot be read"),
        ("0.png", b"no image", r"0\.png: cannot be read"),
        ("0.png", png(64, 48, BLACK)[:60], r"0\.png: cannot be read"),
        ("0.png", png(1_000_000, 1_000_000), r"0\.png: cannot be read"),
        ("0.png", png(20_000, 15_000, BOMB), r"0\.png: cannot be read"),
        ("0.png", png(64, 48, BLACK), "each camera must show the board"),
        ("../{camera}.mp4", b"no video", r"\.mp4: cannot be decoded"),
        (None, b"", "is not a folder"),
    ],
)
def test_hostile_videos_of_a_board_are_named(tmp_path: Path, name: str | None, content: bytes, said: str) -> None:
    scene, shown = tmp_path / "scene", tmp_path / "shown"
    for camera in ("a", "b", "c"):
        for folder, file, data in ((scene, "0.png", png(64, 48, BLACK)), (shown, name, content)):
            if file is not None:
                (folder / camera).mkdir(parents=True)
                (folder / camera / file.format(camera=camera)).write_bytes(data)
    with pytest.raises(CaptureError, match=said):
        calibrate_by_board(scene, parse_board("5x7:0.035"), Silent(), shown)
    assert sorted(path.name for path in scene.iterdir()) == ["a", "b", "c"]
