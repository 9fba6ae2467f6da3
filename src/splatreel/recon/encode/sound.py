"""The sound of a run: chosen and encoded when it begins, kept with the checkpoints for whatever reel is written of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.capture.base import Capture
from splatreel.capture.soundtrack import choose
from splatreel.codec.opus_sound import EncodedSound, encode_sound, write_sound
from splatreel.codec.presentation import Vec3
from splatreel.codec.writer import ReelWriter
from splatreel.progress import Progress
from splatreel.recon.run import checkpoint
from splatreel.scene.untrusted import numbers


@dataclass(frozen=True)
class RunSound:
    """What is heard, and where it comes from, world units; None: from everywhere."""

    encoded: EncodedSound
    position: Vec3 | None


def hear(work: Path, capture: Capture, wanted: str, progress: Progress) -> RunSound | None:
    """The sound of a capture's frames, which says what it is; of a run that goes on, that with which it began.

    wanted: auto, none, the name of a camera, or a file. Raises `CaptureError` where that has no sound.
    """
    if _file(work).exists():
        return load_sound(work)
    seconds = capture.frames / capture.fps
    choice = choose(wanted, capture.tracks(), seconds, capture.first_frame / capture.fps, capture.path)
    if choice is None:
        progress.note("Sound: none" if wanted == "none" else "Sound: none, no video has any")
        return None
    progress.note(f"Sound: {choice}")
    position = None if choice.camera is None else place_of(capture, choice.camera)
    return RunSound(encode_sound(choice.samples(seconds), choice.channels), position)


def place_of(capture: Capture, camera: str) -> Vec3:
    """Where a camera stands, as the manifest says it."""
    x, y, z = (round(value, 6) for value in capture.camera(camera).center.tolist())
    return x, y, z


def save_sound(work: Path, sound: RunSound | None) -> None:
    """Keep it; nothing for None, and for what is kept already."""
    if sound is None or _file(work).exists():
        return
    encoded = sound.encoded
    files = {f"segment{index:06d}": data for index, data in enumerate(encoded.segments)} | {"init": encoded.init}
    arrays: dict[str, np.ndarray] = {name: np.frombuffer(data, np.uint8) for name, data in files.items()}
    arrays["format"] = np.array([encoded.channels, encoded.samples])
    arrays["position"] = np.array(sound.position or (), np.float64)
    checkpoint.save_arrays(_file(work), arrays)


def load_sound(work: Path) -> RunSound | None:
    """What is kept; None where nothing is. Raises `ReconstructionError` for a file that cannot be read."""
    if not _file(work).exists():
        return load_live_sound(work)
    arrays = checkpoint.load_arrays(_file(work))
    channels, samples = arrays["format"].tolist()
    segments = tuple(arrays[name].tobytes() for name in sorted(arrays) if name.startswith("segment"))
    encoded = EncodedSound(channels, arrays["init"].tobytes(), segments, samples)
    position = arrays["position"].tolist()
    return RunSound(encoded, (position[0], position[1], position[2]) if position else None)


def load_live_sound(work: Path) -> RunSound | None:
    """Of a capture that was followed, in OUT/work/sound; None where there is none, or its beginning was dropped."""
    choice = work / "sound" / "choice.json"
    known = checkpoint.load_checked(choice, sound_choice) if choice.exists() else None
    files = sorted((work / "sound").glob("*.m4s"))
    if known is None or not files or not files[0].name.startswith("000000-"):
        return None
    samples = sum(int(file.stem.partition("-")[2]) for file in files)
    init = (work / "sound" / "init.mp4").read_bytes()
    encoded = EncodedSound(known["channels"], init, tuple(file.read_bytes() for file in files), samples)
    x, y, z = known["position"]
    return RunSound(encoded, (x, y, z))


def sound_choice(value: Any) -> dict[str, Any] | None:
    """Return the camera, channels and position of a soundtrack; None for silence. Raises KeyError or TypeError for anything else."""
    if value is None:
        return None
    if not isinstance(value["camera"], str) or type(value["channels"]) is not int:
        raise TypeError("camera or channels are none")
    numbers(value["position"], 3)
    return value


def publish_sound(work: Path, writer: ReelWriter) -> None:
    """Give a reel the sound that is kept, before its first group. Where none is, a reel keeps what it has."""
    sound = load_sound(work)
    if sound is not None:
        write_sound(writer, sound.encoded, sound.position)


def _file(work: Path) -> Path:
    return work / "sound.safetensors"
