"""Frames of videos are paired by their timestamps."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.stream import Disposition

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders
from tests.capture.films import HEARD, film

FRAMES = 10


def write(path: Path, camera: int, times: Sequence[float], base: int = 30000) -> None:
    """Write a video whose frames show their times in thirtieths of a second, at exactly these times."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx" if path.suffix == ".webm" else "libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = folders.WIDTH, folders.HEIGHT, "yuv444p"
        if path.suffix == ".webm":
            stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, base)
        stream.time_base = Fraction(1, base)
        for time in times:
            image = av.VideoFrame.from_ndarray(folders.frame(camera, round(time * 30)), format="rgb24")
            image.pts, image.time_base = round(time * base), Fraction(1, base)
            container.mux(stream.encode(image))
        container.mux(stream.encode(None))


def thirtieths(*numbers: float) -> list[float]:
    return [number / 30 for number in numbers]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a Neu3DV folder whose cameras film at 30 frames a second."""
    folder = tmp_path / "scene"
    folder.mkdir()
    np.save(folder / "poses_bounds.npy", folders.llff(folders.cameras(4)))
    for camera in range(4):
        write(folder / f"cam{camera:02d}.mp4", camera, thirtieths(*range(FRAMES)))
    return folder


def shown(scene: Path, camera: str) -> list[int]:
    with closing(open_capture(scene)) as capture:
        return [folders.which(image)[1] for image in capture.read(0, capture.frames, [camera])[:, 0]]


@pytest.mark.parametrize(("suffix", "base"), [(".mp4", 30000), (".mov", 600), (".mkv", 1000)])
@pytest.mark.parametrize("lost", [{4}, {3, 4, 7}])
def test_dropped_frame_shifts_no_other(scene: Path, suffix: str, base: int, lost: set[int]) -> None:
    (scene / "cam02.mp4").unlink()
    kept = [frame for frame in range(FRAMES) if frame not in lost]
    write(scene / f"cam02{suffix}", 2, thirtieths(*kept), base)
    with closing(open_capture(scene)) as capture:
        assert (capture.frames, capture.fps) == (FRAMES, 30)
        missing = capture.missing(0, FRAMES, [camera.name for camera in capture.cameras])
        assert np.argwhere(missing).tolist() == [[frame, 2] for frame in sorted(lost)]
        assert capture.notes[0].startswith(f"cam02 has no frames {min(lost)}")
    found = shown(scene, "cam02")
    assert [found[frame] for frame in kept] == kept
    assert shown(scene, "cam01") == list(range(FRAMES))


def test_frames_that_are_late_by_little_are_not_missing(scene: Path) -> None:
    late = np.arange(FRAMES) + np.array([0, 0.1, 0.3, 0.4, 0.2, 0, 0.3, 0.1, 0.4, 0])
    write(scene / "cam02.mp4", 2, thirtieths(*late))
    with closing(open_capture(scene)) as capture:
        assert not capture.missing(0, FRAMES, ["cam02"]).any()
        assert capture.notes == []


def test_faster_camera_is_read_at_the_rate_of_the_others(scene: Path) -> None:
    write(scene / "cam03.mp4", 3, thirtieths(*np.arange(0, FRAMES - 0.5, 0.5)))
    with closing(open_capture(scene)) as capture:
        assert (capture.frames, capture.fps) == (FRAMES, 30)
        assert capture.notes == [
            "30 frames a second are used; others have cam03 60, of which the frames nearest in time are read"
        ]
    assert shown(scene, "cam03") == list(range(FRAMES))


def test_slower_camera_misses_frames_of_the_others(scene: Path) -> None:
    write(scene / "cam03.mp4", 3, thirtieths(*range(0, FRAMES, 2)))
    with closing(open_capture(scene)) as capture:
        assert (capture.frames, capture.fps) == (FRAMES, 30)
        assert capture.missing(0, FRAMES, ["cam03"])[:, 0].tolist() == [frame % 2 == 1 for frame in range(FRAMES)]


def test_dropped_first_frame_is_seen_in_the_timestamps(scene: Path) -> None:
    write(scene / "cam01.mp4", 1, thirtieths(*range(1, FRAMES)))
    assert shown(scene, "cam01") == [1, *range(1, FRAMES)]
    with closing(open_capture(scene)) as capture:
        assert capture.missing(0, FRAMES, ["cam01"])[:, 0].tolist() == [True] + [False] * (FRAMES - 1)


def test_clocks_that_differ_by_seconds_are_not_compared(scene: Path) -> None:
    write(scene / "cam01.mp4", 1, [5 + time for time in thirtieths(*range(FRAMES))])
    with closing(open_capture(scene)) as capture:
        assert capture.frames == FRAMES
        assert "the first timestamps differ by up to 5 s (cam01)" in capture.notes[0]


def test_one_frame_more_or_less_at_the_end_is_no_reason_to_refuse(scene: Path) -> None:
    write(scene / "cam02.mp4", 2, thirtieths(*range(FRAMES - 1)))
    with closing(open_capture(scene)) as capture:
        assert capture.frames == FRAMES
        assert capture.missing(FRAMES - 2, 2, ["cam02"])[:, 0].tolist() == [False, True]


def test_two_videos_of_a_camera_are_refused(scene: Path) -> None:
    write(scene / "cam03.webm", 3, thirtieths(*range(FRAMES)))
    with pytest.raises(CaptureError, match=r"cam03\.mp4 and cam03\.webm are both videos of cam03\. Remove"):
        open_capture(scene)


def test_default_stream_is_read_rather_than_a_preview_before_it(scene: Path) -> None:
    with av.open(str(scene / "cam02.mp4"), "w") as container:
        small = container.add_stream("libx264", rate=30)
        large = container.add_stream("libx264", rate=30)
        for stream, (width, height) in ((small, (16, 12)), (large, (folders.WIDTH, folders.HEIGHT))):
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv444p"
        small.disposition, large.disposition = Disposition(0), Disposition.default
        for frame in range(FRAMES):
            preview = av.VideoFrame.from_ndarray(folders.frame(0, 0, 16, 12), format="rgb24")
            container.mux(small.encode(preview))
            container.mux(large.encode(av.VideoFrame.from_ndarray(folders.frame(2, frame), format="rgb24")))
        container.mux(small.encode(None))
        container.mux(large.encode(None))
    assert shown(scene, "cam02") == list(range(FRAMES))


def truncated(folder: Path, name: str, frames: int) -> Path:
    """Cut a video, whose tables are at its start, within a frame. Colors tell its camera and frames."""
    scene = folders.neu3dv(folder, count=4, frames=frames)
    c = int(name[-2:])
    rng = np.random.default_rng(0)
    images = [folders.frame(c, t) for t in range(frames)]
    for t in range(frames):
        images[t][::2, ::2, 2] = rng.integers(0, 255, (12, 16))  # all frames have many bytes
    folders.write_video(scene / f"{name}.mp4", images, {"movflags": "faststart"})
    file = scene / f"{name}.mp4"
    content = file.read_bytes()
    file.write_bytes(content[: int(0.7 * len(content))])
    return scene


def test_a_truncated_video_is_used_to_its_last_whole_frame(tmp_path: Path) -> None:
    scene = truncated(tmp_path / "scene", "cam02", 12)
    with pytest.raises(
        CaptureError, match=r"cam02\.mp4: is truncated: .* \(--frames 0:\d+\), or leave the camera out"
    ) as said:
        open_capture(scene)
    whole = int(str(said.value).partition("--frames 0:")[2].partition(")")[0])
    assert 2 < whole < 12
    capture = open_capture(scene, frames=(0, whole))
    assert any("cam02.mp4: is truncated" in note and note.endswith("which are used") for note in capture.notes)
    missing = capture.missing(0, whole, ["cam02"])[:, 0]
    read = capture.read(0, whole, ["cam02"])[:, 0]
    shown = [round((frame[1::2, 1::2, 0].mean() - 20) / 15) for frame in read]
    assert [t for t in range(whole) if not missing[t] and abs(shown[t] - t) > 0.5] == []
    assert not missing[: whole - 3].any()
    with pytest.raises(
        CaptureError, match=r"cam02\.mp4: is truncated.*choose frames before its end \(--frames 0:\d+\)"
    ):
        open_capture(scene, frames=(0, 12))


def test_unequal_ends_name_the_frames_that_a_video_has(scene: Path) -> None:
    write(scene / "cam02.mp4", 2, thirtieths(*range(4), *range(7, 14)))
    with pytest.raises(CaptureError, match=r"cam00\.mp4 has 10, cam02\.mp4 has 11 frames, which span 14 time steps\."):
        open_capture(scene)


def test_slow_motion_that_a_phone_states_is_named(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "scene")
    with av.open(str(scene / "cam02.mp4")) as source:
        frames = [frame.to_ndarray(format="rgb24") for frame in source.decode(video=0)]
    with av.open(str(scene / "cam02.mp4"), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata["com.android.capture.fps"] = "240.000000"
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    notes = [note for note in open_capture(scene).notes if "filmed at" in note]
    assert len(notes) == 1
    assert "cam02: filmed at 240 frames a second and stored at 30, so that everything takes 8 times as long" in notes[0]
    assert "-itsscale 0.125" in notes[0]


@pytest.mark.parametrize(("heard", "named"), [(1.0, True), (2.5, False), (4.0, False)])
def test_sound_several_times_shorter_than_the_images_hints_at_slow_motion(
    tmp_path: Path, heard: float, named: bool
) -> None:
    for camera in range(4):
        film(
            tmp_path / f"cam{camera:02d}.mp4",
            np.full(round(heard * HEARD) // 1024 * 1024, 0.1) if camera == 1 else None,
        )
    square = [replace(camera, height=camera.width) for camera in folders.cameras(4)]
    np.save(tmp_path / "poses_bounds.npy", folders.llff(square))
    notes = [note for note in open_capture(tmp_path).notes if "slow motion" in note]
    assert bool(notes) == named
    if named:
        assert "cam01 (4.0 s of images, 1.0 s of sound)" in notes[0]
