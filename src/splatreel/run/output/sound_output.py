"""Soundtrack of a run. It is selected and encoded at the start, and kept with the checkpoints for every reel written from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.progress import Progress
from splatreel.base.untrusted import numbers
from splatreel.capture.base import Capture
from splatreel.capture.capture_sound import choose
from splatreel.codec.opus_sound import EncodedSound, encode_sound, write_sound
from splatreel.codec.presentation import Vec3
from splatreel.codec.writer import ReelWriter
from splatreel.run.store import load_arrays, load_checked, save_arrays


@dataclass(frozen=True)
class Soundtrack:
    """An encoded soundtrack.

    Attributes:
        position: Position of the source, world units; None if it is not positional.
    """

    encoded: EncodedSound
    position: Vec3 | None


def select_soundtrack(work: Path, capture: Capture, wanted: str, progress: Progress) -> Soundtrack | None:
    """Select and encode the soundtrack of a capture; a resumed run keeps the one it began with.

    `wanted` is auto, none, the name of a camera, or a file. The progress display receives a note about the choice.

    Raises:
        CaptureError: If the camera or file has no sound.
    """
    if _file(work).exists():
        return load_soundtrack(work)
    seconds = capture.frames / capture.fps
    choice = choose(wanted, capture.tracks(), seconds, capture.first_frame / capture.fps, capture.path)
    if choice is None:
        progress.note("Sound: none" if wanted == "none" else "Sound: none, since no video has an audio track")
        return None
    progress.note(f"Sound: {choice}")
    position = None if choice.camera is None else camera_position(capture, choice.camera)
    return Soundtrack(encode_sound(choice.samples(seconds), choice.channels), position)


def camera_position(capture: Capture, camera: str) -> Vec3:
    """Return the position of a camera, rounded as in the manifest."""
    x, y, z = (round(value, 6) for value in capture.camera(camera).center.tolist())
    return x, y, z


def save_soundtrack(work: Path, sound: Soundtrack | None) -> None:
    """Save a soundtrack, unless one is saved already. None saves nothing."""
    if sound is None or _file(work).exists():
        return
    encoded = sound.encoded
    files = {f"segment{index:06d}": data for index, data in enumerate(encoded.segments)} | {"init": encoded.init}
    arrays: dict[str, np.ndarray] = {name: np.frombuffer(data, np.uint8) for name, data in files.items()}
    arrays["format"] = np.array([encoded.channels, encoded.samples])
    arrays["position"] = np.array(sound.position or (), np.float64)
    save_arrays(_file(work), arrays)


def load_soundtrack(work: Path) -> Soundtrack | None:
    """Load the saved soundtrack; return None if there is none.

    Raises:
        ReconstructionError: If a file cannot be read.
    """
    if not _file(work).exists():
        return load_live_soundtrack(work)
    arrays = load_arrays(_file(work))
    channels, samples = arrays["format"].tolist()
    segments = tuple(arrays[name].tobytes() for name in sorted(arrays) if name.startswith("segment"))
    encoded = EncodedSound(channels, arrays["init"].tobytes(), segments, samples)
    position = arrays["position"].tolist()
    return Soundtrack(encoded, (position[0], position[1], position[2]) if position else None)


def load_live_soundtrack(work: Path) -> Soundtrack | None:
    """Load the soundtrack of a live capture from OUT/work/sound; return None if there is none or its beginning was dropped."""
    choice = work / "sound" / "choice.json"
    known = load_checked(choice, parse_soundtrack_choice) if choice.exists() else None
    files = sorted((work / "sound").glob("*.m4s"))
    if known is None or not files or not files[0].name.startswith("000000-"):
        return None
    samples = sum(int(file.stem.partition("-")[2]) for file in files)
    init = (work / "sound" / "init.mp4").read_bytes()
    encoded = EncodedSound(known["channels"], init, tuple(file.read_bytes() for file in files), samples)
    x, y, z = known["position"]
    return Soundtrack(encoded, (x, y, z))


def parse_soundtrack_choice(value: Any) -> dict[str, Any] | None:
    """Return the camera, channels and position of a soundtrack; None is silence.

    Raises:
        KeyError: If a field is missing.
        TypeError: If a field has another type.
    """
    if value is None:
        return None
    if not isinstance(value["camera"], str) or type(value["channels"]) is not int:
        raise TypeError("camera is not a string, or channels is not an integer")
    numbers(value["position"], 3)
    return value


def write_soundtrack(work: Path, writer: ReelWriter) -> None:
    """Write the saved soundtrack to a reel, before its first group. If none is saved, the reel keeps its own."""
    sound = load_soundtrack(work)
    if sound is not None:
        write_sound(writer, sound.encoded, sound.position)


def _file(work: Path) -> Path:
    return work / "sound.safetensors"
