import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError, MissingDependencyError
from splatreel.calibration.calibration_files import camera_files
from splatreel.capture.opening import open_capture
from splatreel.scene.reel_source import ReelSource
from tests.capture import folders


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    pytest.importorskip("pycolmap")
    return folders.colmap(tmp_path / "scene")


def test_names_match_without_extension(scene: Path) -> None:
    capture = open_capture(scene)
    assert [c.name for c in capture.cameras] == [f"view/cam{c:02d}" for c in range(4)]
    assert capture.held_out == ["view/cam01"]
    assert (capture.frames, capture.width, capture.height) == (1, 32, 24)
    assert folders.which(capture.read(0, 1, ["view/cam02"])[0, 0]) == (2, 0)


def test_cameras_and_points_match_the_model(scene: Path) -> None:
    capture = open_capture(scene)
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=1e-5)
        np.testing.assert_allclose(found.K, written.K, atol=1e-5)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points, [[0.5, -0.25, 1], [0, 0, 0]])
    assert capture.point_colors is not None
    np.testing.assert_allclose(capture.point_colors, [[1, 0.2, 0], [0, 1, 0.4]], atol=1e-6)


def test_binary_model_gives_the_same_cameras(scene: Path, tmp_path: Path) -> None:
    import pycolmap

    text = open_capture(scene)
    model = scene / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(str(model))
    shutil.rmtree(model)
    model.mkdir()
    reconstruction.write_binary(str(model))
    assert open_capture(scene).fingerprint() == text.fingerprint()


def test_scale_refers_to_the_model_size(scene: Path) -> None:
    assert open_capture(scene, scale=0.25).width == 16
    assert open_capture(scene, width=16).height == 12


def test_smallest_sufficient_images_are_read(scene: Path) -> None:
    shutil.copytree(scene / "images_2", scene / "images_4")
    for path in (scene / "images_4").rglob("*.jpg"):
        Image.new("RGB", (16, 12), (255, 0, 0)).save(path)
    assert open_capture(scene).width == 32
    assert open_capture(scene, width=16).read(0, 1, ["view/cam01"])[0, 0, 6, 8, 0] > 240
    assert folders.which(open_capture(scene, width=20).read(0, 1, ["view/cam01"])[0, 0]) == (1, 0)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_RADIAL", "80 32 24 0.3"),
        ("SIMPLE_RADIAL", "80 30 25 -0.2"),
        ("OPENCV_FISHEYE", "60 62 32 24 0.1 0 0 0"),
    ],
)
def test_colmap_lens_distortion_is_removed(tmp_path: Path, model: str, params: str) -> None:
    """The colors of the images encode the direction of each pixel."""
    pycolmap = pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene", model, params)
    lens = pycolmap.Camera(model=model, width=64, height=48, params=[float(p) for p in params.split()])
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    rays = np.asarray(lens.cam_from_img(np.stack([x.ravel(), y.ravel()], 1))).reshape(48, 64, -1)
    colors = np.concatenate([128 + 150 * rays[..., :2], np.full((48, 64, 1), 7)], 2)
    for file in (scene / "images_2").rglob("*.jpg"):
        file.unlink()
        Image.fromarray(np.rint(colors).astype(np.uint8)).save(file.with_suffix(".png"))
    capture = open_capture(scene)
    camera = capture.cameras[1]
    K = camera.K.astype(float)
    assert (camera.width, camera.height, K[0, 0], K[0, 2]) == (64, 48, K[1, 1], 32)
    expected = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]], 2)
    found = (capture.read(0, 1, [camera.name])[0, 0, ..., :2] - 128.0) / 150
    assert np.abs(found - expected).max() < 2 / 150
    # Most of it is still seen.
    assert np.abs(rays[..., :2]).max((0, 1)).min() <= 1.15 * np.abs(expected).max((0, 1)).max()


def test_invalid_lens_parameters_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene", "SIMPLE_RADIAL", "80 500 24 0.1")
    with pytest.raises(CaptureError, match=r"camera 1 is SIMPLE_RADIAL .*500.*Calibrate it again"):
        open_capture(scene)


def filmed(folder: Path, names: list[str], frames: list[int]) -> Path:
    """Return the model with a video of each camera."""
    made = folders.colmap(folder)
    text = (made / "sparse/0/images.txt").read_text().replace("view/", "")
    (made / "sparse/0/images.txt").write_text(text)
    shutil.rmtree(made / "images_2")
    (made / "videos").mkdir()
    for c, (name, count) in enumerate(zip(names, frames, strict=True)):
        folders.write_video(made / "videos" / name, [folders.frame(c, t, 64, 48) for t in range(count)])
    return made


def test_videos_match_the_cameras(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"cam{c:02d}.MOV" for c in range(4)], [5] * 4)
    capture = open_capture(scene, scale=0.5)
    assert (capture.frames, capture.fps, capture.width, capture.height) == (5, 30.0, 32, 24)
    assert folders.which(capture.read(3, 1, ["cam02"])[0, 0]) == (2, 3)
    (scene / "splatreel.json").write_text('{"held_out": ["cam03"]}')
    assert open_capture(scene).held_out == ["cam03"]


def test_model_camera_without_video_is_named(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", ["cam00.mp4", "cam01.mp4", "b.mp4", "cam03.mp4"], [2] * 4)
    with pytest.raises(
        CaptureError, match=r"4 cameras, and 1 of them no video, the first is cam02; .* b, cam00, cam01, cam03"
    ):
        open_capture(scene)


def test_unrelated_video_does_not_hide_images(scene: Path) -> None:
    folders.write_video(scene / "preview.mp4", [folders.frame(0, 0)])
    assert open_capture(scene).frames == 1


def test_points_belong_to_the_calibrated_frame(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"cam{c:02d}.mp4" for c in range(4)], [5] * 4)
    assert open_capture(scene).points is not None
    assert open_capture(scene, frames=(2, 5)).points is None


def test_start_times_align_videos(tmp_path: Path) -> None:
    """Frames belong to the same time; the last ones exist in all videos."""
    pytest.importorskip("pycolmap")
    names = [f"cam{c:02d}.mp4" for c in range(4)]
    scene = filmed(tmp_path / "scene", names, [8, 9, 10, 11])
    with pytest.raises(CaptureError, match=r"cam00\.mp4 has 8, cam03\.mp4 has 11.*--frames 0:8.*capture sync"):
        open_capture(scene)
    starts = {"cam00": 0.0, "cam01": 2 / 30, "cam02": 0.11, "cam03": 0}
    (scene / "splatreel.json").write_text(json.dumps({"starts": starts}))
    capture = open_capture(scene)
    assert capture.frames == 7
    shown = capture.read(1, 6, ["cam00", "cam01", "cam02"])
    assert [[folders.which(image) for image in step] for step in shown] == [
        [(0, t), (1, t + 2), (2, t + 3)] for t in range(1, 7)
    ]
    shutil.copy(scene / "videos" / "cam00.mp4", scene / "videos" / "lost.mp4")  # what `calibrate` could not place
    (scene / "splatreel.json").write_text(json.dumps({"starts": starts | {"lost": 0.05}}))
    assert open_capture(scene).frames == 7
    for wrong, message in (
        ({"cam07": 0.1}, "when 'cam07' starts"),
        ({"cam02": 9}, "cam02 starts at 9 s, .* ends at 0.3 s"),
    ):
        (scene / "splatreel.json").write_text(json.dumps({"starts": wrong}))
        with pytest.raises(CaptureError, match=message):
            open_capture(scene)


def test_other_sizes_are_cropped_to_the_most_common(tmp_path: Path) -> None:
    """One portrait camera among landscape ones shows less, and nothing is distorted."""
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene")
    sparse = scene / "sparse" / "0"
    (sparse / "cameras.txt").write_text("1 PINHOLE 64 48 80 80 32 24\n2 PINHOLE 60 90 100 100 30 45\n")
    text = (sparse / "images.txt").read_text().replace(" 1 view/cam02", " 2 view/cam02")
    (sparse / "images.txt").write_text(text)
    y, x = np.mgrid[:90, :60]
    upright = np.stack([x * 4, y * 2, x * 0], 2).astype(np.uint8)
    Image.fromarray(upright).save(scene / "images_2" / "view" / "cam02.png")
    (scene / "images_2" / "view" / "cam02.jpg").unlink()
    capture = open_capture(scene, width=64)
    camera = capture.camera("view/cam02")
    assert (camera.width, camera.height) == (64, 48)
    assert camera.K[0, 0] == camera.K[1, 1] == pytest.approx(100 * 64 / 60, rel=0.01)
    image = capture.read(0, 1, ["view/cam01", "view/cam02"])[0]
    assert folders.which(image[0]) == (1, 0)
    scale = 100 / camera.K[0, 0]
    np.testing.assert_allclose(image[1, 24, 8:56, 0], 4 * ((np.arange(8, 56) - 31.5) * scale + 29.5), atol=3)
    np.testing.assert_allclose(image[1, 8:40, 32, 1], 2 * ((np.arange(8, 40) - 23.5) * scale + 44.5), atol=3)


@pytest.mark.parametrize(
    ("model", "params"),
    [("SIMPLE_PINHOLE", "80 32 24"), ("SIMPLE_RADIAL", "80 32 24 0"), ("OPENCV", "80 80 32 24 0 0 0 0")],
)
def test_undistorted_models_are_pinholes(tmp_path: Path, model: str, params: str) -> None:
    pytest.importorskip("pycolmap")
    capture = open_capture(folders.colmap(tmp_path / "scene", model, params))
    np.testing.assert_allclose(capture.cameras[1].K, folders.cameras()[1].K, atol=1e-5)


def test_a_missing_image_is_named(scene: Path) -> None:
    (scene / "images_2" / "view" / "cam02.jpg").unlink()
    with pytest.raises(CaptureError, match="images_2 lacks 1 of 4, the first is view/cam02"):
        open_capture(scene)


def test_unreadable_model_is_named(scene: Path) -> None:
    (scene / "sparse" / "0" / "images.txt").unlink()
    with pytest.raises(CaptureError, match="cannot be read as a COLMAP model"):
        open_capture(scene)


def test_missing_pycolmap_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[recon\]"):
        open_capture(folders.colmap(tmp_path / "scene"))


@pytest.mark.parametrize("named_by", ["camera", "picture"])
def test_colmap_folder_of_images_per_camera(scene: Path, named_by: str) -> None:
    """The model's images may be named like their cameras, or like the first image in each camera's folder."""
    shutil.rmtree(scene / "images_2")
    for c in range(4):
        folder = scene / "images" / f"cam{c:02d}"
        folder.mkdir(parents=True)
        for t in range(3):
            Image.fromarray(folders.frame(c, t)).save(folder / f"{t:06d}.png")
    model = scene / "sparse" / "0" / "images.txt"
    text = model.read_text().replace("view/", "")
    model.write_text(text if named_by == "camera" else text.replace(".png", "/000000.png"))
    capture = open_capture(scene)
    assert ([c.name for c in capture.cameras], capture.frames) == (["cam00", "cam01", "cam02", "cam03"], 3)
    assert [folders.which(image) for image in capture.read(1, 2, ["cam03"])[:, 0]] == [(3, 1), (3, 2)]


def test_model_without_images_is_refused(scene: Path) -> None:
    (scene / "sparse" / "0" / "images.txt").write_text("# no image was placed\n")
    with pytest.raises(CaptureError, match="the COLMAP model holds no images with a pose"):
        open_capture(scene)


def still_model(folder: Path, frames: int, name: str) -> Path:
    """Write a model with an image for each frame of each camera, whose poses differ by the noise of a calibration."""
    made = folders.colmap(folder)
    shutil.rmtree(made / "images_2")
    rng, lines = np.random.default_rng(0), []
    for line in (made / "sparse/0/images.txt").read_text().splitlines()[::2]:
        number, *values = line.split()
        camera = values[-1][-6:-4]
        for frame in range(frames):
            pose = np.array(values[:7], float) + 1e-3 * rng.normal(size=7)
            image = name.format(camera=camera, frame=frame)
            lines += [f"{frames * int(number) + frame} {' '.join(map(str, pose))} 1 {image}", ""]
            (made / "images" / image).parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(folders.frame(int(camera), frame, 64, 48)).save(made / "images" / image)
    (made / "sparse/0/images.txt").write_text("\n".join(lines) + "\n")
    return made


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("cam{camera}/frame_{frame}.png", "cam00"),
        ("cam{camera}_{frame:04d}.png", "cam00"),
        ("{frame:03d}/cam{camera}.png", "cam00"),
        ("{frame}_{camera}.png", "00"),
    ],
)
def test_model_over_all_frames_has_static_cameras(tmp_path: Path, name: str, first: str) -> None:
    pytest.importorskip("pycolmap")
    capture = open_capture(still_model(tmp_path / "scene", 11, name))
    assert (len(capture.cameras), capture.frames, capture.cameras[0].name) == (4, 11, first)
    assert capture.notes == ["the model has 44 images of 4 static cameras, one for each frame"]
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=0.01)
    shown = capture.read(0, 11, [camera.name for camera in capture.cameras])
    assert [[folders.which(image) for image in step] for step in shown] == [
        [(c, t) for c in range(4)] for t in range(11)
    ]


def test_model_with_the_most_images_is_read(scene: Path) -> None:
    small = scene / "sparse" / "1"
    shutil.copytree(scene / "sparse" / "0", small)
    rows = (small / "images.txt").read_text().splitlines()
    (scene / "sparse" / "0" / "images.txt").write_text("\n".join(rows[:6]) + "\n")
    capture = open_capture(scene)
    assert len(capture.cameras) == 4
    assert capture.notes == ["the COLMAP model sparse/1 is read, since it has the most images, 4; sparse/0 has 3"]


@pytest.mark.parametrize("binary", [False, True])
def test_model_without_points_is_read(scene: Path, binary: bool) -> None:
    import pycolmap

    model = scene / "sparse" / "0"
    if binary:
        reconstruction = pycolmap.Reconstruction(str(model))
        shutil.rmtree(model)
        model.mkdir()
        reconstruction.write_binary(str(model))
    next(model.glob("points3D.*")).unlink()
    capture = open_capture(scene)
    assert (len(capture.cameras), capture.points) == (4, None)


def test_folders_of_4dgaussians_belong_to_the_images_by_number(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene")
    (scene / "sparse" / "0").rename(scene / "sparse_")
    text = (scene / "sparse_" / "images.txt").read_text()
    for c in range(4):
        text = text.replace(f"view/cam{c:02d}.png", f"image{c + 8}.jpg")
        for t in range(3):
            file = scene / f"cam{c + 8:02d}" / f"frame_{t + 1:05d}.jpg"
            file.parent.mkdir(exist_ok=True)
            Image.fromarray(folders.frame(c, t)).save(file, quality=95)
    (scene / "sparse_" / "images.txt").write_text(text)
    shutil.rmtree(scene / "images_2")
    capture = open_capture(scene)
    assert [camera.name for camera in capture.cameras] == ["cam08", "cam09", "cam10", "cam11"]
    assert [folders.which(image) for image in capture.read(2, 1, ["cam08", "cam10"])[0]] == [(0, 2), (2, 2)]
    assert "such as image8 to cam08" in capture.notes[0]


def test_videos_with_the_numbers_of_the_model_belong_to_it(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"GoPro {c}.mp4" for c in range(4)], [2] * 4)
    capture = open_capture(scene)
    assert [camera.name for camera in capture.cameras] == [f"GoPro {c}" for c in range(4)]
    (scene / "videos" / "GoPro 3.mp4").rename(scene / "videos" / "GoPro 4.mp4")  # counted from 0 or from 1?
    with pytest.raises(CaptureError, match="holds the images of all 4 cameras"):
        open_capture(scene)


def test_hidden_and_extra_videos_are_not_read(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"cam{c:02d}.mp4" for c in range(4)], [2] * 4)
    (scene / "videos" / "._cam01.mp4").write_bytes(b"Mac OS X")
    shutil.copy(scene / "videos" / "cam00.mp4", scene / "videos" / "making_of.mp4")
    capture = open_capture(scene)
    assert capture.notes == ["not used, since the model has no such cameras: making_of.mp4"]


def test_camera_that_is_left_out_needs_no_video(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"cam{c:02d}.mp4" for c in range(4)], [2] * 4)
    with pytest.raises(CaptureError, match="no camera 'cam7' to leave out; the cameras are cam00"):
        open_capture(scene, leave_out=["cam7"])
    (scene / "videos" / "cam01.mp4").write_bytes(b"damaged")
    capture = open_capture(scene, leave_out=["cam01"])
    assert [camera.name for camera in capture.cameras] == ["cam00", "cam02", "cam03"]
    assert capture.held_out == ["cam02"]
    later = open_capture(scene, leave_out=["cam01"], frames=(1, 2))
    assert later.reel_source() == ReelSource(1, ("cam02",), ("cam01",))


def test_chapters_of_a_camera_are_one_video(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = filmed(tmp_path / "scene", [f"cam{c:02d}.mp4" for c in range(4)], [8] * 4)
    for c, names in enumerate((("GX010042", "GX020042"), ("GOPR0007", "GP010007"), ("GH010001", "GH020001"))):
        (scene / "videos" / f"cam{c:02d}.mp4").unlink()
        (scene / "videos" / f"cam{c:02d}").mkdir()
        for part, name in enumerate(names):
            images = [folders.frame(c, 4 * part + t, 64, 48) for t in range(4)]
            folders.write_video(scene / "videos" / f"cam{c:02d}" / f"{name}.MP4", images)
    capture = open_capture(scene)
    assert capture.frames == 8
    shown = capture.read(0, 8, ["cam00", "cam01", "cam02"])
    assert [[folders.which(image) for image in step] for step in shown] == [
        [(c, t) for c in range(3)] for t in range(8)
    ]
    capture.close()
    shutil.copy(scene / "videos" / "cam03.mp4", scene / "videos" / "cam00" / "GX010043.MP4")
    with pytest.raises(CaptureError, match=r"cam00: holds chapters of 2 GoPro recordings \(0042, 0043\)"):
        open_capture(scene)


def test_a_folder_of_copies_is_no_camera(tmp_path: Path) -> None:
    """Chapters, however, may lie beside the videos of other cameras."""
    for name in ("cam0", "cam1", "cam2", "proxy/cam0", "proxy/cam1", "proxy/cam2", "cam3/GX010007", "cam3/GX020007"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        folders.write_video(tmp_path / f"{name}.mp4", [folders.frame(0, 0)])
    assert list(camera_files(tmp_path, ())) == ["cam0", "cam1", "cam2", "cam3"]


def desk_game(folder: Path, model: tuple[int, int] = (126, 71), video: tuple[int, int] = (128, 72)) -> Path:
    """Write a capture as the paper's: videos slightly larger than its pinhole model, whose images have only numbers."""
    pytest.importorskip("pycolmap")
    folders.colmap(folder, "PINHOLE", f"80 80 {model[0] / 2} {model[1] / 2}")
    shutil.rmtree(folder / "images_2")
    sparse = folder / "sparse" / "0"
    text = (sparse / "cameras.txt").read_text().replace("64 48", f"{model[0]} {model[1]}")
    (sparse / "cameras.txt").write_text(text)
    pose = " ".join((sparse / "images.txt").read_text().splitlines()[0].split()[1:8])
    w, x, y, z, *place = pose.split()
    rows = [
        f"{n + 1} {w} {x} {y} {z} {float(place[0]) + 0.2 * n} {place[1]} {place[2]} 1 {n}.png\n\n" for n in range(11)
    ]
    (sparse / "images.txt").write_text("".join(rows))
    (folder / "colmap").mkdir()
    (folder / "sparse").rename(folder / "colmap" / "sparse")
    (folder / "videos").mkdir()
    for n in range(11):
        images = [np.full((video[1], video[0], 3), (20 + 15 * t, 20 * n, 128), np.uint8) for t in range(3)]
        folders.write_video(folder / "videos" / f"cam{n:02d}.mp4", images)
    return folder


def test_the_papers_own_captures(tmp_path: Path) -> None:
    capture = open_capture(desk_game(tmp_path / "cube"))
    assert [camera.name for camera in capture.cameras] == [f"cam{n:02d}" for n in range(11)]
    assert capture.held_out == ["cam07"]
    assert (capture.frames, capture.width, capture.height) == (3, 126, 71)
    red, green, _ = capture.read(1, 1, ["cam10"])[0, 0].reshape(-1, 3).mean(0)
    assert (round(red / 15, 0), round(green / 20)) == (2, 10)
    scaled = [note for note in capture.notes if "128x72" in note and "126x71" in note]
    assert len(scaled) == 1
    assert "cam00 to cam10 (11 cameras)" in scaled[0]
    assert "undistort" in scaled[0]


def test_other_defaults_beside_the_papers(tmp_path: Path) -> None:
    scene = desk_game(tmp_path / "cube", (64, 48), (64, 48))
    assert open_capture(scene, leave_out=["cam07"]).held_out != ["cam07"]
    assert not [note for note in open_capture(scene).notes if "64x48" in note]
    (scene / "colmap" / "sparse").rename(scene / "sparse")
    assert open_capture(scene).held_out != ["cam07"]


@pytest.mark.parametrize(
    ("video", "named"), [((128, 96), False), ((32, 24), False), ((65, 49), False), ((68, 51), True)]
)
def test_sizes_that_differ_by_a_few_percent_are_named(tmp_path: Path, video: tuple[int, int], named: bool) -> None:
    notes = open_capture(desk_game(tmp_path / "cube", (64, 48), video)).notes
    assert any(f"{video[0]}x{video[1]}" in note for note in notes) == named
