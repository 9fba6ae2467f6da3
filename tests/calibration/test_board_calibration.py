import shutil
import struct
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.board import Board, parse_board
from splatreel.calibration.board_calibration import (
    FRAMES,
    BoardRig,
    _half,
    _judged,
    _solve,
    _uncovered,
    calibrate_by_board,
    check_sightings,
    connect,
)
from splatreel.calibration.board_sightings import Sightings
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.colmap_model import import_pycolmap
from splatreel.cli.main import main
from tests.capture import folders
from tests.capture.boards import HEIGHT, WIDTH, FilmedBoard, moves

RIG_BOARD = Board(6, 8, 0.09)
pytest.importorskip("pycolmap")


def solved(film: FilmedBoard, views: dict, path: Path) -> BoardRig:
    return _solve(import_pycolmap(), path, RIG_BOARD, views, dict.fromkeys(film.lenses, (WIDTH, HEIGHT)), Silent())


@pytest.mark.parametrize(("model", "focal", "reach"), [("OPENCV", 1.1, 0.7), ("OPENCV_FISHEYE", 0.35, 1.6)])
def test_lenses_and_poses_are_found_in_meters(tmp_path: Path, model: str, focal: float, reach: float) -> None:
    film = FilmedBoard(import_pycolmap(), [-50, -15, 20, 55], model, focal)
    views = film.sightings(RIG_BOARD, moves(RIG_BOARD, 60, 50, reach=reach))
    rig = solved(film, views, tmp_path)
    own = np.linalg.inv(np.vstack([rig.poses["cam00"], [0, 0, 0, 1]]))
    for name, lens in film.lenses.items():
        assert rig.lenses[name].model.name == model
        assert rig.lenses[name].mean_focal_length() == pytest.approx(lens.mean_focal_length(), rel=0.003)
        assert rig.errors[name] < 0.2
        known, found = film.from_first(name), rig.poses[name] @ own
        assert np.degrees(Rotation.from_matrix(known[:, :3] @ found[:, :3].T).magnitude()) < 0.4
        assert np.linalg.norm(known[:, :3].T @ known[:, 3] - found[:, :3].T @ found[:, 3]) < 0.02


def test_halves_of_the_frames_tell_how_exact_poses_are(tmp_path: Path) -> None:
    colmap = import_pycolmap()
    film = FilmedBoard(colmap, [-50, -15, 20, 55])
    views = film.sightings(RIG_BOARD, moves(RIG_BOARD, 60, 50, reach=0.7))
    rig = solved(film, views, tmp_path)
    halves = [_half(colmap, RIG_BOARD, views, rig, remainder) for remainder in (0, 1)]
    found = _judged(tmp_path, views, rig, halves, [])
    assert (sorted(found.placed), found.lost) == (sorted(film.lenses), [])
    assert 0.001 < found.degrees < 0.4
    assert 1e-5 < found.meters < 0.02
    centers = [-film.from_first(name)[:, :3].T @ film.from_first(name)[:, 3] for name in film.lenses]
    assert found.extent == pytest.approx(np.linalg.norm(centers[0] - centers[3]), rel=0.01)
    swapped = BoardRig(halves[0].lenses, dict(zip(rig.poses, reversed(rig.poses.values()), strict=True)), {}, {})
    with pytest.raises(CaptureError, match="either half of the frames places the cameras elsewhere; 0 of 4 agree"):
        _judged(tmp_path, views, rig, [swapped, halves[1]], [])


def test_groups_of_cameras_without_common_frames_are_named(tmp_path: Path) -> None:
    film = FilmedBoard(import_pycolmap(), [-50, -15, 20, 55])
    views = film.sightings(RIG_BOARD, moves(RIG_BOARD, 40, 50))
    apart = {}
    for frame, seen in views.items():
        kept = {"cam00", "cam01"} if frame % 2 else {"cam02", "cam03"}
        apart[frame] = {name: sighting for name, sighting in seen.items() if name in kept}
    apart = {frame: seen for frame, seen in apart.items() if seen}
    with pytest.raises(CaptureError, match=r"2 groups that no 3 frames connect: cam00, cam01 \| cam02, cam03\. Carry"):
        solved(film, apart, tmp_path)


@pytest.mark.slow
def test_a_camera_that_is_late_contradicts_the_others(tmp_path: Path) -> None:
    film = FilmedBoard(import_pycolmap(), [-50, -15, 20, 55])
    poses = moves(RIG_BOARD, 30, 50)
    views, late = film.sightings(RIG_BOARD, poses), film.sightings(RIG_BOARD, poses[1:] + poses[:1])
    for frame, seen in views.items():
        seen.pop("cam02", None)
        if "cam02" in late.get(frame, {}):
            seen["cam02"] = late[frame]["cam02"]
    with pytest.raises(CaptureError, match=r"contradict each other: .* pixels from where .* capture sync"):
        solved(film, {frame: seen for frame, seen in views.items() if seen}, tmp_path)


def test_the_most_typical_frame_connects_two_cameras() -> None:
    true = np.hstack([Rotation.from_euler("y", 40, degrees=True).as_matrix(), [[1.0], [0], [0]]])
    wrong = np.hstack([Rotation.from_euler("y", -40, degrees=True).as_matrix(), [[5.0], [0], [0]]])
    rest = np.eye(3, 4)
    seen = dict.fromkeys(("a", "b"), None)
    views = dict.fromkeys(range(5), seen)
    boards = {"a": dict.fromkeys(views, rest), "b": {f: wrong if f == 2 else true for f in views}}
    poses, groups = connect(views, boards, 3)  # pyright: ignore[reportArgumentType]
    assert groups == [{"a", "b"}]
    assert np.allclose(poses["b"], true)
    _, apart = connect(views, boards, 6)  # pyright: ignore[reportArgumentType]
    assert apart == [{"a"}, {"b"}]


def test_cameras_with_few_sightings_are_named(tmp_path: Path) -> None:
    film = FilmedBoard(import_pycolmap(), [-50, 0, 50])
    found = film.sightings(RIG_BOARD, moves(RIG_BOARD, 20, 10))
    for frame, seen in found.items():
        seen.pop("cam00", None)
        if frame != 3:
            seen.pop("cam02", None)
    sightings = Sightings(found, {"cam02": Counter({"a checkerboard of 9 x 6 squares": 4, "something": 1})})
    with pytest.raises(CaptureError) as error:
        check_sightings(tmp_path, RIG_BOARD, list(film.lenses), sightings)
    said = str(error.value)
    other = "(other frames show a checkerboard of 9 x 6 squares)"
    assert (
        f"the board 6x8:0.09 in {FRAMES} frames or more. It is in no frame of cam00; 1 frame {other} of cam02. Check"
        in said
    )
    assert "--leave-out cam00,cam02" in said
    check_sightings(tmp_path, RIG_BOARD, ["cam01"], sightings)


def test_still_frames_are_chosen_over_all_of_the_time() -> None:
    """The board rests in two of three frames."""
    film = FilmedBoard(import_pycolmap(), [-20, 20])
    poses = [pose for pose in moves(RIG_BOARD, 60, 5) for _ in range(2)]
    chosen = Sightings(film.sightings(RIG_BOARD, poses, 0)).chosen(dict.fromkeys(film.lenses, WIDTH))
    assert 24 <= len(chosen.found) <= 36
    between = moves(RIG_BOARD, 61, 5, 3)
    mixed = [pose for place, rest in enumerate(moves(RIG_BOARD, 60, 5)) for pose in (rest, rest, between[place])]
    frames = list(Sightings(film.sightings(RIG_BOARD, mixed, 0)).chosen(dict.fromkeys(film.lenses, WIDTH)).found)
    assert all(frame % 3 < 2 for frame in frames)
    assert frames[0] < 15
    assert frames[-1] > 165


def test_images_that_the_board_covers_little_are_named() -> None:
    film = FilmedBoard(import_pycolmap(), [0])
    views = film.sightings(RIG_BOARD, moves(RIG_BOARD, 3, 1))
    size = {"cam00": (WIDTH, HEIGHT)}
    assert "uncertain beyond the part" in _uncovered(views, {"cam00": (4 * WIDTH, 4 * HEIGHT)})[0]
    views[0]["cam00"].places[:4] = [[0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT]]
    assert _uncovered(views, size) == []


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
