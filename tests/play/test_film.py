"""Paths through the cameras, and the film itself."""

import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import UsageError
from splatreel.capture.capture_sound import RATE, read_sound
from splatreel.kernels.image import render_image
from splatreel.play.film import (
    CameraPath,
    Keyframe,
    film_along_path,
    film_through_cameras,
    read_path,
    sound_start,
    write_film,
)
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests import flashes
from tests.golden import GOLDEN


def camera(x: float) -> Camera:
    viewmat = np.eye(4)
    viewmat[0, 3] = -x
    return Camera(f"at {x}", viewmat, np.array([[100, 0, 32], [0, 100, 24], [0, 0, 1]]), 64, 48)


def test_film_passes_nearest_camera_first_without_jump():
    shots = film_through_cameras(camera(0), [camera(3), camera(0), camera(1), camera(2)], 31, 30, 5)
    assert [round(30 * seconds) for seconds, _ in shots] == list(range(5, 36))
    places = np.array([c.center[0] for _, c in shots])
    assert np.allclose(places[[0, 10, 20, 30]], [0, 1, 2, 3], atol=1e-4)
    assert np.abs(np.diff(places)).max() < 0.15


def test_film_keeps_lens_and_rotates_smoothly():
    turned = camera(1).viewmat.copy()
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    path = [c for _, c in film_through_cameras(camera(0), [replace(camera(1), viewmat=turned)], 5, 30)]
    assert all(np.allclose(c.K, camera(0).K) for c in path)
    angles = [np.degrees(np.arccos(c.viewmat[2, 2])) for c in path]
    assert np.allclose(angles, [0, 22.5, 45, 67.5, 90], atol=1)


def test_film_without_other_cameras_does_not_move():
    for cameras in ([], [camera(0)]):
        assert [c.center[0] for _, c in film_through_cameras(camera(0), cameras, 3, 30)] == [0, 0, 0]
    assert len(film_through_cameras(camera(0), [camera(1)], 1, 30)) == 1


def test_film_along_path_has_its_duration_times_and_lens():
    keyframes = [Keyframe(t, time, camera(x).viewmat) for t, time, x in [(0.0, 1.0, 0), (1.0, 2.0, 1), (2.0, 2.0, 1)]]
    shots = film_along_path(CameraPath(keyframes), camera(9), 10)
    assert len(shots) == 21
    assert [round(seconds, 6) for seconds, _ in shots[8:13]] == [1.8, 1.9, 2.0, 2.0, 2.0]
    assert all(np.allclose(c.K, camera(9).K) for _, c in shots)
    assert shots[15][1].center[0] == 1
    assert len(film_along_path(CameraPath(keyframes, loop=True), camera(9), 10)) == 20
    assert len(film_along_path(CameraPath(keyframes[:1]), camera(9), 10)) == 1


def test_sound_start_requires_reel_speed():
    keyframes = [Keyframe(float(t), 3.0 + t, camera(t).viewmat) for t in range(3)]
    assert sound_start(film_along_path(CameraPath(keyframes), camera(0), 30), 30) == 3
    assert sound_start(film_through_cameras(camera(0), [camera(1)], 9, 30, 6), 30) == 0.2
    slow = [Keyframe(2 * k.at, k.time, k.viewmat) for k in keyframes]
    assert sound_start(film_along_path(CameraPath(slow), camera(0), 30), 30) is None


def test_film_shows_reel(tmp_path: Path):
    reel = open_reel(GOLDEN)
    start = reel.manifest.camera.resized(81, 60)
    done = []
    write_film(tmp_path / "film.mp4", reel, [(i / reel.fps, start) for i in (4, 5, 6)], report=done.append)
    assert done == [1, 2, 3]
    with av.open(str(tmp_path / "film.mp4")) as film:
        images = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == reel.fps
    assert len(images) == 3
    assert images[0].shape == (60, 80, 3)
    want = np.clip(render_image(reel.at(6 / reel.fps), start), 0, 1)[:, :80]
    assert -10 * np.log10(np.mean((images[2] / 255 - want) ** 2)) > 25


def test_film_sound_is_synchronized(tmp_path: Path):
    reel = open_reel(flashes.GOLDEN)
    start, first, count = reel.manifest.camera.resized(32, 24), 50, 90
    write_film(tmp_path / "film.mp4", reel, [((first + i) / reel.fps, start) for i in range(count)])
    expected = [click - first / reel.fps for click in flashes.CLICKS[1:3]]
    sound = np.concatenate(list(read_sound(tmp_path / "film.mp4", 1, RATE)))
    np.testing.assert_allclose(flashes.onsets(sound), expected, atol=2e-3)
    assert abs(len(sound) / RATE - count / reel.fps) < 0.03
    with av.open(str(tmp_path / "film.mp4")) as film:
        light = np.array([frame.to_ndarray(format="gray").mean() for frame in film.decode(video=0)])
    rises = np.flatnonzero((light[1:] > 80) & (light[:-1] < 80)) + 1
    np.testing.assert_allclose((rises - 0.5) / reel.fps, expected, atol=1e-6)


def test_film_at_other_speed_is_silent(tmp_path: Path):
    reel = open_reel(flashes.GOLDEN)
    start = reel.manifest.camera.resized(32, 24)
    write_film(tmp_path / "film.mp4", reel, [(2 * i / reel.fps, start) for i in range(6)])
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert not film.streams.audio


def test_interrupted_film_keeps_old_file(tmp_path: Path) -> None:
    def stop(done: int) -> None:
        raise KeyboardInterrupt

    (tmp_path / "film.mp4").write_bytes(b"an older film")
    reel = open_reel(GOLDEN)
    with pytest.raises(KeyboardInterrupt):
        write_film(tmp_path / "film.mp4", reel, [(0.0, reel.manifest.camera)], stop)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("film.mp4", b"an older film")]


def test_film_encoding_is_deterministic(tmp_path: Path) -> None:
    """One thread, and no macroblock tree: with it 22 of 7,190 encodings of the same images under load differed."""
    reel = open_reel(GOLDEN)
    for name in ("a.mp4", "b.mp4"):
        write_film(tmp_path / name, reel, [(0.0, reel.manifest.camera)] * 2)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data == (tmp_path / "b.mp4").read_bytes()
    assert b" mbtree=0 " in data
    assert b" threads=1 " in data


PATHS = Path(__file__).parents[1] / "data" / "golden-paths.json"
"""Paths and where they are at some seconds, which the player's tests compare as well."""


def at(x: float, y: float = 0.0) -> np.ndarray:
    viewmat = np.eye(4)
    viewmat[:2, 3] = -x, -y
    return viewmat


def document(**changes: object) -> dict:
    keyframes = [{"at": i, "time": 2 * i, "viewmat": at(i).ravel().tolist()} for i in range(3)]
    return {"format": "splatreel-path", "version": 1, "loop": False, "keyframes": keyframes} | changes


def write(path: Path, value: object) -> Path:
    path.write_text(json.dumps(value))
    return path


def centre(viewmat: np.ndarray) -> np.ndarray:
    return -viewmat[:3, :3].T @ viewmat[:3, 3]


def golden_paths() -> list[tuple[dict, list[float]]]:
    """Paths with uneven steps, turns about all axes, a rest, a closed loop, a single keyframe; seconds to compare at."""
    random = np.random.default_rng(7)
    times = [0, 0.4, 2, 2.2, 5, 6]
    poses: list[np.ndarray] = []
    for i in range(len(times)):
        start = Rotation.random(random_state=0)  # pyright: ignore[reportCallIssue]
        turn = start * Rotation.from_rotvec(random.normal(0, 0.6, 3))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn.as_matrix(), random.normal(0, 2, 3)
        poses.append(poses[-1] if i == 3 else pose)
    keys = [{"at": t, "time": abs(3 - t), "viewmat": p.ravel().tolist()} for t, p in zip(times, poses, strict=True)]
    ring = [*keys[:4], keys[4] | {"viewmat": keys[0]["viewmat"]}]
    seconds = [0, 0.2, 0.4, 0.9, 1.999, 2, 2.1, 2.3, 3.3, 5, 5.5, 6, 7.25]
    return [
        (document(keyframes=keys), seconds),
        (document(keyframes=keys, loop=True), seconds),
        (document(keyframes=ring, loop=True), seconds),
        (document(keyframes=keys[:2]), seconds[:5]),
        (document(keyframes=keys[:1]), [0, 1]),
    ]


def golden_document(folder: Path) -> list[dict]:
    result = []
    for index, (path, seconds) in enumerate(golden_paths()):
        read = read_path(write(folder / f"{index}.json", path))
        moments = [(s, *read.at(s)) for s in seconds]
        shown = [{"seconds": s, "time": time, "viewmat": viewmat.ravel().tolist()} for s, viewmat, time in moments]
        result.append({"path": path, "moments": shown})
    return result


def test_camera_path_matches_golden_numbers(tmp_path: Path):
    """`python -m tests.play.test_camera_path` writes them anew."""
    for entry, want in zip(golden_document(tmp_path), json.loads(PATHS.read_text()), strict=True):
        assert entry["path"] == want["path"]
        for moment, expected in zip(entry["moments"], want["moments"], strict=True):
            assert moment["time"] == pytest.approx(expected["time"], abs=1e-9)
            assert np.allclose(moment["viewmat"], expected["viewmat"], atol=1e-9)


def test_camera_path_passes_keyframes_and_stays_between_equal_ones():
    keys = [Keyframe(t, 0.0, at(x)) for t, x in [(0, 0), (1, 1), (3, 2), (4, 2), (5, 4)]]
    path = CameraPath(keys)
    assert path.seconds == 5
    for key in keys:
        assert np.allclose(path.at(key.at)[0], key.viewmat)
    assert [centre(path.at(s)[0])[0] for s in (3.2, 3.5, 3.9)] == pytest.approx([2, 2, 2])
    speeds = np.diff([centre(path.at(s)[0])[0] for s in (0.999, 1, 1.001)])
    assert speeds[0] == pytest.approx(speeds[1], rel=0.01)


def test_camera_path_loop_is_smooth_at_its_ends():
    ring = [Keyframe(float(i), 0.0, at(*place)) for i, place in enumerate([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])]
    path = CameraPath(ring, loop=True)
    ahead = centre(path.at(1e-4)[0]) - centre(path.at(0)[0])
    behind = centre(path.at(0)[0]) - centre(path.at(4 - 1e-4)[0])
    assert np.allclose(ahead, behind, atol=1e-7)
    assert np.allclose(path.at(4.5)[0], path.at(0.5)[0])


def bad_keyframe(**changes: object) -> dict:
    keyframes = document()["keyframes"]
    keyframes[1] |= changes
    return document(keyframes=keyframes)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], "its format is absent"),
        (document(format="splatreel"), 'its format is "splatreel"'),
        (document(version=2), "its version is 2"),
        (document(keyframes=[]), "not a list of 1 to"),
        (document(keyframes=[7]), "at of keyframe 0 is absent"),
        (bad_keyframe(at=0), "at of keyframe 1 is 0. Give seconds from 0 on that grow"),
        (bad_keyframe(at=float("nan")), "at of keyframe 1 is NaN"),
        (bad_keyframe(time=-1), "time of keyframe 1 is -1"),
        (bad_keyframe(viewmat=[1]), "viewmat of keyframe 1"),
        (bad_keyframe(viewmat=(2 * np.eye(4)).ravel().tolist()), "viewmat of keyframe 1"),
        (bad_keyframe(viewmat=np.diag([-1.0, 1, 1, 1]).ravel().tolist()), "viewmat of keyframe 1"),
        (bad_keyframe(viewmat=["a"] * 16), "viewmat of keyframe 1"),
    ],
)
def test_invalid_camera_path_names_field_and_remedy(tmp_path: Path, value: object, message: str):
    file = write(tmp_path / "path.json", value)
    with pytest.raises(UsageError, match=r"path\.json is not a camera path") as caught:
        read_path(file)
    assert message in str(caught.value)


def test_unreadable_camera_path_raises_usage_error(tmp_path: Path):
    with pytest.raises(UsageError, match=r"none\.json: cannot be read"):
        read_path(tmp_path / "none.json")
    (tmp_path / "bytes").write_bytes(b"\xff\x00")
    (tmp_path / "deep").write_text("[" * 100_000)
    for name in ("bytes", "deep"):
        with pytest.raises(UsageError, match="a camera path"):
            read_path(tmp_path / name)


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        PATHS.write_text(json.dumps(golden_document(Path(folder)), indent=1) + "\n")


def test_oversized_camera_path_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "path.json"
    with file.open("wb") as opened:
        opened.truncate(1 << 40)  # a hole: it takes no place on the disk
    with pytest.raises(UsageError, match=r"path\.json: has .* bytes, more than"):
        read_path(file)
