import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import CaptureError
from splatreel.capture.video import VIDEO_SUFFIXES, VideoFile
from tests.capture import folders
from tests.capture.colors import write_display_matrix

FRAMES = folders.FRAMES


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "cam01.mp4"
    folders.write_video(path, [folders.frame(1, t) for t in range(FRAMES)])
    return path


def read(
    video: VideoFile, first: int, count: int, width: int = folders.WIDTH, height: int = folders.HEIGHT
) -> np.ndarray:
    out = np.empty((count, height, width, 3), np.uint8)
    video.read_into(out, np.arange(first, first + count))
    return out


def test_scan_finds_frames_and_size(video: Path) -> None:
    file = VideoFile(video)
    assert (file.frames, file.width, file.height, file.fps) == (FRAMES, 32, 24, 30.0)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(st.integers(0, FRAMES - 1), st.integers(1, FRAMES)), min_size=1, max_size=6))
def test_random_reads_return_the_right_frames(video: Path, reads: list[tuple[int, int]]) -> None:
    file = VideoFile(video)
    for first, count in reads:
        count = min(count, FRAMES - first)
        images = read(file, first, count)
        assert [folders.which(image) for image in images] == [(1, first + t) for t in range(count)]
    file.close()


def test_sequential_reads_reach_the_last_frame(video: Path) -> None:
    file = VideoFile(video)
    assert [folders.which(read(file, t, 1)[0])[1] for t in range(FRAMES)] == list(range(FRAMES))


def test_frame_is_resized_by_area(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    coarse = rng.integers(60, 190, (12, 16, 3))
    detail = np.tile([[[20], [-20]], [[-20], [20]]], (12, 16, 1))  # a mean of nothing in every square of four
    image = (coarse.repeat(2, 0).repeat(2, 1) + detail).astype(np.uint8)
    folders.write_video(tmp_path / "a.mp4", [image])
    small = read(VideoFile(tmp_path / "a.mp4"), 0, 1, 16, 12)[0]
    assert np.abs(small.astype(int) - coarse).max() <= 6


def test_frames_outside_the_video_are_refused(video: Path) -> None:
    with pytest.raises(CaptureError, match=r"cam01\.mp4: frames 10:13 asked for, the video has 12"):
        read(VideoFile(video), 10, 3)


@pytest.mark.parametrize("options", [{}, {"movflags": "faststart"}], ids=["index at the end", "index first"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.95])
def test_truncated_video_is_named(tmp_path: Path, options: dict[str, str], share: float) -> None:
    path = tmp_path / "cam03.mp4"
    rng = np.random.default_rng(0)
    folders.write_video(path, [rng.integers(0, 255, (24, 32, 3), np.uint8) for _ in range(FRAMES)], options)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CaptureError, match=r"cam03\.mp4.*truncated"):
        VideoFile(path)


def test_damaged_frames_do_not_block_others(tmp_path: Path) -> None:
    path = tmp_path / "cam04.mp4"
    rng = np.random.default_rng(0)
    folders.write_video(path, [rng.integers(0, 255, (24, 32, 3), np.uint8) for _ in range(FRAMES)])
    content = bytearray(path.read_bytes())
    middle = content.index(b"mdat") + 2 * len(content) // 3
    content[middle : middle + 3000] = b"\x00" * 3000
    path.write_bytes(content)
    file = VideoFile(path)
    with pytest.raises(CaptureError, match=r"cam04\.mp4"):
        read(file, 0, FRAMES)
    assert read(file, 0, 2).shape == (2, 24, 32, 3)


@pytest.mark.parametrize("content", [b"", b"not a video at all" * 100])
def test_file_that_is_no_video_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cam05.mp4"
    path.write_bytes(content)
    with pytest.raises(CaptureError, match=r"cam05\.mp4: cannot be decoded"):
        VideoFile(path)


@pytest.mark.parametrize(
    ("matrix", "show"),
    [
        ((0, 1, -1, 0), lambda image: np.rot90(image, 3)),
        ((-1, 0, 0, -1), lambda image: np.rot90(image, 2)),
        ((0, -1, 1, 0), np.rot90),
        ((-1, 0, 0, 1), np.fliplr),
        ((1, 0, 0, -1), np.flipud),
        ((0, 1, 1, 0), lambda image: image.swapaxes(0, 1)),
    ],
)
def test_display_matrix_is_applied(
    tmp_path: Path, matrix: tuple[int, int, int, int], show: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Phones store portrait videos in landscape, and front cameras mirror, with a matrix in the track's header."""
    lying = np.zeros((24, 32, 3), np.uint8)
    lying[:8, :16] = 255
    folders.write_video(tmp_path / "a.mp4", [lying] * 2)
    write_display_matrix(tmp_path / "a.mp4", matrix)
    video, shown = VideoFile(tmp_path / "a.mp4"), show(lying)
    assert (video.height, video.width) == shown.shape[:2]
    found = read(video, 1, 1, video.width, video.height)[0]
    assert np.abs(found.astype(int) - shown).mean() < 3


def test_display_at_an_angle_is_refused(tmp_path: Path) -> None:
    folders.write_video(tmp_path / "a.mp4", [folders.frame(0, 0)])
    write_display_matrix(tmp_path / "a.mp4", (1, 1, -1, 1))
    with pytest.raises(CaptureError, match=r"a\.mp4: is shown at an angle of -?45 degrees"):
        VideoFile(tmp_path / "a.mp4")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipe_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "cam00.mp4")
    with pytest.raises(CaptureError, match=r"cam00\.mp4: is not a file"):
        VideoFile(tmp_path / "cam00.mp4")


@pytest.mark.parametrize(
    ("codec", "suffix", "format"),
    [
        ("libx264", ".mxf", "mxf"),
        ("mpeg2video", ".mxf", "mxf"),
        ("mpeg2video", ".mpg", "mpeg"),
        ("libx264", ".m2ts", "mpegts"),
        ("libx264", ".3gp", "3gp"),
        ("libx264", ".flv", "flv"),
        ("wmv2", ".wmv", "asf"),
    ],
)
def test_frames_of_other_containers_have_their_numbers(tmp_path: Path, codec: str, suffix: str, format: str) -> None:
    path = tmp_path / f"cam00{suffix}"
    with av.open(str(path), "w", format=format) as container:
        stream: Any = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.codec_context.gop_size, stream.codec_context.max_b_frames = 8, 0 if codec == "wmv2" else 2
        for t in range(20):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(folders.frame(0, t % 13, 128, 96), format="rgb24")))
        container.mux(stream.encode(None))
    assert path.suffix in VIDEO_SUFFIXES
    file = VideoFile(path)
    assert file.frames == 20
    np.testing.assert_allclose(file.times, np.arange(20) / 25, atol=2e-3)
    for number in (0, 1, 7, 12, 5):
        assert folders.which(read(file, number, 1)[0])[1] == number
    file.close()
