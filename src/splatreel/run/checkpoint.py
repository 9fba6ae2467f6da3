"""Checkpoint files: arrays and JSON, written whole or not at all, so that a run can be killed and continued."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReconstructionError, SplatreelError
from splatreel.base.untrusted import read_json
from splatreel.scene.gaussians import Gaussians

T = TypeVar("T")
Arrays = dict[str, np.ndarray]
FIELDS = ("means", "quats", "scales", "opacities", "sh")
NUMBERS = (*FIELDS, "fineness", "importance", "tracks", "shades")
"""Ends of the names of arrays that never hold NaN. Other arrays use NaN for unknown values."""


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays to a safetensors file.

    Raises:
        StorageError: The disk is full or cannot be written.
    """
    write_bytes(path, save({name: np.ascontiguousarray(value) for name, value in arrays.items()}))


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a safetensors file.

    Raises:
        ReconstructionError: The file cannot be read, or holds NaN where it must not.
    """
    try:
        arrays = load_file(str(path))
    except (OSError, SafetensorError) as error:
        raise ReconstructionError(f"{path}: cannot read this checkpoint ({error}). Delete it and run again.") from error
    for name, array in arrays.items():
        if name.rpartition("_")[2] in NUMBERS and array.dtype.kind == "f" and np.isnan(array).any():
            raise ReconstructionError(
                f"{path}: {name} holds {int(np.isnan(array).sum()):,} NaN values: this checkpoint is damaged. "
                "Delete it and run again."
            )
    return arrays


def present(**arrays: np.ndarray | None) -> Arrays:
    """Return the arrays that are not None."""
    return {name: array for name, array in arrays.items() if array is not None}


def pack(gaussians: Gaussians, prefix: str = "") -> dict[str, np.ndarray]:
    """Return Gaussians as arrays. `prefix` is put before each name."""
    return {prefix + name: getattr(gaussians, name) for name in FIELDS}


def unpack(arrays: dict[str, np.ndarray], prefix: str = "") -> Gaussians:
    """Return the Gaussians that `pack` gave these arrays for."""
    return Gaussians(*(arrays[prefix + name] for name in FIELDS))


def save_json(path: Path, value: Any) -> None:
    """Write a JSON file.

    Raises:
        StorageError: The disk is full or cannot be written.
    """
    write_bytes(path, (json.dumps(value, indent=1, sort_keys=True) + "\n").encode())


def load_json(path: Path) -> Any:
    """Return the value of a JSON file.

    Raises:
        ReconstructionError: The file cannot be read.
    """
    try:
        return read_json(path, ReconstructionError)
    except ReconstructionError as error:
        raise ReconstructionError(f"{error} This checkpoint cannot be read: delete it and run again.") from error


def load_checked(path: Path, decode: Callable[[Any], T]) -> T:
    """Return the decoded value of a JSON file.

    Args:
        path: The file.
        decode: Takes the value. It may raise any error that a value of an unexpected type causes.

    Raises:
        ReconstructionError: The file cannot be read, or `decode` failed.
    """
    value = load_json(path)
    try:
        return decode(value)
    except (TypeError, ValueError, KeyError, AttributeError, IndexError, OverflowError, SplatreelError) as error:
        raise ReconstructionError(f"{path}: is damaged ({error!r:.200}). Delete the folder to start over.") from error
