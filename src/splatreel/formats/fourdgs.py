"""Files in the container format .4dgs, by the package fourdgs: a reader, which samples continuous time, and a writer.

The writer stores once what stays the same. A stream of one repeated value takes a few bytes of the file for any number of points, and
a zstd frame states a size that its decoder allocates. The package fourdgs limits each stream to half a gigabyte, but not their sum;
`check_memory` limits the sum.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import read_file
from splatreel.formats.registry import Film
from splatreel.formats.splat_columns import Remarks, check_plausible, drop_nan, import_for_splats
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians, turned

MOST_FRAMES, MOST_BYTES = 1_000_000, 1 << 34
FPS = 30.0
_LOWEST, _HIGHEST = -4.0, 4.0
"""Range of the bytes that store view-dependent color."""
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
    rest = _LOWEST + stored.transpose(0, 2, 1) * ((_HIGHEST - _LOWEST) / 255)
    return np.concatenate([base, rest], 1).astype(np.float32)


def write_fourdgs(path: Path, film: Film, fps: float) -> None:
    """Write the Gaussians at all times as one .4dgs file, atomically. Its y axis is up.

    Each Gaussian has a window of time in which it is shown: as long as all its values stay the same.

    Raises:
        GaussiansError: The package fourdgs is missing.
        StorageError: The file cannot be written.
    """
    fourdgs = import_for_splats("fourdgs", f"{path}: writing it")
    turn = film.placement.turn
    points, begin, end = _windows(turned(points, turn) for points in film)
    packed = io.BytesIO()
    fourdgs.write(packed, _gaussian_set(fourdgs, points, begin / fps, end / fps), len(film.seconds) / fps)
    write_bytes(path, packed.getvalue())


def _windows(frames: Iterable[Gaussians]) -> tuple[Gaussians, np.ndarray, np.ndarray]:
    """Return all distinct Gaussians of frames, the first frame that shows each, and the frame after the last, [N]."""
    done: list[tuple[Gaussians, np.ndarray, int]] = []
    shown, since, keys = Gaussians.empty(), np.zeros(0, np.int64), np.zeros(0, "S1")
    count = 0
    for frame, points in enumerate(frames):
        new_keys = _keys(points)
        _, mine, theirs = np.intersect1d(new_keys, keys, return_indices=True)
        begin = np.full(len(points), frame)
        begin[mine] = since[theirs]
        gone = np.ones(len(keys), bool)
        gone[theirs] = False
        done.append((shown[gone], since[gone], frame))
        shown, since, keys, count = points, begin, new_keys, frame + 1
    done.append((shown, since, count))
    parts = [(points, begin, end) for points, begin, end in done if len(points)]
    ends = np.concatenate([np.full(len(points), end) for points, _, end in parts])
    return Gaussians.concatenate([points for points, *_ in parts]), np.concatenate([part[1] for part in parts]), ends


def _keys(points: Gaussians) -> np.ndarray:
    """Return all values of each Gaussian as one comparable key, [N]."""
    columns = (points.means, points.quats, points.scales, points.opacities, points.sh)
    table = np.concatenate([column.reshape(len(points), -1) for column in columns], 1)
    return np.ascontiguousarray(table).view(f"S{table.shape[1] * 4}").ravel()


def _gaussian_set(fourdgs: Any, points: Gaussians, begin: np.ndarray, end: np.ndarray) -> Any:
    """Return Gaussians with windows of time, in seconds, as fourdgs has them."""
    rest = points.sh[:, 1:].transpose(0, 2, 1).reshape(len(points), -1)
    stored = np.rint(np.clip((rest - _LOWEST) / (_HIGHEST - _LOWEST), 0, 1) * 255).astype(np.uint8)
    color = np.concatenate([np.clip(points.base_colors, 0, 1), points.opacities[:, None]], 1)
    return fourdgs.GaussianSet(
        positions=points.means,
        scales=points.scales,
        rotations=np.roll(points.quats, -1, axis=1),
        colors=color.astype(np.float32),
        motions=np.zeros_like(points.means),
        mu_t=((begin + end) / 2).astype(np.float32),
        sigma_t=np.full(len(points), np.inf, np.float32),
        win_lo=begin.astype(np.float64),
        win_hi=end.astype(np.float64),
        sh=stored if points.sh_degree else None,
        sh_degree=points.sh_degree,
    )


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
