import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.calibrations.motion_capture import is_toml, read_toml
from tests.capture import blobs, folders

cv2 = pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

K = np.array([[blobs.FOCAL, 0, 83.0], [0, blobs.FOCAL + 4, 57.0], [0, 0, 1]])
FISHEYE = np.array([0.05, -0.01, 0.002, -0.001])


def project(c: int, bends: np.ndarray | tuple[float, ...] = blobs.BENDS) -> np.ndarray:
    """Project as aniposelib's `Camera.project` does."""
    R, t = blobs.poses()[c]
    return cv2.projectPoints(blobs.POINTS, cv2.Rodrigues(R)[0], t, K, np.array(bends))[0].reshape(-1, 2)


def project_fisheye(c: int) -> np.ndarray:
    """Project as aniposelib's `FisheyeCamera.project` does."""
    R, t = blobs.poses()[c]
    points = blobs.POINTS.reshape(-1, 1, 3)
    return cv2.fisheye.projectPoints(points, cv2.Rodrigues(R)[0], t.reshape(3, 1), K, FISHEYE)[0].reshape(-1, 2)


def table(c: int, key: str, extra: str = "", matrix: bool = False, bends: Sequence[float] = blobs.BENDS) -> str:
    R, t = blobs.poses()[c]
    rotation = R.tolist() if matrix else cv2.Rodrigues(R)[0].ravel().tolist()
    return (
        f"[{key}]\nsize = [{blobs.WIDTH}, {blobs.HEIGHT}]\nmatrix = {K.tolist()}\ndistortions = {list(bends)}\n"
        f"rotation = {rotation}\ntranslation = {t.tolist()}\n{extra}\n"
    )


METADATA = "[metadata]\nadjusted = false\nerror = 0.0\n"


def test_anipose_and_freemocap(tmp_path: Path) -> None:
    """FreeMoCap's folder: synchronized_videos/, and NAME_camera_calibration.toml at the top."""
    names = [f"Camera_{c:03d}" for c in range(4)]
    text = "".join(table(c, f"cam_{c}", f'name = "{name}"') for c, name in enumerate(names))
    (tmp_path / "session_camera_calibration.toml").write_text(text + METADATA)
    blobs.write(tmp_path / "synchronized_videos", names, project, first=0)
    capture = open_capture(tmp_path)
    assert ([c.name for c in capture.cameras], capture.layout) == (names, "TOML")
    assert blobs.errors(capture).max() < 0.1


def test_pose2sim_has_four_coefficients_and_sizes_with_fractions(tmp_path: Path) -> None:
    (tmp_path / "calibration").mkdir()
    text = "".join(
        table(c, f"int_cam0{c + 1}_img", f'name = "cam0{c + 1}"\nfisheye = false', bends=blobs.BENDS[:4])
        for c in range(4)
    )
    text = text.replace("[160, 120]", "[ 160.0, 120.0]")
    (tmp_path / "calibration" / "Calib_scene.toml").write_text(text + METADATA)
    blobs.write(tmp_path / "videos", [f"cam0{c + 1}" for c in range(4)], lambda c: project(c, blobs.BENDS[:4]), first=0)
    assert blobs.errors(open_capture(tmp_path)).max() < 0.1


@pytest.mark.parametrize("matrix", [True, False])
def test_caliscope_numbers_cameras(tmp_path: Path, matrix: bool) -> None:
    """Older versions write the rotation as a matrix. Cameras to ignore, or without a pose, are left out."""
    text = "".join(table(c, f"cameras.{c}", "rotation_count = 1", matrix) for c in range(4))
    text += table(0, "cameras.4", "ignore = true") + '[cameras.5]\nsize = [160, 120]\nmatrix = "null"\n'
    (tmp_path / "camera_array.toml").write_text(text)
    blobs.write(tmp_path / "recordings" / "recording_1", [f"port_{c}" for c in range(4)], project, first=0)
    capture = open_capture(tmp_path)
    assert blobs.errors(capture).max() < 0.1
    assert capture.notes[0] == f"{tmp_path}/camera_array.toml: cam_5 without a pose were left out"


SESSIONS = {
    "calibration at the top": ("camera_array.toml", "recordings/walk", "port_{}", "cameras.{}"),
    "calibration below": (
        "calibration/extrinsic/capture_volume/camera_array.toml", "recordings/walk", "cam_{}", "cameras.{}"
    ),
    "videos of the calibration": ("camera_array.toml", "calibration/extrinsic", "cam_{}", "cameras.{}"),
    "synchronized videos": (
        "walk_camera_calibration.toml", "synchronized_videos", "Camera_00{}_synchronized", "cam_{}"
    ),
    "trial": ("calibration/Calib_scene.toml", "videos", "cam0{}", "cam_{}"),
    "trial of a session": ("calibration/Calib_qualisys.toml", "Trial_1/videos", "cam0{}", "cam_{}"),
    "trial of a participant": ("S00_Calibration/Calib.toml", "S00_P00/S00_P00_T00/videos", "cam_0{}", "cam_{}"),
}  # fmt: skip
"""Calibration, folder of the videos, names of videos and of tables, as Caliscope, FreeMoCap and Pose2Sim leave them."""


@pytest.mark.parametrize("kind", SESSIONS)
def test_sessions_are_read_from_their_folder_and_from_each_recording(tmp_path: Path, kind: str) -> None:
    file, place, name, key = SESSIONS[kind]
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text("".join(table(c, key.format(c)) for c in range(4)))
    blobs.write(tmp_path / place, [name.format(c) for c in range(4)], project, first=0)
    folder = tmp_path / place
    while folder != tmp_path.parent:
        capture = open_capture(folder)
        assert blobs.errors(capture).max() < 0.1
        is_above = not (tmp_path / file).is_relative_to(folder)
        assert any("in a folder above the recording" in note for note in capture.notes) == is_above
        capture.close()
        folder = tmp_path if folder.parent.name in ("recordings", "calibration") else folder.parent


def test_calibration_above_is_of_the_videos(tmp_path: Path) -> None:
    """Lenses without poses do not count, and neither do calibrations of other cameras."""
    lenses = "".join(f"[cameras.{c}]\nsize = [160, 120]\nmatrix = {K.tolist()}\ntranslation = 0\n" for c in range(4))
    (tmp_path / "camera_array.toml").write_text(lenses)
    file = tmp_path / "calibration" / "extrinsic" / "capture_volume" / "camera_array.toml"
    file.parent.mkdir(parents=True)
    file.write_text("".join(table(c, f"cameras.{c}") for c in range(4)))
    blobs.write(tmp_path / "recordings" / "walk", [f"cam_{c}" for c in range(4)], project, first=0)
    for folder in (tmp_path, tmp_path / "recordings" / "walk"):
        assert blobs.errors(open_capture(folder)).max() < 0.1
    turned = "".join(table((c + 1) % 4, f"cameras.{c}") for c in range(4))
    (tmp_path / "camera_array.toml").write_text(turned)
    assert blobs.errors(open_capture(tmp_path)).max() < 0.1, "the one of the extrinsic calibration counts"
    other = tmp_path / "recordings" / "other"
    other.mkdir()
    for c, name in enumerate(("left", "right", "top")):
        folders.write_video(other / f"{name}.mp4", [folders.frame(c, t, 160, 120) for t in range(2)])
    with pytest.raises(CaptureError, match="without poses of their cameras"):
        open_capture(other)
    for name in ("run", "jump"):
        blobs.write(tmp_path / "recordings" / name, [f"cam_{c}" for c in range(4)], project, first=0)
    with pytest.raises(CaptureError, match=r"recordings/jump, recordings/run, recordings/walk\. Give the one to read"):
        open_capture(tmp_path)


def test_pixels_that_a_codec_added_are_cut_off(tmp_path: Path) -> None:
    """Calibrated for 168 x 120, filmed with 160 x 120: the first pixel is the same."""
    text = "".join(table(c, f"cam_{c}") for c in range(4)).replace("size = [160", "size = [168")
    (tmp_path / "calibration.toml").write_text(text)
    blobs.write(tmp_path / "images", [f"cam_{c}" for c in range(4)], project, first=0)
    capture = open_capture(tmp_path)
    assert blobs.errors(capture).max() < 0.1
    assert "calibrated for 168x120, but its images are 160x120; the pixels at the right and" in capture.notes[0]


def test_fisheye(tmp_path: Path) -> None:
    text = "".join(table(c, f"cam_{c}", f'name = "{c}"\nfisheye = true', bends=FISHEYE.tolist()) for c in range(4))
    (tmp_path / "calibration.toml").write_text(text)
    blobs.write(tmp_path / "images", [str(c) for c in range(4)], project_fisheye, first=0)
    assert blobs.errors(open_capture(tmp_path)).max() < 0.1


def test_videos_beside_the_file_are_read(tmp_path: Path) -> None:
    """cam*.mp4 alone would be a Neu3DV folder."""
    (tmp_path / "calibration.toml").write_text("".join(table(c, f"cam_{c}") for c in range(3)))
    for c in range(3):
        frames = [folders.frame(c, t, blobs.WIDTH, blobs.HEIGHT) for t in range(2)]
        folders.write_video(tmp_path / f"cam_{c}.mp4", frames)
    capture = open_capture(tmp_path, width=80)
    assert (capture.frames, capture.width, capture.height) == (2, 80, 60)
    assert folders.which(capture.read(1, 1, ["cam_2"])[0, 0]) == (2, 1)
    capture.close()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "size = [160, 120]",
            "size = [120, 160]",
            r"cam_0 is calibrated for 120x160.*160x120, turned by a quarter.*Turn",
        ),
        ("size = [160, 120]", "size = [160, 100]", r"cam_0 is calibrated for 160x100.*another aspect ratio.*Crop"),
        ("size = [160, 120]", "size = 160", r"camera cam_0: cannot be read"),
        ("distortions", "distortion", r"camera cam_0: has no 'distortions'"),
        ("[[150.0, 0.0", "[[-150.0, 0.0", r"focal lengths must be positive"),
        ("[[150.0, 0.0", "[[nan, 0.0", r"cam_0: cannot be read \(nan is not a finite number"),
        ("0.01]", "0.01, 0, 0, 0, 0.5]", r"has 9 distortion coefficients .*of which 8 are supported"),
        ("rotation = ", "turn = ", r"calibration\.toml: no camera has a pose \(none\)"),
        ("[cam_", 'name = "a"\n[cam_', r"calibration\.toml: two cameras have one name \(a, a, a, cam_3\)"),
        ("[cam_0]", "[cam_0", r"calibration\.toml: is not a TOML file"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = "".join(table(c, f"cam_{c}") for c in range(4))
    assert old in text
    (tmp_path / "calibration.toml").write_text(text.replace(old, new))
    blobs.write(tmp_path / "images", [f"cam_{c}" for c in range(4)], project, first=0)
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)


def test_two_files_must_agree(tmp_path: Path) -> None:
    text = "".join(table(c, f"cam_{c}") for c in range(4))
    blobs.write(tmp_path / "images", [f"cam_{c}" for c in range(4)], project, first=0)
    (tmp_path / "a.toml").write_text(text)
    (tmp_path / "b.toml").write_text(text + METADATA)
    assert open_capture(tmp_path).origin == tmp_path / "a.toml"
    (tmp_path / "b.toml").write_text(text.replace("translation = [", "translation = [0.1, 0.2, 3.0]\nother = ["))
    with pytest.raises(CaptureError, match=r"two calibrations, a\.toml and b\.toml, whose cameras differ"):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (".".join(["a"] * 100_000) + " = 1", "a key with more than 16 dots"),
        ("[" + " . ".join(['"a b"', "c"] * 50_000) + "]", "a key with more than 16 dots"),
        ("a" * 1_000_000, "is not a TOML file"),
        ("a = " + "9" * 5000, "is not a TOML file"),
        ("a = " + "[" * 5000, "is not a TOML file"),
    ],
    ids=["dotted", "quoted", "long", "digits", "nested"],
)
def test_hostile_lines_are_refused_at_once(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / "a.toml").write_text(line)
    with pytest.raises(CaptureError, match=rf"a\.toml: .*{message}"):
        read_toml(tmp_path / "a.toml")


def test_blank_lines_take_linear_time() -> None:
    """Quadratic time was a minute for this text."""
    started = time.process_time()
    assert not is_toml(Path("a.toml"), b"\n" * 100_000)
    assert time.process_time() - started < 5
