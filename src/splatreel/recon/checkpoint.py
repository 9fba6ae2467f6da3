"""Checkpoints: plain files in DIR/work, one directory a group, written atomically, so that a run can be killed and continued."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from splatreel.errors import ReconstructionError
from splatreel.scene.gaussians import Gaussians

FIELDS = ("means", "quats", "scales", "opacities", "sh")


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays to a safetensors file; the file appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    save_file({name: np.ascontiguousarray(value) for name, value in arrays.items()}, str(part))
    os.replace(part, path)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Raises `ReconstructionError` for a file that cannot be read."""
    try:
        return load_file(str(path))
    except (OSError, SafetensorError) as error:
        raise ReconstructionError(f"{path}: cannot read this checkpoint ({error}). Delete it and run again.") from error


def pack(gaussians: Gaussians, prefix: str = "") -> dict[str, np.ndarray]:
    return {prefix + name: getattr(gaussians, name) for name in FIELDS}


def unpack(arrays: dict[str, np.ndarray], prefix: str = "") -> Gaussians:
    return Gaussians(*(arrays[prefix + name] for name in FIELDS))


def save_json(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(value, indent=1, sort_keys=True) + "\n")
    os.replace(part, path)


def load_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ReconstructionError(f"{path}: cannot read this checkpoint ({error}). Delete it and run again.") from error
