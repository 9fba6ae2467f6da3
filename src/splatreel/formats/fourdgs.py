"""Reader of files in the container format .4dgs, by the package fourdgs. It samples continuous time.

A stream of one repeated value takes a few bytes of the file for any number of points, and a zstd frame states a size that its decoder
allocates. The package fourdgs limits each stream to half a gigabyte, but not their sum; `check_memory` limits the sum.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import read_file
from splatreel.formats.fourdgs_writer import HIGHEST, LOWEST
from splatreel.formats.splat_columns import Remarks, check_plausible, drop_nan
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians

MOST_FRAMES, MOST_BYTES = 1_000_000, 1 << 34
FPS = 30.0
_AXES = ("x", "y", "z", "-x", "-y", "-z")


class FourdgsScene:
    """Sequence of samples of a .4dgs file, at the middle of each frame.

    `fps`: Samples per second; None takes 30.

    Raises:
        GaussiansError: The file cannot be read, or takes too much memory.
    """

    antialias = False

    def __init__(self, path: Path, fps: float | None, budget: MemoryBudget = UNRAISED) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.remarks = Remarks()
        self.fps: float | None = fps or FPS
        self._scene = _read(path, budget)
        self._rate = fps or FPS
        seconds = self._scene.duration_sec
        if not (math.isfinite(seconds) and seconds >= 0):
            raise GaussiansError(f"{path}: states that it lasts {seconds:g} seconds. Export it again.")
        if seconds * self._rate > MOST_FRAMES:
            raise GaussiansError(
                f"{path}: has {seconds * self._rate:,.6g} frames at {self._rate:g} a second. Choose a lower --fps."
            )
        self._length = max(math.floor(seconds * self._rate + 1e-6), 1)
        points, self._sh = self._scene.gaussians, _harmonics(self._scene.gaussians)
        self._scales = np.asarray(points.scales, np.float32)
        if self._scene.truncated:
            self.remarks.add("The file ends early: the scene up to its damage was read", path)
        if self._scene.audio_sources:
            self.remarks.add("The sound of the file was left out", path)
        frame = self._scene.provenance.frame
        if frame is not None:
            self.remarks.add(f"The file states that {_AXES[frame.up_axis]} points up: import it with --up", path)

    def __len__(self) -> int:
        return self._length

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        state = self._scene.state_at((frame + 0.5) / self._rate)
        rows = state["indices"]
        points = Gaussians(
            means=state["centers"] - (0.0 if origin is None else origin),
            quats=rotations.normalize(np.roll(state["orientations"], 1, axis=1)),
            scales=self._scales[rows],
            opacities=np.clip(state["opacity"], 0, 1),
            sh=self._sh[rows],
        )
        return check_plausible(drop_nan(points, str(self.path), self.remarks), f"{self.path}, frame {frame}")


def _read(path: Path, budget: MemoryBudget) -> Any:
    data = read_file(path, MOST_BYTES, GaussiansError)
    try:
        import fourdgs  # pyright: ignore[reportMissingImports] - optional

        check_memory(data, str(path), budget)
        return fourdgs.read(data)
    except GaussiansError:
        raise
    except ImportError as error:
        raise GaussiansError(
            f"{path}: needs a package to be read ({error.name}). Run\n  {install_command('splats')}"
        ) from error
    except Exception as error:
        raise GaussiansError(f"{path}: is damaged, or of another version ({error!s:.100}). Export it again.") from error


def _harmonics(points: Any) -> np.ndarray:
    """Return spherical harmonics [N, (degree + 1)^2, 3] float32. The file stores red first, then green, then blue."""
    base = (np.asarray(points.colors, np.float64)[:, None, :3] - 0.5) / C0
    degree = min(int(points.sh_degree), 3) if points.sh is not None else 0
    if not degree:
        return base.astype(np.float32)
    stored = np.asarray(points.sh).reshape(len(base), 3, -1)[..., : (degree + 1) ** 2 - 1]
    rest = LOWEST + stored.transpose(0, 2, 1) * ((HIGHEST - LOWEST) / 255)
    return np.concatenate([base, rest], 1).astype(np.float32)


_STREAM = struct.Struct("<BBBBBIQ")
"""Header of a stream: attribute, width, mode, codec, channels, count, length."""
_NUMBER = 16
"""Bytes of memory per number of a stream: its symbol, and the decoded integer."""
_CODECS = {"deflate": 0, "zstd": 1}


def check_memory(data: bytes, source: str, budget: MemoryBudget) -> None:
    """Raise `GaussiansError` if reading a .4dgs file takes too much memory. Damaged files are left to their reader."""
    from fourdgs import exceptions, opcode, records, serialization  # pyright: ignore[reportMissingImports] - optional

    needed = len(data)
    try:
        for record in serialization.iter_records(data, len(serialization.MAGIC)):
            if record.opcode == opcode.SH_BAND_STREAM:
                needed += _streams_memory(bytes(record.content[1:]))
            elif record.opcode == opcode.CHUNK:
                head, block = records.parse_chunk(record.content)
                needed += points_memory(head.count) + head.uncompressed_size
                budget.check(needed, len(data), source, f"chunks of up to {head.count:,} points")
                needed += _streams_memory(_unpacked(head, bytes(block), serialization))
            budget.check(needed, len(data), source, "streams of repeated numbers")
    except GaussiansError:
        raise
    except (exceptions.FourdgsError, ValueError, struct.error):
        return


def _unpacked(head: Any, block: bytes, serialization: Any) -> bytes:
    """Return the streams of a chunk, whose size was checked."""
    codec = _CODECS.get(head.compression)
    if codec is None:
        return block
    if codec == _CODECS["zstd"] and _zstd_size(block) > head.uncompressed_size:
        raise ValueError("a zstd frame of another size")
    return serialization.decompress(block, codec, head.uncompressed_size)


def _streams_memory(block: bytes) -> int:
    """Return the bytes of memory that decoding streams takes, one after the other."""
    needed = at = 0
    while at + _STREAM.size <= len(block):
        *_, codec, channels, count, length = _STREAM.unpack_from(block, at)
        at += _STREAM.size
        needed += _NUMBER * channels * count
        if codec == _CODECS["zstd"]:
            needed += _zstd_size(block[at : at + length])
        at += length
    return needed


def _zstd_size(frame: bytes) -> int:
    """Return the size that a zstd frame states; 0 if it states none, or is damaged.

    Its reader refuses a damaged frame, or skips it if it belongs to an unknown attribute and goes on with the next chunk.
    """
    try:
        import zstandard  # pyright: ignore[reportMissingImports] - optional
    except ImportError:
        return 0
    try:
        return max(zstandard.frame_content_size(frame), 0)
    except (ValueError, zstandard.ZstdError):
        return 0
