"""Soundtrack of a run: present from the first group on, unchanged by an interruption, and in every reel of the run."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError, ReconstructionError
from splatreel.base.progress import Silent
from splatreel.capture.capture_sound import Track
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.play.timeline import open_reel
from splatreel.run.output.reencode import reencode
from splatreel.run.output.sound_output import load_soundtrack, save_soundtrack, select_soundtrack
from splatreel.run.pipeline import reconstruct
from tests import flashes
from tests.capture.films import film
from tests.method.captures import WallCapture
from tests.notes import Notes
from tests.run.test_pipeline import CONFIG, content

CLICKS = {"cam1": 0.25, "cam2": 0.75}
"""Seconds into its video of each camera's click; the frames begin 0.15 s into it, or 0.65 s."""


class Loud(WallCapture):
    """Capture of which two cameras have sound. The second began half a second earlier, and is farther away."""

    def __init__(self, folder: Path) -> None:
        super().__init__(4, fps=10)
        self.folder, (_, self.first, self.second, *_) = folder, [camera.name for camera in self.cameras]

    def tracks(self) -> dict[str, Track]:
        return {self.first: Track(self.folder / "near.mp4", 0.15), self.second: Track(self.folder / "far.mp4", 0.65)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("films")
    for name, level in (("near", 1.0), ("far", 0.5)):
        sound = np.zeros(44100)
        at = round(CLICKS["cam1" if name == "near" else "cam2"] * 44100)
        sound[at : at + 441] = level * 0.8 * np.exp(-np.arange(441) / 55)
        film(found / f"{name}.mp4", sound, 1)
    return found


@pytest.fixture(scope="module")
def whole(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    notes, capture = Notes(), Loud(folder)
    result = reconstruct(capture, tmp_path_factory.mktemp("whole") / "run", CONFIG, progress=notes)
    assert notes.lines[0] == f"Sound: camera {capture.first} (the loudest without distortion)"
    return result.reel.parent


def loud_at(sound: np.ndarray) -> float:
    return float(np.abs(sound).max(1).argmax() / 48000)


def test_reel_contains_soundtrack_with_position(folder: Path, whole: Path) -> None:
    reel, capture = open_reel(whole / "reel"), Loud(folder)
    assert verify_reel(whole / "reel").strangers == []
    assert reel.sound.position is not None
    np.testing.assert_allclose(reel.sound.position, capture.camera(capture.first).center, atol=1e-6)
    assert reel.duration == 0.4
    assert loud_at(reel.sound.samples(0, reel.duration)) == pytest.approx(0.1, abs=2e-3)


def test_interrupted_run_has_same_soundtrack(folder: Path, whole: Path, tmp_path) -> None:
    def stop(writer: ReelWriter, group: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(Loud(folder), tmp_path, CONFIG, present=stop)
    manifest = ReelReader(tmp_path / "reel").manifest
    assert manifest.live
    assert len(manifest.presentation.sound.segments) == 1
    verify_reel(tmp_path / "reel")
    (tmp_path / "reel" / "sound" / "init.mp4").unlink()
    reconstruct(Loud(Path("the films are gone")), tmp_path, CONFIG)
    assert content(tmp_path / "reel") == content(whole / "reel")


def test_reencoded_reel_has_same_soundtrack(whole: Path, tmp_path: Path) -> None:
    reencode(whole / "work", tmp_path / "low", EncodeConfig(coarseness=2.0), Silent())
    sounds = [ReelReader(reel).manifest.presentation.sound for reel in (whole / "reel", tmp_path / "low")]
    assert sounds[0] == sounds[1] is not None
    verify_reel(tmp_path / "low")


def test_resume_with_other_sound_is_refused(folder: Path, whole: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(whole, tmp_path / "copy")
    with pytest.raises(ReconstructionError, match='sound is "auto" there, "none" now'):
        reconstruct(Loud(folder), copy, CONFIG, sound="none")


def test_missing_sound_fails_before_writing(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="neither a file nor such a camera"):
        reconstruct(Loud(folder), tmp_path, CONFIG, sound="cam99")
    assert not list((tmp_path / "work").glob("*.json"))


@pytest.mark.parametrize("wanted", ["auto", "none"])
def test_silent_run_saves_no_soundtrack(tmp_path: Path, wanted: str) -> None:
    notes = Notes()
    save_soundtrack(tmp_path, select_soundtrack(tmp_path, WallCapture(2), wanted, notes))
    assert notes.lines == ["Sound: none" if wanted == "none" else "Sound: none, since no video has an audio track"]
    assert list(tmp_path.iterdir()) == []


def test_soundtrack_checkpoint_round_trip(folder: Path, tmp_path: Path) -> None:
    capture = Loud(folder)
    for wanted in (capture.second, str(folder / "near.mp4")):
        work = tmp_path / str(len(wanted))
        sound = select_soundtrack(work, capture, wanted, Silent())
        save_soundtrack(work, sound)
        assert load_soundtrack(work) == sound == select_soundtrack(work, WallCapture(2), "auto", Silent())
    assert load_soundtrack(tmp_path / str(len(str(folder / "near.mp4")))).position is None
    assert load_soundtrack(work).encoded.samples == flashes.RATE * 0.4
