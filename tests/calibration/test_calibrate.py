import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.board import Board
from splatreel.calibration.calibrate import calibrate, set_distance
from splatreel.calibration.calibration_agreement import CalibratedCamera, rig_of
from splatreel.calibration.calibration_files import camera_files, check_photos
from splatreel.capture.opening import open_capture
from splatreel.capture.sidecar import Sidecar, read_sidecar, write_failure
from splatreel.scene.camera import facing
from tests.capture import folders
from tests.capture.boards import FilmedBoard
from toyroom import capture as filming
from toyroom import room as toys
from toyroom.capture import TARGET, make_capture
from toyroom.raytracer import trace_frame, trace_static


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the videos of the toy room."""
    return make_capture(tmp_path_factory.mktemp("film") / "room", frames=2)


@pytest.mark.slow
def test_calibration_recovers_poses(room: Path, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    known = open_capture(room)
    videos = tmp_path / "videos"
    videos.mkdir()
    for file in room.glob("*.mp4"):
        shutil.copy(file, videos)
    found = calibrate(videos, Silent())
    assert (sorted(found.placed), found.lost) == ([camera.name for camera in known.cameras], [])
    assert found.error < 1
    assert found.notes == open_capture(videos).notes
    assert not list(videos.glob(".calibrate*"))
    capture = open_capture(videos)
    assert found.moments == 2
    assert (capture.frames, capture.width, capture.height) == (2, known.width, known.height)
    here, there = (np.stack([camera.center for camera in c.cameras]) for c in (capture, known))
    assert np.linalg.norm(fitted(here, there) - there, axis=1).max() < 0.05 * np.ptp(there, axis=0).max()
    with pytest.raises(CaptureError, match="is calibrated already"):
        calibrate(videos, Silent())


def fitted(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return points aligned by a similarity transform to others [N, 3]."""
    a, b = here - here.mean(0), there - there.mean(0)
    U, S, Vt = np.linalg.svd(a.T @ b)
    flip = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return (S @ flip).sum() / (a**2).sum() * a @ U @ flip @ Vt + there.mean(0)


def test_videos_without_features_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    for c in range(3):
        folders.write_video(tmp_path / f"phone{c}.mp4", [folders.frame(c, 0, 128, 96)])
    with pytest.raises(CaptureError, match=r"the calibration failed.*only 0 of 3 cameras.*splatreel\[match\]"):
        calibrate(tmp_path, Silent())
    assert sorted(f.name for f in tmp_path.iterdir()) == ["phone0.mp4", "phone1.mp4", "phone2.mp4", "splatreel.json"]
    with pytest.raises(
        CaptureError, match=r"has no cameras, since their calibration failed: only 0 of 3.*--also PHOTOS"
    ):
        open_capture(tmp_path)
    for c in range(3):
        (tmp_path / f"phone{c}.mp4").rename(tmp_path / f"cam{c}.mp4")
    with pytest.raises(CaptureError, match="calibration failed"):  # and not that poses_bounds.npy is missing
        open_capture(tmp_path)


@pytest.mark.slow
def test_cameras_of_one_lens_need_fewer_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    colmap = pytest.importorskip("pycolmap")
    # Few cameras need all details: the film of the package is compressed too much. Of five cameras, the noise of a pixel decides.
    monkeypatch.setattr(filming, "QUALITY", {"crf": "6", "preset": "medium"})
    room, tmp_path = make_capture(tmp_path / "room", frames=2), tmp_path / "videos"
    tmp_path.mkdir()
    known = open_capture(room, held_out=[])
    names = ["cam01", "cam03", "cam04", "cam06", "cam11", "cam13"]
    for name in names:
        shutil.copy(room / f"{name}.mp4", tmp_path)
    found = calibrate(tmp_path, Silent(), same_lens=True)
    assert sorted(found.placed) == names
    model = colmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    assert len({image.camera_id for image in model.images.values()}) == 1
    capture = open_capture(tmp_path, held_out=[])
    assert capture.cameras[0].K[0, 0] == pytest.approx(known.cameras[0].K[0, 0], rel=0.15)
    here, there = (np.stack([rig.camera(name).center for name in names]) for rig in (capture, known))
    assert np.linalg.norm(fitted(here, there) - there, axis=1).max() < 0.05 * np.ptp(there, axis=0).max()


def test_one_lens_needs_one_size(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    for c, width in enumerate((128, 128, 96)):
        folders.write_video(tmp_path / f"phone{c}.mp4", [folders.frame(c, 0, width, 96)])
    with pytest.raises(
        CaptureError, match=r"phone2 has frames of 96x96 pixels, phone0 of 128x96.*leave out --same-lens"
    ):
        calibrate(tmp_path, Silent(), same_lens=True)
    assert not (tmp_path / "sparse").exists()


@pytest.mark.slow
def test_folders_of_images_are_calibrated(room: Path, tmp_path: Path) -> None:
    """The model belongs to the images, which are read with it."""
    pytest.importorskip("pycolmap")
    known, names = open_capture(room, held_out=[]), ["cam01", "cam02", "cam03", "cam04", "cam05"]
    for name in names:
        (tmp_path / name / "images").mkdir(parents=True)
        for number, image in enumerate(known.read(0, 2, [name])[:, 0]):
            Image.fromarray(image).save(tmp_path / name / "images" / f"{number:04d}.png")
    found = calibrate(tmp_path, Silent(), leave_out=["cam05"])
    assert (sorted(found.placed), found.moments) == (names[:4], 2)
    capture = open_capture(tmp_path, held_out=[])
    assert ([camera.name for camera in capture.cameras], capture.frames) == (names[:4], 2)
    with pytest.raises(CaptureError, match="there is no camera 'cam09' to leave out; there are cam01"):
        camera_files(tmp_path, ["cam09"])


@pytest.mark.slow
def test_a_board_in_the_scene_gives_meters(room: Path, tmp_path: Path) -> None:
    """The unit of the room is 1.5 m, by the size of the board's squares."""
    colmap, known = pytest.importorskip("pycolmap"), open_capture(room, held_out=[])
    names = ["cam01", "cam02", "cam03", "cam04", "cam05", "cam06"]
    board = Board(5, 4, 0.15, "checkerboard")
    film = FilmedBoard.seen_by(colmap, [known.camera(name) for name in names])
    pose = np.array([[1.0, 0, 0, -0.4], [0, -1, 0, 1.1], [0, 0, -1, 1.3]])
    for name in names:
        images = known.read(0, 2, [name])[:, 0]
        folders.write_video(tmp_path / f"{name}.mp4", [film.image(name, board, pose, scene=image) for image in images])
    calibrate(tmp_path, Silent(), scale=Board(5, 4, 1.5 * 0.15, "checkerboard"))
    found = open_capture(tmp_path, held_out=[])
    here, there = (np.stack([rig.camera(name).center for name in names]) for rig in (found, known))
    assert np.linalg.norm(here[0] - here[-1]) == pytest.approx(1.5 * np.linalg.norm(there[0] - there[-1]), rel=0.05)


@pytest.mark.slow
def test_photographs_connect_distant_cameras(room: Path, tmp_path: Path) -> None:
    """Over twelve seeds focal lengths are 2 to 6 % too long, and 3 to 11 % if all photographs are equally distant."""
    pytest.importorskip("pycolmap")
    known, films, photos = open_capture(room, held_out=[]), tmp_path / "films", tmp_path / "photos"
    films.mkdir()
    photos.mkdir()
    apart = ["cam00", "cam06", "cam13"]
    for name in apart:
        shutil.copy(room / f"{name}.mp4", films)
    between = [camera.name for camera in known.cameras if camera.name not in apart][::2]
    walk = [known.read(0, 1, [name])[0, 0] for name in between]
    walk += [photograph(*place) for place in [(-15, 12, 3.4), (-5, 16, 2.8), (5, 14, 2.8), (15, 18, 3.4)]]
    for number, image in enumerate(walk):
        Image.fromarray(image).save(photos / f"{number:02d}.jpg", quality=95)
    again = shutil.copytree(films, tmp_path / "again")

    found = calibrate(films, Silent(), photos)
    assert (sorted(found.placed), found.lost) == (apart, [])
    capture = open_capture(films, held_out=[])
    assert [camera.name for camera in capture.cameras] == apart, "photographs are not cameras"
    assert capture.points is not None
    here = np.stack([camera.center for camera in capture.cameras])
    there = np.stack([known.camera(name).center for name in apart])
    assert np.linalg.norm(fitted(here, there) - there, axis=1).max() < 0.05 * np.ptp(there, axis=0).max()
    for camera in capture.cameras:
        assert camera.K[0, 0] == pytest.approx(known.camera(camera.name).K[0, 0], rel=0.1)

    calibrate(again, Silent(), photos)
    models = [[file.read_bytes() for file in sorted((folder / "sparse" / "0").iterdir())] for folder in (films, again)]
    assert models[0] == models[1], "the same videos give the same calibration"


def photograph(azimuth: float, elevation: float, distance: float) -> np.ndarray:
    """Return the toy room from another viewpoint, [H, W, 3] uint8; angles in degrees, distance from its middle in world units."""
    a, e = np.radians(azimuth), np.radians(elevation)
    outwards = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    camera = facing("photograph", TARGET + distance * outwards, -outwards, 1.2 * 256, 256, 192)
    still = toys.standing()
    return trace_frame(camera, trace_static(camera, still, toys.LIGHT), still, toys.moving(0), toys.LIGHT)


def test_invalid_photographs_are_refused(room: Path, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="is not a folder"):
        check_photos(tmp_path / "nowhere")
    with pytest.raises(CaptureError, match="holds no photographs"):
        check_photos(tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"no image")
    with pytest.raises(CaptureError, match=r"a\.jpg"):
        check_photos(tmp_path)


@pytest.mark.parametrize(
    ("distance", "said"),
    [
        (("phone0", "phone7", 2.0), "has no camera phone7, whose distance is given; there are phone0, phone1, phone2"),
        (("phone0", "phone0", 2.0), "is not one of two cameras"),
        (("phone0", "phone1", -1.0), "is not one of two cameras"),
        (("phone0", "phone1", float("nan")), "is not one of two cameras"),
    ],
)
def test_impossible_distances_are_refused(tmp_path: Path, distance: tuple[str, str, float], said: str) -> None:
    for c in range(3):
        folders.write_video(tmp_path / f"phone{c}.mp4", [folders.frame(c, 0)])
    with pytest.raises(CaptureError, match=said):
        calibrate(tmp_path, Silent(), scale=distance)


def test_a_known_distance_makes_the_unit_a_meter() -> None:
    colmap = pytest.importorskip("pycolmap")
    options = colmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig = 3, 1
    model = colmap.synthesize_dataset(options)
    before = rig_of(model)
    one, other, third = sorted(before)
    set_distance(colmap, model, (one, other, 2.5))
    after = rig_of(model)
    gaps = [[np.linalg.norm(rig[one].center - rig[name].center) for name in (other, third)] for rig in (before, after)]
    assert gaps[1][0] == pytest.approx(2.5)
    assert gaps[1][1] / gaps[1][0] == pytest.approx(gaps[0][1] / gaps[0][0]), "all distances change alike"
    assert model.compute_mean_reprojection_error() == pytest.approx(0, abs=1e-3)


def test_success_removes_the_recorded_failure(tmp_path: Path) -> None:
    (tmp_path / "splatreel.json").write_text('{"fps": 25}')
    write_failure(tmp_path, "too far apart")
    assert read_sidecar(tmp_path) == Sidecar(fps=25, failure="too far apart")
    write_failure(tmp_path, None)
    assert read_sidecar(tmp_path) == Sidecar(fps=25)
    (tmp_path / "splatreel.json").unlink()
    write_failure(tmp_path, None)
    assert not (tmp_path / "splatreel.json").exists()


def test_too_few_videos_are_refused(tmp_path: Path) -> None:
    folders.write_video(tmp_path / "phone.mp4", [folders.frame(0, 0)])
    with pytest.raises(CaptureError, match=r"of 1 cameras \(phone\), at least 3"):
        calibrate(tmp_path, Silent())


def placed(seed: int, focal: float = 1.0, points: int = 40) -> dict[str, CalibratedCamera]:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.normal(0, 0.3, (3, 3))).as_matrix()
    return {f"phone{c}": CalibratedCamera(turns[c], rng.normal(0, 1, 3), focal, points) for c in range(3)}


@pytest.mark.parametrize(
    ("moments", "said"),
    [
        (
            [placed(0), placed(1), placed(2)],
            "at different moments of the videos the cameras come out elsewhere; 0 of 3 agree",
        ),
        ([placed(0, 5_963_173 / 1920)] * 3, "phone0 would have a lens that shows 0.0184 degrees"),
        ([placed(0)] * 3, "only 0 of 3 cameras see 100 points or more"),
        ([placed(0)], "only 0 of 3 cameras see enough to be sure of them, 100 points"),
    ],
)
def test_unreliable_model_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moments: list[dict[str, CalibratedCamera]], said: str
) -> None:
    pytest.importorskip("pycolmap")
    for c in range(3):
        folders.write_video(tmp_path / f"phone{c}.mp4", [folders.frame(c, 0)])
    monkeypatch.setattr("splatreel.calibration.calibrate.MomentSolver.solve", lambda *_: moments)
    monkeypatch.setattr("splatreel.calibration.calibrate.rig_of", lambda model: model)
    here = "splatreel.calibration.calibrate.run_in_child"  # where what is patched is not patched
    monkeypatch.setattr(here, lambda function, *arguments, on_message: function(on_message, *arguments))
    with pytest.raises(CaptureError, match=said):
        calibrate(tmp_path, Silent())
    assert not (tmp_path / "sparse").exists()
    assert said in str(read_sidecar(tmp_path).failure)
