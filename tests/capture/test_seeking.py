"""Random access returns exactly the requested frames for every container and codec."""

import struct
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.video import VideoFile
from tests.capture.numbered import CODINGS, COUNT, HEIGHT, WIDTH, number_of, write_film

CONTAINERS = (".mp4", ".mov", ".mkv", ".ts", ".mts", ".avi")


def read(video: VideoFile, numbers: list[int]) -> list[int]:
    """Return the numbers that frames show."""
    out = np.empty((len(numbers), HEIGHT, WIDTH, 3), np.uint8)
    video.read_into(out, np.array(numbers))
    return [number_of(image) for image in out]


def check_random_reads(path: Path, shown: list[int], seed: int = 0, reads: int = 12) -> None:
    """Read stretches in random order with one decoder and compare their content with `shown`."""
    video, rng = VideoFile(path), np.random.default_rng(seed)
    assert video.frames == len(shown)
    for _ in range(reads):
        first = int(rng.integers(len(shown)))
        numbers = list(range(first, min(first + int(rng.integers(1, 5)), len(shown)), int(rng.integers(1, 3))))
        assert read(video, numbers) == [shown[number] for number in numbers], (path.name, numbers)
    video.close()


def possible(coding: str, suffix: str) -> bool:
    if coding == "vp9":
        return suffix in (".mp4", ".mkv")
    return not (coding.startswith("hevc") and suffix == ".avi")


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_seeks_are_exact_in_every_container(tmp_path: Path, suffix: str) -> None:
    for number, coding in enumerate(coding for coding in CODINGS if possible(coding, suffix)):
        path = write_film(tmp_path / f"{coding}{suffix}", coding)
        check_random_reads(path, list(range(COUNT)), number)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts"])
def test_seeks_are_exact_at_variable_rates(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.choice([1500, 3000, 9000, 45000], COUNT)).tolist()
    for coding in ("h264", "h264 open GOPs", "hevc open GOPs"):
        path = write_film(tmp_path / f"{coding}{suffix}", coding, times=times, sound=True)
        check_random_reads(path, list(range(COUNT)))
        gaps = np.diff(VideoFile(path).times) * 90000
        assert np.abs(gaps - np.diff(times)).max() <= 91  # Matroska counts milliseconds


@pytest.mark.parametrize("suffix", [".ts", ".mts"])
def test_cut_recording_starts_at_its_first_keyframe(tmp_path: Path, suffix: str) -> None:
    for coding in ("h264", "h264 open GOPs", "mpeg2"):
        path = write_film(tmp_path / f"{coding}{suffix}", coding)
        content = path.read_bytes()
        path.write_bytes(content[188 * (len(content) // 188 // 3) :])
        first = read(VideoFile(path), [0])[0]
        assert 8 <= first < 24
        check_random_reads(path, list(range(first, COUNT)))


@pytest.mark.parametrize("begin", [0, 3, 8, 11, 21])
def test_edit_list_hides_frames(tmp_path: Path, begin: int) -> None:
    for coding in ("h264", "h264 open GOPs"):
        path = write_film(tmp_path / f"{coding}.mp4", coding)
        content = bytearray(path.read_bytes())
        at = content.index(b"elst")
        version, entries = content[at + 4], int.from_bytes(content[at + 8 : at + 12], "big")
        assert (version, entries) == (0, 1)
        _, media_time = struct.unpack(">Ii", content[at + 12 : at + 20])
        scale = int.from_bytes(content[(head := content.index(b"mdhd")) + 16 : head + 20], "big")
        movie = int.from_bytes(content[(head := content.index(b"mvhd")) + 16 : head + 20], "big")
        length = 15
        content[at + 12 : at + 20] = struct.pack(">Ii", movie * length // 30, media_time + begin * scale // 30)
        path.write_bytes(content)
        check_random_reads(path, list(range(begin, begin + length)))


def test_frames_before_and_after_damage_can_be_read(tmp_path: Path) -> None:
    path = write_film(tmp_path / "cam00.ts", "h264")
    video = VideoFile(path)
    key = int(video.table.key_offsets[2])
    content = bytearray(path.read_bytes())
    content[key + 188 : key + 4 * 188] = b"\xff" * (3 * 188)
    path.write_bytes(content)  # damaged after it was opened
    assert read(video, [30]) == [30]
    assert read(video, [3]) == [3]
