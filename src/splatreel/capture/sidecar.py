"""The sidecar `splatreel.json` in a capture's folder, with facts that its videos do not contain."""

from __future__ import annotations

import json
from collections.abc import Container, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import is_number, read_json
from splatreel.capture.color import TRANSFERS

SIDECAR = "splatreel.json"
SIDECAR_BYTES = 1 << 20
SLOW, FAST = 0.9, 1.1
"""Speeds of clocks that are accepted. Videos that play at another speed have another `fps`."""


@dataclass(frozen=True)
class SyncEvidence:
    """Evidence of the start time of a video.

    Attributes:
        other: Camera whose video it was aligned with.
        by: "sound", "motion and light" or "timecode".
        clear: Ratio of the alignment to its best rival; None for a timecode.
        needed: Smallest ratio that is accepted.
    """

    other: str
    by: str
    clear: float | None = None
    needed: float | None = None

    def __str__(self) -> str:
        scores = ""
        if self.clear is not None and self.needed is not None:
            scores = f": fits {self.clear:.1f} times as well as at any other time ({self.needed:g} is needed)"
        return f"by {self.by} with {self.other}{scores}"


@dataclass(frozen=True)
class Sidecar:
    """Content of `splatreel.json`.

    Attributes:
        starts: Time in each video, in seconds, at which all cameras start; 0 for cameras without an entry.
        rates: Seconds that a video's clock shows in a second of the capture; 1 for cameras without an entry.
        sync: What `capture sync` found start times by, by camera. It only informs.
        transfer: Transfer function of videos that declare none: "sdr", "hlg" or "pq".
        failure: Reason why `capture calibrate` failed.
    """

    held_out: list[str] | None = None
    fps: float | None = None
    starts: dict[str, float] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    sync: dict[str, SyncEvidence] = field(default_factory=dict)
    transfer: str | None = None
    failure: str | None = None

    def only(self, names: Container[str]) -> Sidecar:
        """Return the sidecar without the clocks of other cameras."""
        starts = {name: start for name, start in self.starts.items() if name in names}
        return replace(self, starts=starts, rates={name: rate for name, rate in self.rates.items() if name in names})


def read_sidecar(folder: Path) -> Sidecar:
    """Return the sidecar of a folder; empty if there is none. Raise `CaptureError` for invalid content."""
    file = folder / SIDECAR
    with _naming(file):
        content = _content(file)
        held_out, fps, starts = content.get("held_out"), content.get("fps"), content.get("starts", {})
        if "held_out" in content and not (isinstance(held_out, list) and all(isinstance(n, str) for n in held_out)):
            raise ValueError(f"held_out is {held_out!r:.100}, expected a list of camera names")
        if "fps" in content and not (is_number(fps) and fps > 0):
            raise ValueError(f"fps is {fps!r:.100}, expected a positive number")
        if not isinstance(starts, dict) or not all(is_number(s) and s >= 0 for s in starts.values()):
            raise ValueError(f"starts is {starts!r:.100}, expected seconds of 0 or more by camera")
        rates = content.get("rates", {})
        if not isinstance(rates, dict) or not all(is_number(r) and SLOW <= r <= FAST for r in rates.values()):
            raise ValueError(f"rates is {rates!r:.100}, expected numbers of {SLOW} to {FAST} by camera")
        transfer = content.get("transfer")
        if "transfer" in content and not (isinstance(transfer, str) and transfer in TRANSFERS):
            raise ValueError(f"transfer is {transfer!r:.100}, expected one of {', '.join(TRANSFERS)}")
        failure = content.get("calibration_failed")
        if failure is not None and not isinstance(failure, str):
            raise ValueError(f"calibration_failed is {failure!r:.100}, expected a sentence")
        return Sidecar(held_out, fps, starts, rates, _sync(content.get("sync", {})), transfer, failure)


def _sync(content: Any) -> dict[str, SyncEvidence]:
    """Return the evidence of start times. Raise `ValueError` for other content."""
    if not isinstance(content, dict):
        raise ValueError(f"sync is {content!r:.100}, expected the evidence by camera")
    found = {}
    for name, entry in content.items():
        known = entry if isinstance(entry, dict) else {}
        other, by, clear, needed = (known.get(key) for key in ("other", "by", "clear", "needed"))
        numbers = all(number is None or is_number(number) for number in (clear, needed))
        if not (isinstance(other, str) and isinstance(by, str) and numbers):
            raise ValueError(f"sync of {name} is {entry!r:.100}, expected what `capture sync` writes")
        found[name] = SyncEvidence(other, by, clear, needed)
    return found


def write_starts(
    folder: Path, starts: dict[str, float], evidence: dict[str, SyncEvidence], rates: dict[str, float] | None = None
) -> None:
    """Record the start time and the clock's rate of each video, and keep the other entries.

    Raises:
        CaptureError: The file is not a JSON object.
    """
    known = {name: asdict(found) for name, found in evidence.items()}
    _change(folder, {"starts": starts, "rates": rates or None, "sync": known or None})


def write_failure(folder: Path, why: str | None) -> None:
    """Record why calibration failed, or remove the entry with None. Other entries are kept."""
    if why is not None or read_sidecar(folder).failure is not None:
        _change(folder, {"calibration_failed": why})


def calibration_error(folder: Path) -> CaptureError | None:
    """Return the error for a folder without cameras after a failed `capture calibrate`, or None."""
    why = read_sidecar(folder).failure
    return None if why is None else CaptureError(f"{folder}: has no cameras, since their calibration failed: {why}")


def _change(folder: Path, changes: dict[str, Any]) -> None:
    """Change entries; None removes one. An empty file is deleted."""
    file = folder / SIDECAR
    with _naming(file):
        content = {name: value for name, value in (_content(file) | changes).items() if value is not None}
        if not content:
            file.unlink(missing_ok=True)
            return
    write_bytes(file, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: {error}. Correct it or remove it.") from error


def _content(file: Path) -> dict[str, Any]:
    if not file.is_file():
        return {}
    content = read_json(file, CaptureError, SIDECAR_BYTES)
    if not isinstance(content, dict):
        raise ValueError("is not a JSON object")
    return content
