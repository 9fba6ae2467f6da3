"""Choice of a track, and times of sound in videos."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Request
from splatreel.capture.capture_sound import RATE, Track, choose, read_sound
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.videos import Videos
from tests.capture.films import HEARD, film

HERE = Path("capture")


def click(*times: float, seconds: float = 4) -> np.ndarray:
    """Return short bursts at some times, [samples]."""
    sound = np.zeros(round(seconds * HEARD))
    for time in times:
        at = round(time * HEARD)
        sound[at : at + 300] = 0.8 * np.exp(-np.arange(300) / 60) * np.cos(np.arange(300) * 0.4)
    return sound


def hum(level: float) -> np.ndarray:
    return level * np.sin(np.arange(4 * HEARD) * 0.02)


def onset(sound: np.ndarray) -> float:
    """Return the time in seconds of the first loud sample of [n, channels] at `RATE`."""
    return float(np.flatnonzero(np.abs(sound).max(1) > 0.4)[0] / RATE)


def chosen(wanted: str, tracks: dict[str, Track], seconds: float = 3.0, begin: float = 0.0):
    return choose(wanted, tracks, seconds, begin, HERE)


def tracks(folder: Path, **sounds: np.ndarray | None) -> dict[str, Track]:
    for name, sound in sounds.items():
        film(folder / f"{name}.mp4", sound)
    return {name: Track(folder / f"{name}.mp4", 0.0) for name in sounds}


@pytest.mark.parametrize("start", [0.0, 0.5, 0.7371])
@pytest.mark.parametrize(("codec", "late"), [("aac", 0.0), ("aac", 0.3), ("pcm_s16le", 0.0), ("pcm_s16le", 0.3)])
def test_click_keeps_its_time(tmp_path: Path, codec: str, late: float, start: float) -> None:
    """Includes sound that starts after the images, and reads from the middle."""
    file = tmp_path / ("a.mp4" if codec == "aac" else "a.mkv")
    film(file, click(1.25), late=late, codec=codec)
    found = np.concatenate(list(read_sound(file, 1, RATE, start)))
    assert onset(found) == pytest.approx(1.25 + late - start, abs=1e-3)
    assert len(found) / RATE == pytest.approx(4 + late - start, abs=0.05)


def test_stereo_stays_stereo(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", np.stack([click(1.0), click(2.0)], 1))
    choice = chosen("a", {"a": Track(tmp_path / "a.mp4", 0.0)})
    sound = np.concatenate(list(choice.samples(3)))
    assert sound.shape == (3 * RATE, 2)
    assert [onset(sound[:, i : i + 1]) for i in (0, 1)] == pytest.approx([1.0, 2.0], abs=1e-3)


def test_gaps_become_silence(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", click(1.0))
    sound = np.concatenate(list(chosen("a", {"a": Track(tmp_path / "a.mp4", 0.5)}).samples(6)))
    assert sound.shape == (6 * RATE, 1)
    assert onset(sound) == pytest.approx(0.5, abs=1e-3)
    assert not sound[4 * RATE :].any()


def test_loudest_undistorted_track_is_chosen(tmp_path: Path) -> None:
    found = tracks(tmp_path, near=np.clip(hum(3.0), -1, 1), middle=hum(0.5), far=hum(0.1), deaf=None, dead=hum(0.0))
    assert str(chosen("auto", found)) == "camera middle (the loudest without distortion)"
    assert str(chosen("auto", {name: found[name] for name in ("near", "deaf")})) == "camera near (the least distorted)"
    assert str(chosen("auto", {name: found[name] for name in ("far", "deaf", "dead")})) == "camera far"
    assert chosen("auto", {name: found[name] for name in ("deaf", "dead")}) is None
    assert chosen("auto", {}) is None
    assert chosen("none", found) is None
    assert str(chosen("far", found)) == "camera far"


def test_choice_among_tracks_of_about_one_loudness_does_not_depend_on_the_frames(tmp_path: Path) -> None:
    louder_later = hum(0.4) * np.linspace(0.9, 1.1, len(hum(0.4)))
    found = tracks(tmp_path, first=hum(0.4), second=louder_later, quiet=hum(0.1))
    names = {chosen("auto", found, seconds).camera for seconds in (1.0, 3.0)}
    found = {name: replace(track, start=2.0) for name, track in found.items()}
    assert names | {chosen("auto", found, 1.0).camera} == {"first"}


def test_choice_uses_only_the_chosen_frames(tmp_path: Path) -> None:
    late, early = hum(0.5), hum(0.5)
    late[: 2 * HEARD], early[2 * HEARD :] = 0, 0
    found = tracks(tmp_path, late=late + hum(0.01), early=early + hum(0.01))
    assert chosen("auto", found, 2).camera == "early"
    assert chosen("auto", {name: Track(track.file, 2.0) for name, track in found.items()}, 2).camera == "late"


def test_sound_file_starts_with_the_capture(tmp_path: Path) -> None:
    film(tmp_path / "room.mp4", click(2.0))
    choice = chosen(str(tmp_path / "room.mp4"), {}, begin=1.5)
    assert choice.camera is None
    assert onset(np.concatenate(list(choice.samples(2)))) == pytest.approx(0.5, abs=1e-3)


def test_missing_sound_is_an_error(tmp_path: Path) -> None:
    found = tracks(tmp_path, loud=click(0.5), deaf=None)
    with pytest.raises(CaptureError, match=r"deaf\.mp4: has no sound"):
        chosen("deaf", found)
    with pytest.raises(CaptureError, match=r"loud\.mp4: from 2\.00 to 5\.00 s has no sound"):
        chosen("loud", {"loud": Track(found["loud"].file, 2.0)})
    with pytest.raises(CaptureError, match="neither a file nor such a camera; the cameras with videos are loud, deaf"):
        chosen("lound", found)
    (tmp_path / "notes.txt").write_text("no sound")
    with pytest.raises(CaptureError, match=r"notes\.txt: its sound cannot be decoded"):
        chosen(str(tmp_path / "notes.txt"), found)
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(found["loud"].file.read_bytes()[:2000])
    with pytest.raises(CaptureError, match=r"broken\.mp4: its sound cannot be decoded"):
        chosen(str(broken), found)


def test_tracks_start_at_the_first_frame(tmp_path: Path) -> None:
    """The cameras' offsets are exact to the millisecond, not to the frame."""
    films = tracks(tmp_path, a=click(1.0), b=click(1.777))
    files = {name: track.file for name, track in films.items()}
    (tmp_path / "splatreel.json").write_text(json.dumps({"starts": {"b": 0.777}}))
    videos = Videos(tmp_path, files, read_sidecar(tmp_path), Request())
    found = videos.tracks(5)
    assert found["b"].start == pytest.approx(1.277)
    heard = {name: onset(np.concatenate(list(read_sound(t.file, 1, RATE, t.start)))) for name, t in found.items()}
    assert heard == pytest.approx({"a": 0.5, "b": 0.5}, abs=1e-3)
    (tmp_path / "splatreel.json").unlink()
    assert Videos(tmp_path, files, read_sidecar(tmp_path), Request()).tracks(7)["a"].start == pytest.approx(0.7)


def test_video_without_sound_is_named(tmp_path: Path) -> None:
    film(tmp_path / "silent.mp4", None)
    with pytest.raises(CaptureError, match=r"silent\.mp4: has no sound"):
        next(read_sound(tmp_path / "silent.mp4", 1, RATE))
