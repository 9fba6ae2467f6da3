import json
import os
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.calibration_files import is_in_meters, write_record
from splatreel.calibration.sound_sync import RATE, SPEED
from splatreel.calibration.sync import synchronize
from splatreel.capture.opening import open_capture
from splatreel.capture.sidecar import read_sidecar
from splatreel.scene.camera import Camera
from tests.capture import folders
from tests.capture.films import HEARD, film

BEGAN = {"a": 0.4, "b": 1.25, "c": 0.0}
"""Seconds of the scene at which each video starts."""


def scene(seconds: float, seed: int = 0) -> np.ndarray:
    """Return claps and a hum, [samples]."""
    rng = np.random.default_rng(seed)
    sound = 0.02 * np.sin(np.arange(round(seconds * HEARD)) * 0.02)
    for at in rng.uniform(0, seconds - 0.1, round(2 * seconds)):
        clap = rng.normal(size=2000) * np.exp(-np.arange(2000) / 300)
        sound[round(at * HEARD) :][:2000] += 0.3 * clap
    return sound


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    whole, rng = scene(6), np.random.default_rng(1)
    for name, start in BEGAN.items():
        heard = whole[round(start * HEARD) :][: 4 * HEARD]
        film(tmp_path / f"{name}.mp4", heard + 0.01 * rng.normal(size=len(heard)))
    return tmp_path


def test_sync_starts_when_all_videos_run(folder: Path) -> None:
    (folder / "splatreel.json").write_text('{"fps": 10}')
    starts = synchronize(folder, Silent()).starts
    assert starts == pytest.approx({name: 1.25 - began for name, began in BEGAN.items()}, abs=2 / RATE)
    written = json.loads((folder / "splatreel.json").read_text())
    sync = written.pop("sync")
    assert written == {"fps": 10, "starts": starts}
    assert sorted(sync) == ["b", "c"], "the others are aligned with the first"
    for found in read_sidecar(folder).sync.values():
        assert found.by == "sound"
        assert (found.clear or 0) > (found.needed or 0) > 1


def test_a_dry_run_writes_nothing(folder: Path) -> None:
    found = synchronize(folder, Silent(), dry_run=True)
    assert found.starts["c"] == pytest.approx(1.25, abs=2 / RATE)
    assert not (folder / "splatreel.json").exists()


def test_start_times_within_half_a_frame_are_kept(folder: Path) -> None:
    """A frame takes 100 milliseconds."""
    known = '{"starts": {"a": 1.82, "b": 1.0, "c": 2.27}}'
    (folder / "splatreel.json").write_text(known)
    assert synchronize(folder, Silent()).in_step
    assert (folder / "splatreel.json").read_text() == known
    (folder / "splatreel.json").write_text('{"starts": {"a": 1.95, "b": 1.0, "c": 2.27}}')
    assert not synchronize(folder, Silent()).in_step
    assert read_sidecar(folder).starts["a"] == pytest.approx(0.85, abs=2 / RATE)


@pytest.mark.parametrize("late", [0.003, 0.3])
def test_a_calibrated_capture_in_step_is_not_changed(tmp_path: Path, late: float) -> None:
    whole = scene(6)
    for c in range(4):
        film(tmp_path / f"cam{c:02d}.mp4", whole[round(late * (c == 2) * HEARD) :][: 4 * HEARD])
    np.save(tmp_path / "poses_bounds.npy", folders.llff(folders.cameras(4)))
    found = synchronize(tmp_path, Silent())
    assert found.in_step == (late < 0.05)
    assert (tmp_path / "splatreel.json").exists() == (late > 0.05)


def test_sync_names_a_silent_video_without_motion(folder: Path) -> None:
    film(folder / "d.mp4", None)
    with pytest.raises(
        CaptureError, match=r"nothing tells when d\.mp4 start.* it has no sound; its motion and light fit"
    ):
        synchronize(folder, Silent())
    assert not (folder / "splatreel.json").exists()


def moving(
    path: Path, began: float, side: int, seconds: float = 8, rate: float = 1.0, sound: int | None = None
) -> None:
    """Write a video, 30 frames per second, of a disk that moves in fits; `side` mirrors and shades the view.

    Args:
        path: File.
        began: Second of the scene at which the video starts.
        side: View.
        seconds: Duration.
        rate: Seconds of the scene in a second of the video.
        sound: Seed of noise that nothing else records, or None for a silent video.
    """
    rng = np.random.default_rng(7)
    fits = round(4 * (began + rate * seconds)) + 4
    speeds = np.repeat(rng.uniform(0, 40, 4000) * (rng.random(4000) < 0.5), 30)[: 30 * fits]
    places = np.cumsum(speeds) / 120  # pixels; speeds are pixels per second, each for a quarter second
    y, x = np.mgrid[:72, :96]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuv420p"
        stream.codec_context.options = {"preset": "ultrafast"}
        track = None if sound is None else container.add_stream("pcm_s16le", rate=8000, layout="mono")
        for number in range(round(seconds * 30)):
            place = 10 + places[min(round((began + rate * number / 30) * 120), len(places) - 1)] % 70
            disk = (x - (place if side else 95 - place)) ** 2 + (y - 30 - 10 * side) ** 2 < 150
            image = np.where(disk, 210, 60 + 30 * side).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(np.repeat(image[..., None], 3, 2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if track is not None:
            noise = np.random.default_rng(sound).normal(0, 1000, (1, round(8000 * seconds))).astype(np.int16)
            heard = av.AudioFrame.from_ndarray(noise, format="s16", layout="mono")
            heard.sample_rate, heard.pts = 8000, 0
            container.mux(track.encode(heard))
            container.mux(track.encode(None))


def test_silent_videos_are_synchronized_by_motion(tmp_path: Path) -> None:
    moving(tmp_path / "a.mp4", 0.5, 0)
    moving(tmp_path / "b.mp4", 1.7, 1)
    starts = synchronize(tmp_path, Silent()).starts
    assert starts["b"] == 0
    assert starts["a"] == pytest.approx(1.2, abs=0.02)
    found = read_sidecar(tmp_path).sync["b"]
    assert (found.other, found.by) == ("a", "motion and light")
    assert (found.clear or 0) > (found.needed or 0) > 1


def test_sound_that_fits_nothing_gives_way_to_motion(tmp_path: Path) -> None:
    moving(tmp_path / "a.mov", 0.5, 0, sound=1)
    moving(tmp_path / "b.mov", 1.7, 1, sound=2)
    found = synchronize(tmp_path, Silent())
    assert found.starts == pytest.approx({"a": 1.2, "b": 0}, abs=0.02)
    assert found.evidence["b"].by == "motion and light"
    assert "b is aligned by motion and light: its sound fits a best, 1." in found.notes[0]


def test_clocks_of_other_speeds_are_corrected_by_sound(tmp_path: Path) -> None:
    """The clock of b is 0.3 % too slow: 60 milliseconds, two frames, in 20 seconds."""
    seconds, whole = 20, scene(24)
    for name, began, rate in (("a", 0.0, 1.0), ("b", 1.0, 0.997), ("c", 2.0, 1.0)):
        times = began + np.arange(round(seconds * HEARD)) / HEARD / rate
        heard = np.interp(times * HEARD, np.arange(len(whole)), whole)
        film(tmp_path / f"{name}.mov", heard, seconds, codec="pcm_s16le", rate=30)
    found = synchronize(tmp_path, Silent())
    assert found.rates == pytest.approx({"b": 0.997}, abs=2e-5)
    assert found.starts == pytest.approx({"a": 2.0, "b": 0.997, "c": 0.0}, abs=2e-3)
    assert read_sidecar(tmp_path).rates == found.rates


def test_frames_follow_the_rate_of_a_clock(tmp_path: Path) -> None:
    path = folders.neu3dv(tmp_path / "scene", count=3, frames=13)
    (path / "splatreel.json").write_text('{"rates": {"cam01": 1.1}}')
    capture = open_capture(path)
    shown = {c: [folders.which(capture.read(t, 1, [f"cam{c:02d}"])[0, 0])[1] for t in (0, 4, 10)] for c in (1, 2)}
    assert shown == {1: [0, 4, 11], 2: [0, 4, 10]}


def test_sync_names_a_video_with_other_sound(folder: Path) -> None:
    film(folder / "d.mp4", 0.1 * np.random.default_rng(2).normal(size=4 * HEARD))
    with pytest.raises(CaptureError, match=r"d: its sound fits . best, 1\.\d\d times .*2 is needed.*motion and light"):
        synchronize(folder, Silent())


def test_sync_needs_two_videos(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", None)
    (tmp_path / "b.braw").touch()
    with pytest.raises(CaptureError, match=r"1 videos.* not read: b\.braw\. Convert \.braw to \.mp4"):
        synchronize(tmp_path, Silent())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipe_among_videos_does_not_block(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(CaptureError, match=r"a\.mp4: is a pipe or a device"):
        synchronize(tmp_path, Silent())


def test_too_short_videos_are_named_once_with_their_reason(tmp_path: Path) -> None:
    for number in range(14):
        film(tmp_path / f"cam{number:02d}.mp4", None, seconds=1.2)
    with pytest.raises(CaptureError) as error:
        synchronize(tmp_path, Silent())
    said = str(error.value)
    assert "too short to be compared by motion and light (1.1 s; 2 s are needed)" in said
    assert said.count("too short") == 1
    assert "cam01, cam02, cam03, cam04, cam05, cam06 and 7 more: " in said
    assert "0.00" not in said


def test_slow_motion_is_recognized_by_motion(tmp_path: Path) -> None:
    moving(tmp_path / "a.mp4", 0.0, 0)
    moving(tmp_path / "b.mp4", 0.5, 1, seconds=24, rate=0.25)
    with pytest.raises(CaptureError, match=r"fit if b plays 4 times as fast.*slow motion.*-itsscale 0\.25 -i b\.mp4"):
        synchronize(tmp_path, Silent())


DISTANCES = (2.0, 5.0, 12.0, 3.0)
"""Meters of four cameras to the sound."""


def far_apart(folder: Path, began: tuple[float, ...] = (0.4, 0.0, 0.9, 0.2)) -> Path:
    """Write videos of cameras at `DISTANCES` from claps, each of which hears them late, and a model in which they look there."""
    whole = scene(6)
    folder.mkdir()
    for number, (meters, start) in enumerate(zip(DISTANCES, began, strict=True)):
        first = round((1 + start - meters / SPEED) * HEARD)
        film(folder / f"cam{number:02d}.mp4", whole[first:][: 3 * HEARD], 3)
    views = []
    for number, meters in enumerate(DISTANCES):
        angle = 0.5 * number
        viewmat = np.eye(4)
        viewmat[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        viewmat[2, 3] = meters
        views.append(Camera(f"cam{number:02d}", viewmat, folders.cameras(1)[0].K, folders.WIDTH, folders.HEIGHT))
    folders.colmap_model(folder, views)
    images = folder / "sparse" / "0" / "images.txt"
    images.write_text(images.read_text().replace("/000000.png", ".png"))
    return folder


def test_time_that_sound_takes_is_corrected_where_poses_are_in_meters(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    folder = far_apart(tmp_path / "scene")
    heard = synchronize(folder, Silent())
    true = {"cam00": 0.5, "cam01": 0.9, "cam02": 0.0, "cam03": 0.7}
    off = {name: heard.starts[name] - start for name, start in true.items()}
    assert max(off.values()) - min(off.values()) == pytest.approx(10 / SPEED, abs=1e-3)
    assert "29 ms (0.3 frames) late" in heard.notes[-1]
    write_record(folder / "sparse" / "0", {"options": {"board": "5x7:0.035"}})
    found = synchronize(folder, Silent())
    assert found.starts == pytest.approx(true, abs=1e-3)
    assert not found.in_step, "start times of an earlier run are corrected, though they are within half a frame"
    assert "corrected, by up to 29.2 ms" in found.notes[-1]
    assert "2.0 to 12.0 m away" in found.notes[-1]


def test_start_times_by_hand_are_kept_within_half_a_frame(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    folder = far_apart(tmp_path / "scene")
    write_record(folder / "sparse" / "0", {"options": {"distance": "('cam00', 'cam01', 3)"}})
    (folder / "splatreel.json").write_text('{"starts": {"cam00": 0.52, "cam01": 0.9, "cam02": 0.0, "cam03": 0.7}}')
    assert synchronize(folder, Silent()).in_step


def test_a_model_that_was_replaced_is_not_taken_to_be_in_meters(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    folder = folders.colmap_model(tmp_path, folders.cameras())
    model = folder / "sparse" / "0"
    write_record(model, {"options": {"board": "5x7:0.035"}})
    assert is_in_meters(folder)
    (model / "points3D.txt").write_text("# another model\n")
    assert not is_in_meters(folder)
    write_record(model, {"options": {"same_lens": "True"}})
    assert not is_in_meters(folder)
