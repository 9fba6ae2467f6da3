"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from splatreel.errors import GaussiansError


def write_bytes(path: Path, data: bytes) -> None:
    """Write under a temporary name and move into place. Raises `GaussiansError` if the file cannot be written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise GaussiansError(
            f"{path}: could not be written ({error.strerror}). Free space or choose a path."
        ) from error
