import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs, folders

pytest.importorskip("pycolmap")

PERSPECTIVE = {"fl_x": 150.0, "fl_y": 153.0, "cx": 83.2, "cy": 57.9, "w": 160, "h": 120}
BROWN = {"k1": -0.2, "k2": 0.06, "k3": 0.01, "k4": 0.2, "p1": 0.004, "p2": -0.003}
FISHEYE = {"camera_model": "OPENCV_FISHEYE", "k1": 0.05, "k2": -0.01, "k3": 0.002, "k4": -0.001}


def matrix(c: int) -> np.ndarray:
    """Camera to world: columns are the camera's x, y (up) and z (backwards), and its position."""
    R, t = blobs.poses()[c]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = np.stack([R[0], -R[1], -R[2]], 1), -R.T @ t
    return made


def project(c: int, lens: dict[str, Any]) -> np.ndarray:
    """Project as nerfstudio's cameras do; the center of the first pixel is at (0.5, 0.5)."""
    camera = np.linalg.inv(matrix(c)) @ np.concatenate([blobs.POINTS, np.ones((len(blobs.POINTS), 1))], 1).T
    x, y = camera[0] / -camera[2], -camera[1] / -camera[2]
    k1, k2, k3, k4, p1, p2 = (lens.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if lens.get("camera_model") == "OPENCV_FISHEYE" or lens.get("is_fisheye"):
        radius = np.hypot(x, y)
        theta = np.arctan(radius)
        factor = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8) / radius
        bent = np.stack([x * factor, y * factor], 1)
    else:
        r = x * x + y * y
        d = 1.0 + r * (k1 + r * (k2 + r * (k3 + r * k4)))
        bent = np.stack(
            [d * x + 2 * p1 * x * y + p2 * (r + 2 * x * x), d * y + 2 * p2 * x * y + p1 * (r + 2 * y * y)], 1
        )
    return bent * (lens["fl_x"], lens["fl_y"]) + (lens["cx"], lens["cy"])


def write(folder: Path, lens: dict[str, Any], frames: list[dict[str, Any]], file: str = "transforms.json") -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    (folder / file).write_text(json.dumps(lens | {"frames": frames}))
    return folder


def make_image(file: Path, image: np.ndarray) -> None:
    file.parent.mkdir(exist_ok=True, parents=True)
    Image.fromarray(image).save(file)


@pytest.mark.parametrize("lens", [BROWN, FISHEYE, {"is_fisheye": True, "k1": 0.05}], ids=["brown", "fisheye", "ngp"])
def test_photographs(tmp_path: Path, lens: dict[str, Any]) -> None:
    """A frame per camera: the layout of nerfstudio and instant-ngp."""
    lens = PERSPECTIVE | lens
    frames = [{"file_path": f"./images/frame_{c}.png", "transform_matrix": matrix(c).tolist()} for c in range(4)]
    for c in range(4):
        make_image(tmp_path / "images" / f"frame_{c}.png", blobs.draw(project(c, lens), 0.5))
    capture = open_capture(write(tmp_path, lens, frames))
    assert ([c.name for c in capture.cameras], capture.frames) == ([f"frame_{c}" for c in range(4)], 1)
    assert capture.layout == "transforms.json"
    assert blobs.errors(capture).max() < 0.1


def test_lenses_of_frames_and_images_of_twice_the_size(tmp_path: Path) -> None:
    frames = []
    for c in range(4):
        lens = PERSPECTIVE | {"fl_x": 150.0 + 5 * c, "k1": -0.05 * c}
        listed = {"distortion_params": [lens["k1"], 0, 0, 0, 0, 0]} | {k: v for k, v in lens.items() if k != "k1"}
        frames.append(listed | {"file_path": f"images\\{c}.png", "transform_matrix": matrix(c)[:3].tolist()})
        make_image(tmp_path / "images" / f"{c}.png", blobs.draw(2 * project(c, lens), 0.5, 320, 240))
    assert blobs.errors(open_capture(write(tmp_path, {"camera_model": "OPENCV"}, frames))).max() < 0.1


def timed(folder: Path, times: bool = True, separate: bool = True) -> Path:
    """Write 3 frames of 4 cameras, out of order. The name of a file says its camera and its frame."""
    frames = []
    for t in (2, 0, 1):
        for c in (1, 0, 3, 2):
            number = {0: 8, 1: 9, 2: 10}[t]
            file = f"images/cam0{c}/{number}.png" if separate else f"images/cam0{c}_{number}.png"
            frame = {"file_path": file, "transform_matrix": matrix(c).tolist()}
            frames.append(frame | ({"time": t / 2} if times else {}))
            make_image(folder / file, folders.frame(c, t, 160, 120))
    return write(folder, PERSPECTIVE, frames)


@pytest.mark.parametrize("times", [True, False])
@pytest.mark.parametrize("separate", [True, False])
def test_frames_of_one_pose_are_one_camera(tmp_path: Path, times: bool, separate: bool) -> None:
    """Numbers in names are compared by value: 9 is before 10."""
    capture = open_capture(timed(tmp_path, times, separate))
    assert (len(capture.cameras), capture.frames) == (4, 3)
    if separate:
        assert [c.name for c in capture.cameras] == ["cam00", "cam01", "cam02", "cam03"]
    found = capture.read(0, 3, [c.name for c in capture.cameras])
    assert [[folders.which(image) for image in row] for row in found] == [[(c, t) for c in range(4)] for t in range(3)]


def test_deleted_images_of_instant_ngp_are_left_out(tmp_path: Path) -> None:
    """Its script rates the sharpness, and its example lacks the blurred images."""
    frames = [
        {"file_path": f"images/{c}.png", "sharpness": 20.0, "transform_matrix": matrix(c).tolist()} for c in range(4)
    ]
    for c in (0, 1, 3):
        make_image(tmp_path / "images" / f"{c}.png", folders.frame(c, 0, 160, 120))
    capture = open_capture(write(tmp_path, PERSPECTIVE, frames))
    assert [c.name for c in capture.cameras] == ["0", "1", "3"]


def test_a_missing_time_is_a_gap_of_that_camera(tmp_path: Path) -> None:
    """Times decide, not the names of files."""
    timed(tmp_path)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    del meta["frames"][0]  # camera 1 at the last time
    for frame in meta["frames"]:
        frame["time"] = 1 - frame["time"]
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    capture = open_capture(tmp_path)
    names = [camera.name for camera in capture.cameras]
    assert capture.missing(0, 3, names).tolist() == [[False, True, False, False], *[[False] * 4] * 2]
    assert [folders.which(image) for image in capture.read(0, 3, ["cam00"])[:, 0]] == [(0, 2), (0, 1), (0, 0)]


def test_cameras_that_are_left_out_need_no_files(tmp_path: Path) -> None:
    timed(tmp_path)
    (tmp_path / "images" / "cam03" / "9.png").unlink()
    capture = open_capture(tmp_path, leave_out=["cam03"])
    assert [camera.name for camera in capture.cameras] == ["cam00", "cam01", "cam02"]
    with pytest.raises(CaptureError, match="there is no camera 'cam09' to leave out"):
        open_capture(tmp_path, leave_out=["cam03", "cam09"])


def test_a_frame_and_a_folder_per_camera(tmp_path: Path) -> None:
    timed(tmp_path)
    frames = [{"file_path": f"images/cam0{c}/8.png", "transform_matrix": matrix(c).tolist()} for c in range(4)]
    write(tmp_path, PERSPECTIVE, frames)
    assert open_capture(tmp_path).frames == 3


def test_videos_as_frames_or_named_as_cameras(tmp_path: Path) -> None:
    for c in range(4):
        folders.write_video(tmp_path / f"v{c}.mp4", [folders.frame(c, t, 160, 120) for t in range(2)])
    for name in ("v{}.mp4", "images/v{}.png"):
        frames = [{"file_path": name.format(c), "transform_matrix": matrix(c).tolist()} for c in range(4)]
        capture = open_capture(write(tmp_path, PERSPECTIVE, frames))
        assert folders.which(capture.read(1, 1, ["v2"])[0, 0]) == (2, 1)
        capture.close()


def test_synthetic_scenes_of_blender(tmp_path: Path) -> None:
    """NeRF's layout: files without extension, one angle for a lens, and test views in a file of their own."""
    lens = PERSPECTIVE | {"fl_x": 150.0, "fl_y": 150.0, "cx": 80.0, "cy": 60.0}
    angle = {"camera_angle_x": 2 * np.arctan(80 / 150)}
    for file, members in (("train", (0, 1, 2)), ("test", (3,))):
        frames = []
        for c in members:
            make_image(tmp_path / file / f"r_{c}.png", blobs.draw(project(c, lens), 0.5))
            frames.append({"file_path": f"./{file}/r_{c}", "rotation": 0.1, "transform_matrix": matrix(c).tolist()})
        write(tmp_path, angle, frames, f"transforms_{file}.json")
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    colors = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    (tmp_path / "points3d.ply").write_text(f"{header}{colors}end_header\n0 0.5 1 255 0 51\n-1 0 0.25 0 0 0\n")
    capture = open_capture(tmp_path)
    assert sorted(c.name for c in capture.cameras) == ["test/r_3", "train/r_0", "train/r_1", "train/r_2"]
    assert capture.held_out == ["test/r_3"]
    assert blobs.errors(capture).max() < 0.1
    assert capture.points is not None
    assert capture.point_colors is not None
    np.testing.assert_allclose(capture.points, [[0, 0.5, 1], [-1, 0, 0.25]])
    np.testing.assert_allclose(capture.point_colors, [[1, 0, 0.2], [0, 0, 0]], atol=1e-6)


TEXT = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{more}end_header\n"
)
COLORS = "".join(f"property {{}} {name}\n" for name in ("red", "green", "blue"))


@pytest.mark.parametrize(
    ("more", "rows", "colors"),
    [
        (
            f"{COLORS.replace('{}', 'uchar')}property uchar alpha\nelement face 1\nproperty list uchar uint vertex_indices\n",
            ["0 0 1 255 0 51 255", "nan 0 1 0 0 0 255", "-1 0 2 0 0 0 255", "3 0 1 2"],
            [[1, 0, 0.2], [0, 0, 0]],
        ),
        (COLORS.replace("{}", "float"), ["0 0 1 1 0 0.2", "nan 0 1 0 0 0", "-1 0 2 0 0 0"], [[1, 0, 0.2], [0, 0, 0]]),
        (COLORS.replace("{}", "float"), ["0 0 1 255 0 51", "nan 0 1 0 0 0", "-1 0 2 0 0 0"], [[1, 0, 0.2], [0, 0, 0]]),
        ("", ["0 0 1", "nan 0 1", "-1 0 2"], None),
    ],
    ids=["faces", "unit floats", "byte floats", "no colors"],
)
def test_points_of_other_programs(tmp_path: Path, more: str, rows: list[str], colors: list[list[float]] | None) -> None:
    """BlenderNeRF writes faces behind the points, and other programs write other types or no color."""
    timed(tmp_path)
    (tmp_path / "points3d.ply").write_text(TEXT.format(more=more) + "\n".join(rows) + "\n")
    capture = open_capture(tmp_path)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points, [[0, 0, 1], [-1, 0, 2]])
    assert (capture.point_colors is None) == (colors is None)
    if colors is not None and capture.point_colors is not None:
        np.testing.assert_allclose(capture.point_colors, colors, atol=1e-6)


@pytest.mark.parametrize("text", ["ply\n", TEXT.format(more="") + "0 0 1\n", TEXT.replace(" z", " w").format(more="")])
def test_damaged_points_are_named(tmp_path: Path, text: str) -> None:
    timed(tmp_path)
    (tmp_path / "points3d.ply").write_text(text)
    with pytest.raises(CaptureError, match=r"points3d\.ply: .* [Ee]xport it again or remove it"):
        open_capture(tmp_path)


def test_a_moving_camera_is_refused(tmp_path: Path) -> None:
    """The layout of D-NeRF."""
    frames = [{"file_path": f"./train/r_{c}", "time": c / 3, "transform_matrix": matrix(c).tolist()} for c in range(4)]
    write(tmp_path, {"camera_angle_x": 1.0}, frames, "transforms_train.json")
    with pytest.raises(CaptureError, match="its 4 images have 4 times and 4 poses: the camera moves, as in D-NeRF"):
        open_capture(tmp_path)


def change(folder: Path, number: int | None, **values: Any) -> None:
    meta = json.loads((folder / "transforms.json").read_text())
    (meta if number is None else meta["frames"][number]).update(values)
    (folder / "transforms.json").write_text(json.dumps(meta))


@pytest.mark.parametrize(
    ("number", "values", "message"),
    [
        (None, {"camera_model": "EQUIRECTANGULAR"}, r"camera cam00: has the lens EQUIRECTANGULAR"),
        (None, {"latlong": True}, r"camera cam00: has the lens latlong"),
        (None, {"fl_x": 0, "fl_y": 0}, r"camera cam00: cannot be read \(it has no positive focal length"),
        (None, {"fl_x": "wide"}, r"fl_x is 'wide', not a number"),
        (None, {"distortion_params": [0, 0]}, r"camera cam00: cannot be read"),
        (None, {"w": 120, "h": 160}, r"camera cam00 is calibrated for 120x160.*turned by a quarter"),
        (None, {"ply_file_path": "points.ply"}, r"points\.ply: is missing, though transforms\.json names it"),
        (None, {"frames": []}, r"transforms\.json: lists no frames"),
        (None, {"frames": 3}, r"transforms\.json: cannot be read"),
        (0, {"time": 0.5}, r"camera cam01 has 3 images with 2 different times"),
        (0, {"time": "late"}, r"frame 0: cannot be read \(its file_path is .* and its time 'late'"),
        (0, {"transform_matrix": [[1, 0], [0, 1]]}, r"frame 0: cannot be read"),
        (0, {"file_path": "images/cam01/77.png"}, r"77\.png: is missing, and so are 0 more of the 12 files"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, number: int | None, values: dict[str, Any], message: str) -> None:
    change(timed(tmp_path), number, **values)
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)


def test_a_frame_without_a_pose_is_named(tmp_path: Path) -> None:
    timed(tmp_path)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    del meta["frames"][5]["transform_matrix"]
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    with pytest.raises(CaptureError, match=r"frame 5: has no 'transform_matrix'"):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("shutter", "named"),
    [({}, False), ({"rolling_shutter": [0, 0, 0, 0]}, False), ({"rolling_shutter": [0, 0, 0.02, 0]}, True)],
)
def test_a_rolling_shutter_is_named(tmp_path: Path, shutter: dict[str, Any], named: bool) -> None:
    frames = [{"file_path": f"images/{c}.png", "transform_matrix": matrix(c).tolist()} for c in range(4)]
    for c in range(4):
        make_image(tmp_path / "images" / f"{c}.png", blobs.draw(project(c, PERSPECTIVE), 0.5))
    capture = open_capture(write(tmp_path, PERSPECTIVE | shutter, frames))
    assert any("rolling_shutter [0, 0, 0.02, 0] is not read" in note for note in capture.notes) == named


@pytest.mark.parametrize("place", ["masks/{}.png", "masks/{}/0.png"])
def test_masks_of_frames_are_named_with_the_option_that_reads_them(tmp_path: Path, place: str) -> None:
    frames = [
        {"file_path": f"images/{c}.png", "mask_path": place.format(c), "transform_matrix": matrix(c).tolist()}
        for c in range(4)
    ]
    for c in range(4):
        make_image(tmp_path / "images" / f"{c}.png", blobs.draw(project(c, PERSPECTIVE), 0.5))
    write(tmp_path, PERSPECTIVE, frames)
    assert any("mask_path of 4 of 4 frames is not read" in note for note in open_capture(tmp_path).notes)
    for c in range(4):
        image = np.zeros((PERSPECTIVE["h"], PERSPECTIVE["w"], 3), np.uint8)
        image[:, : image.shape[1] // 2] = 255
        make_image(tmp_path / place.format(c), image)
    notes = open_capture(tmp_path).notes
    assert any(note.endswith(f"--masks {tmp_path / 'masks'}") for note in notes), notes
    alpha = open_capture(tmp_path, masks=tmp_path / "masks").alpha(0, 1, ["0"])
    assert alpha is not None
    assert abs(float((alpha > 127).mean()) - 0.5) < 0.05


def test_frames_without_masks_have_no_such_line(tmp_path: Path) -> None:
    timed(tmp_path)
    assert not any("mask_path" in note for note in open_capture(tmp_path).notes)
