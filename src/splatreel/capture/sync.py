"""Synchronization of the videos of a folder by their sound, and of silent videos by what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from splatreel.capture.growing.growing_sound import read_packets
from splatreel.capture.growing.growth import Growth
from splatreel.capture.growing.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.capture.readers.colmap import videos_but
from splatreel.capture.sidecar import SyncEvidence, write_starts
from splatreel.capture.soundtrack import RATE as SOUND_RATE
from splatreel.capture.soundtrack import channels, read_sound
from splatreel.capture.timecode import read_timecode, timecode_difference
from splatreel.capture.visible_sync import CLEAR as VISIBLY_CLEAR
from splatreel.capture.visible_sync import VisibleAgreement, compare_activity, watch
from splatreel.errors import CaptureError
from splatreel.progress import Progress

RATE = 8000
"""Samples per second; enough for claps, steps and voices, with a resolution of an eighth of a millisecond."""
LONGEST = 180
"""Maximum seconds of a video that are used."""
APART = 0.05
"""Minimum distance in seconds of a rival alignment from the best one."""
CLEAR = 2.0
"""Minimum ratio between the best alignment and its best rival."""


@dataclass(frozen=True)
class Agreement:
    """Alignment of two videos: the second started `later` seconds after the first. `clear` is its ratio to the best rival."""

    later: float
    clear: float


def synchronize(path: Path, progress: Progress, leave_out: Sequence[str] = ()) -> dict[str, float]:
    """Find the start times of a folder's videos, record them in `splatreel.json`, and return them by camera.

    Videos with sound are aligned by it, exact to less than a millisecond. Videos without sound are aligned to these by
    motion and light, exact to about half a frame, or by timecode.

    Args:
        path: Folder of videos.
        progress: Progress display.
        leave_out: Names of videos that are not used.

    Raises:
        CaptureError: The sound of a video matches no other's, or what a silent video shows matches no other video.
    """
    files = videos_but(path, leave_out)
    if len(files) < 2:
        raise CaptureError(f"{path}: {len(files)} videos; at least two are needed to synchronize.")
    progress.stage("reading the sound of the videos", len(files))
    sounds = {}
    for count, (name, file) in enumerate(files.items(), 1):
        sound = listen(file)
        if sound is not None:
            sounds[name] = sound
        progress.update(count)
    evidence: dict[str, SyncEvidence] = {}
    began = align(path, sounds, evidence, progress) if sounds else {next(iter(files)): 0.0}
    if len(began) < len(files):
        began = align_silent(path, files, began, evidence, progress)
    last = max(began.values())
    starts = {name: round(last - time, 6) for name, time in began.items()}
    write_starts(path, starts, evidence)
    return starts


def align(
    path: Path, sounds: dict[str, np.ndarray], evidence: dict[str, SyncEvidence], progress: Progress
) -> dict[str, float]:
    """Return the start time of each sound [samples] relative to the first, in seconds. Sounds are joined in order of clarity.

    `evidence` receives what each time but the first rests on.
    """
    length = 1 << (2 * max(map(len, sounds.values())) - 1).bit_length()
    phases = {name: _phases(sound, length) for name, sound in sounds.items()}
    pairs = list(combinations(sounds, 2))
    progress.stage("comparing their sound in pairs", len(pairs))
    found: dict[tuple[str, str], Agreement] = {}
    for count, (a, b) in enumerate(pairs, 1):
        found[a, b] = agreement = _compare(phases[a], phases[b], length)
        found[b, a] = Agreement(-agreement.later, agreement.clear)
        progress.update(count)
    began = {next(iter(sounds)): 0.0}
    while len(began) < len(sounds):
        waiting = [pair for pair in found if pair[0] in began and pair[1] not in began]
        a, b = max(waiting, key=lambda pair: found[pair].clear)
        if found[a, b].clear < CLEAR:
            lost = ", ".join(name for name in sounds if name not in began)
            raise CaptureError(
                f"{path}: the sound of {lost} matches none of the others. Clap once where all cameras record it, or write into "
                f'splatreel.json when each video starts: {{"starts": {{"{b}": seconds, ...}}}}.'
            )
        began[b] = began[a] + found[a, b].later
        evidence[b] = SyncEvidence(a, "sound", round(found[a, b].clear, 2), CLEAR)
    return began


def align_silent(
    path: Path,
    files: dict[str, Path],
    began: dict[str, float],
    evidence: dict[str, SyncEvidence],
    progress: Progress,
) -> dict[str, float]:
    """Return the start times of all videos, given those of some.

    The others are joined in order of clarity. Timecodes count only where pictures tell nothing, because clocks of
    cameras that were not synchronized differ by seconds. `evidence` receives what each time rests on.
    """
    progress.stage("watching the videos, since some have no sound", len(files))
    seen = {}
    for count, (name, file) in enumerate(files.items(), 1):
        seen[name] = watch(_first_part(file))
        progress.update(count)
    began = dict(began)
    found: dict[tuple[str, str], VisibleAgreement] = {}
    while silent := [name for name in files if name not in began]:
        for a in began:
            for b in silent:
                if (a, b) not in found:
                    found[a, b] = compare_activity(seen[a], seen[b])
        a, b = max(((a, b) for a in began for b in silent), key=lambda pair: found[pair].alike * found[pair].certain)
        if not found[a, b].certain:
            timed, known = _by_timecode(files, began, silent)
            if timed:
                began |= timed
                evidence |= dict.fromkeys(timed, SyncEvidence(known, "timecode"))
                continue
            raise CaptureError(
                f"{path}: {', '.join(silent)} {'has' if len(silent) == 1 else 'have'} no sound, and no motion or flash that "
                f"tells when it starts. Flash a light once that all cameras see, or write into splatreel.json when each video "
                f'starts: {{"starts": {{"{b}": seconds, ...}}}}.'
            )
        began[b] = began[a] + found[a, b].later
        evidence[b] = SyncEvidence(a, "motion and light", round(found[a, b].clear, 2), VISIBLY_CLEAR)
    return began


def _by_timecode(files: dict[str, Path], began: dict[str, float], silent: list[str]) -> tuple[dict[str, float], str]:
    """Return the start times of silent videos by timecode, and the video that they refer to; none if they or all others lack one."""
    codes = {name: code for name, file in files.items() if (code := read_timecode(_first_part(file))) is not None}
    known = next((name for name in began if name in codes), None)
    if known is None:
        return {}, ""
    return {b: began[known] + timecode_difference(codes[known], codes[b]) for b in silent if b in codes}, known


def _first_part(file: Path) -> Path:
    """Return a video, or the first video of a folder of its parts."""
    return segment_files(file)[0] if file.is_dir() else file


def listen(file: Path) -> np.ndarray | None:
    """Return the sound of a video, or of a folder of its parts, from its first frame on, or None without sound.

    Returns:
        Sound [samples] float32 at `RATE`.
    """
    files = segment_files(file) if file.is_dir() else [file]
    names = numbered(files) if len(files) > 1 else None
    video = None if names is None else SegmentedVideo(file, names, Growth.over(file.parent))
    file = files[0] if video is None else video.written
    if not channels(file):
        return None
    rate = RATE if video is None else SOUND_RATE
    parts, count = [], 0
    for block in read_sound(file, 1, RATE) if video is None else read_packets(video.sound(), 1, 0.0):
        parts.append(block[:, 0])
        count += len(block)
        if count >= LONGEST * rate:
            break
    sound, step = np.concatenate([np.zeros(0, np.float32), *parts])[: LONGEST * rate], rate // RATE
    return sound[: len(sound) // step * step].reshape(-1, step).mean(1)


def _phases(sound: np.ndarray, length: int) -> np.ndarray:
    """Return the spectrum without amplitudes, so that sounds loud at one camera count no more than others."""
    spectrum = np.fft.rfft(sound, length)
    return (spectrum / np.maximum(np.abs(spectrum), 1e-12)).astype(np.complex64)


def _compare(a: np.ndarray, b: np.ndarray, length: int) -> Agreement:
    fit = np.fft.irfft(a * np.conj(b), length)
    best = int(fit.argmax())
    rivals = np.roll(fit, -best)
    away = round(APART * RATE)
    clear = fit[best] / max(rivals[away:-away].max(), 1e-12)
    return Agreement((best if best < length // 2 else best - length) / RATE, float(clear))
