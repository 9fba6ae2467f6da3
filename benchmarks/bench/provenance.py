"""Provenance of a measurement: version, machine and capture; and whether a reel was trained on the views."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splatreel import __version__
from splatreel.base import threads
from splatreel.base.errors import UsageError
from splatreel.capture.base import Capture
from splatreel.codec.manifest import Manifest
from splatreel.scene.camera import Camera


def label(capture: Capture, device: str) -> dict[str, Any]:
    """Return version, date, machine and load, threads, device, and name, frames, cameras and size of the capture."""
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return {
        "version": __version__,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "machine": f"{threads.available()} cores of {platform.machine()}, {platform.system()}{load}",
        "threads": threads.count(),
        "device": device,
        "capture": capture.name,
        "frames": capture.frames,
        "cameras": len(capture.training_cameras),
        "width": capture.width,
        "height": capture.height,
    }


def append(path: Path, label: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Append one JSON line per row to a file, each with the label."""
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps({**label, **row}, allow_nan=False) + "\n" for row in rows)


def check_unseen(manifest: Manifest, views: Sequence[Camera], reel: str) -> None:
    """Raise `UsageError` if the reel was trained on one of the views."""
    seen = sorted({camera.name for camera in manifest.cameras} & {view.name for view in views})
    if seen:
        raise UsageError(
            f"{reel}: was trained on {', '.join(seen)}, so they are not held out. Reconstruct without them, "
            "--hold-out NAME,NAME, or hold out what the reel has not seen."
        )
