"""Camera paths: the curve, files that are none, and that the player's arithmetic gives the same."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import UsageError
from splatreel.play.camera_path import CameraPath, Keyframe, read_path

GOLDEN = Path(__file__).parents[1] / "data" / "golden-paths.json"
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
    for entry, want in zip(golden_document(tmp_path), json.loads(GOLDEN.read_text()), strict=True):
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
        GOLDEN.write_text(json.dumps(golden_document(Path(folder)), indent=1) + "\n")


def test_oversized_camera_path_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "path.json"
    with file.open("wb") as opened:
        opened.truncate(1 << 40)  # a hole: it takes no place on the disk
    with pytest.raises(UsageError, match=r"path\.json: has .* bytes, more than"):
        read_path(file)
