"""`splatreel.json` in a capture's folder: what its videos do not say."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from splatreel.errors import CaptureError
from splatreel.scene.atomic import write_bytes

SIDECAR = "splatreel.json"


@dataclass(frozen=True)
class Sidecar:
    """held_out: names of cameras kept for evaluation. fps: frames a second. starts: by camera, the second of its own video at which
    all of them start; a camera that is not named starts with its video."""

    held_out: list[str] | None = None
    fps: float | None = None
    starts: dict[str, float] = field(default_factory=dict)


def read_sidecar(folder: Path) -> Sidecar:
    """What the note in a folder says; nothing where there is none. Raises `CaptureError` for one that says what cannot be."""
    file = folder / SIDECAR
    with _naming(file):
        content = _content(file)
        held_out, fps, starts = content.get("held_out"), content.get("fps"), content.get("starts", {})
        if "held_out" in content and not (isinstance(held_out, list) and all(isinstance(n, str) for n in held_out)):
            raise ValueError(f"held_out is {held_out!r:.100}, expected a list of camera names")
        if "fps" in content and not (_is_number(fps) and fps > 0):
            raise ValueError(f"fps is {fps!r:.100}, expected a positive number")
        if not isinstance(starts, dict) or not all(_is_number(s) and s >= 0 for s in starts.values()):
            raise ValueError(f"starts is {starts!r:.100}, expected seconds of 0 or more by camera")
        return Sidecar(held_out, fps, starts)


def write_starts(folder: Path, starts: dict[str, float]) -> None:
    """Note when each video starts; what else the note says stays. Raises `CaptureError` for a note that is no JSON object."""
    file = folder / SIDECAR
    with _naming(file):
        content = _content(file)
    write_bytes(file, (json.dumps(content | {"starts": starts}, indent=1) + "\n").encode())


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    """What is wrong with a note is said with its name."""
    try:
        yield
    except (OSError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: {error}. Correct it or remove it.") from error


def _content(file: Path) -> dict[str, Any]:
    if not file.is_file():
        return {}
    content = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise ValueError("is not a JSON object")
    return content


def _is_number(value: object) -> TypeGuard[float]:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and -1e300 < value < 1e300
    )  # an int may be any
