import hashlib
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
import pytest

from splatreel.base.errors import CaptureError, UsageError
from splatreel.capture.capture_sound import RATE, read_sound
from splatreel.capture.opening import open_capture
from splatreel.scene.camera import Camera
from toyroom import capture as filming
from toyroom import room as toys
from toyroom.capture import make_cameras, make_capture
from toyroom.raytracer import trace_cover, trace_frame, trace_static
from toyroom.sound import render_sound

SIZE: dict[str, Any] = {"width": 64, "height": 48, "frames": 3}


def render_truth(
    camera: Camera,
    frame: int,
    what: Literal["color", "motion", "depth"] = "motion",
    *,
    fps: float = 30.0,
    seed: int = 0,
) -> np.ndarray:
    """Return the ground truth of a frame from any camera.

    `color` is uint8 [H, W, 3] sRGB before compression. `motion` is bool [H, W]: pixels at least half covered by solids
    in motion at that frame, without shadows and reflections. `depth` is float32 [H, W], the mean distance along the
    viewing axis.
    """
    still, moving = toys.standing(seed), toys.moving(frame / fps)
    seen = trace_static(camera, still, toys.LIGHT)
    if what == "color":
        return trace_frame(camera, seen, still, moving, toys.LIGHT)
    if what == "depth":
        return trace_cover(camera, seen, moving, toys.in_motion(frame / fps))[1]
    return trace_cover(camera, seen, moving, toys.in_motion(frame / fps))[0] >= 0.5


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("film") / "room", **SIZE)


def test_make_capture_accepts_a_string_path(made: Path) -> None:
    capture = open_capture(made)
    assert (len(capture.cameras), capture.frames, capture.fps) == (14, 3, 30.0)
    assert capture.held_out == ["cam00", "cam07"]
    assert (capture.width, capture.height) == (64, 48)
    assert capture.near is not None


def test_poses_round_trip_through_llff(made: Path) -> None:
    for found, meant in zip(open_capture(made).cameras, make_cameras(64, 48), strict=True):
        np.testing.assert_allclose(found.viewmat, meant.viewmat, atol=1e-5)
        np.testing.assert_allclose(found.K, meant.K, atol=1e-4)


def test_video_compression_is_nearly_lossless(made: Path) -> None:
    capture = open_capture(made)
    for name in ("cam00", "cam13"):
        read = capture.read(2, 1, [name])[0, 0].astype(float)
        error = read - render_truth(capture.camera(name), 2, "color")
        assert 10 * np.log10(255**2 / np.mean(error**2)) > 38  # 45 at the default size


def test_capture_bytes_are_reproducible(made: Path, tmp_path: Path) -> None:
    again = make_capture(tmp_path / "again", **SIZE)

    def digests(folder: Path) -> dict[str, str]:
        return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in folder.iterdir()}

    assert digests(again) == digests(made)
    film = (made / "cam03.mp4").read_bytes()
    assert b" mbtree=0 " in film, "with x264's macroblock tree, bytes differ now and then under load"
    assert b" threads=1 " in film


def test_the_shipped_film_is_the_one_that_is_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of one camera are traced and encoded again: the same images, whichever processor rounds the last bits."""
    filmed: list[float] = []
    folder = make_capture(tmp_path / "room", progress=filmed.append)
    assert filmed == [], "the package contains this film"
    assert make_capture(folder) == folder
    again, few = tmp_path / "again", {"width": 256, "height": 192, "frames": 3, "fps": 30, "seed": 0}
    again.mkdir()
    (camera,) = (camera for camera in make_cameras() if camera.name == "cam05")
    for _ in filming._film(again, camera, few):
        pass
    shown, shipped = (open_video(film / "cam05.mp4") for film in (again, folder))
    error = shown.astype(float) - shipped[:3]
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 42, "both are within 45 dB of the traced images"
    late = shipped[59] - render_truth(camera, 59, "color").astype(float)
    assert 10 * np.log10(255**2 / np.mean(late**2)) > 42
    capture = open_capture(folder)
    for found, meant in zip(capture.cameras, make_cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, meant.viewmat, atol=1e-5)
    sound = np.concatenate(list(read_sound(folder / "cam05.mp4", 1, RATE)))[:, 0]
    assert np.abs(sound - render_sound(camera.center, 2.0, 5)).max() < 1e-4


def open_video(path: Path) -> np.ndarray:
    """Return all frames of a video, uint8 [T, H, W, 3]."""
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_existing_capture_is_kept(made: Path) -> None:
    before = (made / "cam03.mp4").stat().st_mtime_ns
    assert make_capture(made, **SIZE) == made
    assert (made / "cam03.mp4").stat().st_mtime_ns == before


def test_foreign_folder_is_not_overwritten(made: Path, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="exists and is not the film of"):
        make_capture(made, width=96, height=72, frames=3)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(CaptureError, match="Remove it or choose another"):
        make_capture(tmp_path, **SIZE)
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_interrupt_leaves_no_partial_capture(tmp_path: Path, error: BaseException) -> None:
    def progress(share: float) -> None:
        if share > 0.3:
            raise error

    with pytest.raises((KeyboardInterrupt, OSError)):
        make_capture(tmp_path / "room", **SIZE, progress=progress)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "size", [{"width": 63}, {"height": 47}, {"width": 8}, {"frames": 0}, {"fps": 0}], ids=lambda s: next(iter(s))
)
def test_invalid_sizes_are_refused(tmp_path: Path, size: dict[str, int]) -> None:
    with pytest.raises(UsageError):
        make_capture(tmp_path / "room", **{**SIZE, **size})


def test_motion_mask_covers_changed_pixels() -> None:
    camera = make_cameras(96, 72)[0]
    mask = render_truth(camera, 30, "motion")
    assert mask.dtype == bool
    assert 0.02 < mask.mean() < 0.2
    before, after = (render_truth(camera, t, "color").astype(int) for t in (30, 31))
    changed = np.abs(before - after).max(-1) > 40
    assert changed[mask].mean() > 3 * changed[~mask].mean()


def test_depth_agrees_with_bounds_and_parallax() -> None:
    camera, other = make_cameras(96, 72)[3], make_cameras(96, 72)[5]
    depth, seen = (render_truth(c, 0, "depth") for c in (camera, other))
    assert depth.min() >= 2.0
    assert depth.max() <= 9.0
    v, u = np.mgrid[:72, :96] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T
    world = (rays * depth[..., None] - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    there = world @ other.viewmat[:3, :3].T + other.viewmat[:3, 3]
    pixel = (there @ other.K.T)[..., :2] / there[..., 2:]
    column, row = np.floor(pixel).astype(int).reshape(-1, 2).T
    inside = (column >= 0) & (column < 96) & (row >= 0) & (row < 72)
    gap = np.abs(seen[row[inside], column[inside]] - there[..., 2].reshape(-1)[inside])
    assert np.median(gap) < 0.02
