"""Videos are scanned once, mostly without image data, and read in parts wherever they are stored."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture import video as video_module
from splatreel.capture.capture_sound import Track, choose
from splatreel.capture.files import LOCAL, RemoteFiles, open_media
from splatreel.capture.frame_table import ARRAYS, FrameTable, load_tables, pack_tables, scan
from splatreel.capture.opening import CaptureSource, open_capture
from splatreel.capture.video import VideoFile
from splatreel.storage.address import BLOCK, Address
from tests.buckets import Bucket
from tests.capture import folders
from tests.capture.numbered import CODINGS, write_film


def same(a: FrameTable, b: FrameTable) -> bool:
    rest = {name for name in FrameTable.__dataclass_fields__ if name not in ARRAYS}
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS) and all(
        getattr(a, name) == getattr(b, name) for name in rest
    )


@pytest.mark.parametrize("options", [{}, {"movflags": "faststart"}, {"movflags": "frag_keyframe+empty_moov"}])
def test_index_only_gives_the_same_table(tmp_path: Path, options: dict[str, str]) -> None:
    for coding in (*CODINGS,):
        path = write_film(tmp_path / "film.mp4", coding, options=options, sound=True)
        with open_media(LOCAL, path) as container:
            expected = scan(container, container.streams.video[0], path.stat().st_size)
        assert same(VideoFile(path).table, expected), coding


def test_frame_tables_round_trip(tmp_path: Path) -> None:
    tables = {name: VideoFile(write_film(tmp_path / name)).table for name in ("a.mp4", "b.ts")}
    (tmp_path / "tables").write_bytes(pack_tables(tables))
    found = load_tables(tmp_path / "tables")
    assert list(found) == list(tables)
    assert all(same(found[name], tables[name]) for name in tables)
    assert load_tables(tmp_path / "missing") == {}
    (tmp_path / "tables").write_bytes(b"damaged")
    assert load_tables(tmp_path / "tables") == {}


def test_known_video_is_not_scanned_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = folders.neu3dv(tmp_path / "capture")
    tables = tmp_path / "tables"
    with_scan = open_capture(capture)
    tables.write_bytes(pack_tables(with_scan.frame_tables()))
    scanned: list[int] = []
    monkeypatch.setattr(video_module, "scan", lambda *rest: scanned.append(1) or scan(*rest))
    known = CaptureSource(capture, {"width": 16})(tables)
    assert scanned == []
    assert folders.which(known.read(7, 1, ["cam01"])[0, 0]) == (1, 7)
    folders.write_video(capture / "cam02.mp4", [folders.frame(3, t) for t in range(folders.FRAMES)] * 2)
    CaptureSource(capture, {"frames": (0, 4)})(tables)
    assert scanned == [1]


def big_film(path: Path) -> Path:
    """Write some megabytes of noise with a keyframe every five frames."""
    rng = np.random.default_rng(0)
    folders.write_video(path, [rng.integers(0, 255, (240, 320, 3), np.uint8) for _ in range(30)])
    return path


@pytest.mark.parametrize("suffix", [".mp4", ".ts", ".mkv"])
def test_remote_stretch_fetches_only_its_bytes(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    path = big_film(tmp_path / f"cam00{suffix}")
    size, table = path.stat().st_size, VideoFile(path).table
    assert size > 4e6
    address = f"memory://films-{suffix[1:]}/capture"
    Address(address).write(path.name, path.read_bytes())
    files, opened = RemoteFiles(address), []
    monkeypatch.setattr(files, "raw", lambda place: opened.append(RemoteFiles.raw(files, place)) or opened[-1])
    video = VideoFile(files.root / path.name, files, table)
    assert not opened, "a known video is opened by the first read"
    out, expected = (np.empty((3, 240, 320, 3), np.uint8) for _ in range(2))
    video.read_into(out, np.arange(20, 23))
    VideoFile(path).read_into(expected, np.arange(20, 23))
    assert np.array_equal(out, expected)
    assert sum(file.fetched for file in opened) < 0.6 * size
    if suffix == ".mp4":
        opened.clear()
        assert same(VideoFile(files.root / path.name, files).table, table)
        assert sum(file.fetched for file in opened) < 0.5 * size


@pytest.mark.parametrize("layout", [folders.neu3dv, folders.colmap, folders.panoptic])
def test_remote_capture_equals_the_local_one(tmp_path: Path, bucket: Bucket, layout) -> None:
    local = layout(tmp_path / "capture")
    here, there = open_capture(local), open_capture(bucket.upload(local, "films/capture"))
    assert there.fingerprint() == here.fingerprint()
    names = [camera.name for camera in here.cameras]
    assert np.array_equal(there.read(0, here.frames, names), here.read(0, here.frames, names))
    root = there.path
    assert root.is_dir()
    there.close()
    del there
    assert not root.exists()
    with pytest.raises(CaptureError, match=r"s3://.*/nothing: there are no files"):
        open_capture(bucket.url("nothing"))


def test_ranged_file_prefetches_sequential_reads(tmp_path: Path) -> None:
    content = np.random.default_rng(0).bytes(5 * BLOCK + 100)
    (tmp_path / "file").write_bytes(content)
    file = Address(tmp_path).open("file", len(content))
    assert b"".join(iter(lambda: file.read(30_000), b"")) == content
    assert file.fetched == len(content)
    file.seek(-50, 2)
    assert file.read() == content[-50:]
    file.seek(BLOCK - 10)
    assert file.read(20) == content[BLOCK - 10 : BLOCK + 10]
    assert file.fetched == len(content)


def test_long_track_is_judged_by_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from splatreel.capture import capture_sound as sound_module
    from tests.capture.films import HEARD, film

    beat = np.sin(2 * np.pi * 440 * np.arange(30 * HEARD) / HEARD) * (np.arange(30 * HEARD) // HEARD / 30)
    film(tmp_path / "a.mp4", 0.5 * beat, 30)
    film(tmp_path / "b.mp4", 0.8 * beat, 30)
    tracks = {name: Track(tmp_path / f"{name}.mp4", 0.0) for name in "ab"}
    monkeypatch.setattr(sound_module, "WINDOW", 0.5)
    decoded: list[int] = []
    read = sound_module.read_sound
    monkeypatch.setattr(
        sound_module,
        "read_sound",
        lambda *rest: (block for block in read(*rest) if decoded.append(len(block)) or True),
    )
    choice = choose("auto", tracks, 30.0, 0.0, tmp_path)
    assert choice is not None
    assert choice.camera == "b"
    assert sum(decoded) < 0.6 * 2 * 30 * 48000
    late = np.concatenate(list(choice.samples(1.0, 20.0)))[:, 0]
    whole = np.concatenate(list(choice.samples(30.0)))[20 * 48000 : 21 * 48000, 0]
    assert np.abs(late - whole).max() < 0.02
