"""The built-in capture: the film of a toy room by fourteen cameras, with sound, as a Neu3DV folder.

The package contains the film. `benchmarks/toyroom` of the repository traces it, and films of other sizes.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from splatreel.base.errors import CaptureError
from splatreel.base.new_folder import is_taken, new_folder
from splatreel.base.untrusted import read_json
from splatreel.capture.sidecar import SIDECAR, SIDECAR_BYTES

FILM = Path(__file__).parent / "film"


def copy_film(path: Path) -> Path:
    """Copy the film into a new folder, and return the folder. A folder that holds the film already is kept.

    Raises:
        CaptureError: `path` holds something else or cannot be written, or the package lacks the film.
    """
    recipe = film_recipe(FILM)
    if recipe is None:
        raise CaptureError(
            f"{FILM}: this installation lacks the film of the built-in capture. Install Splatreel again."
        )
    if film_recipe(path) == recipe:
        return path
    refusal = CaptureError(f"{path}: exists and is not the built-in capture. Remove it or choose another folder.")
    if is_taken(path):
        raise refusal
    try:
        with new_folder(path, refusal) as made:
            for file in FILM.iterdir():
                # Without the permissions of the package, which may be read-only.
                shutil.copyfile(file, made.path / file.name)
    except OSError as error:
        raise CaptureError(
            f"{path}: cannot be written ({error.strerror or error}). Fix the permissions or choose another folder."
        ) from error
    return path


def film_recipe(path: Path) -> dict[str, Any] | None:
    """Return the size, the number of frames and the seed of a film of the toy room; None for other folders."""
    try:
        return read_json(path / SIDECAR, CaptureError, SIDECAR_BYTES).get("made_by")
    except (CaptureError, AttributeError):
        return None
