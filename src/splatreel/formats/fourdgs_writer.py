"""Writer of films of Gaussians in the container format .4dgs.

A row of a file is a Gaussian that moves at constant velocity within a window of time. The writer divides the path of each Gaussian into
as few rows as its tolerances allow, and writes the rows of a Gaussian one after the other, so that what stays the same costs almost
nothing. The model `keyframe-delta` of the format would restate less, but its reader has no view-dependent color.

Source:
    Specification of 4dgs, sections 3, 5 and 6. Paths are divided by the swing filter (Elmeleegy et al., Online Piece-wise Linear
    Approximation of Numerical Streams with Precision Guarantees, VLDB 2009).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.formats.registry import Film
from splatreel.formats.splat_columns import import_for_splats
from splatreel.scene.gaussians import C0, Gaussians, turned

LOWEST, HIGHEST = -4.0, 4.0
"""Range of the bytes that store view-dependent color."""
_POSITION, _ROTATION, _SCALE, _OPACITY, _COLOR = 0.2, 0.02, 0.02, 0.1, 0.05
"""Largest distance of a row from the Gaussian, in middle scales of the Gaussian, and largest differences of quaternions, logarithms of
scales, opacities and spherical harmonics."""
_RGB_BOUND, _ALPHA_BOUND = 1.5 / 255, 3 / 255
"""Half the steps of colors and opacities. They differ from those of fourdgs' profile "default", whose others are taken."""
_DEGREE = 3
_ENOUGH = 0.01
"""Share of rows whose view-dependent color must be stronger than a step for a band to be written, as for a mirror in a room."""
_LEVEL = 9
_COEFFICIENTS = {1: slice(0, 3), 2: slice(3, 8), 3: slice(8, 15)}
"""Spherical harmonics of each band, without the constant one."""


@dataclass
class _Rows:
    """Rows of a file. Times are in frames.

    Attributes:
        ids: Numbers of the Gaussians, [N].
        begin: First frame, [N].
        end: Frame after the last one, [N].
        points: Gaussians at the first frame.
        low: Lowest velocity that fits all frames, [N, 3] in world units per frame.
        high: Highest velocity, [N, 3].
        sums: Sums over the frames of quaternion, opacity and constant color, [N, 8].
    """

    ids: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    points: Gaussians
    low: np.ndarray
    high: np.ndarray
    sums: np.ndarray

    @classmethod
    def start(cls, points: Gaussians, ids: np.ndarray, frame: int) -> _Rows:
        """Return rows that begin at a frame."""
        free = np.full((len(points), 3), np.inf)
        begin = np.full(len(points), frame)
        return cls(ids, begin, begin + 1, points, -free, free, _averaged(points))

    @classmethod
    def concatenate(cls, parts: list[_Rows]) -> _Rows:
        """Join rows."""
        points = Gaussians.concatenate([part.points for part in parts])
        joined = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(cls)
            if field.name != "points"
        }
        return cls(points=points, **joined)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.ids)

    def __getitem__(self, index: np.ndarray) -> _Rows:
        """Return some rows, by a mask or numbers."""
        return _Rows(*(getattr(self, field.name)[index] for field in fields(self)))

    def extend(self, points: Gaussians) -> np.ndarray:
        """Let the rows pass through the Gaussians of the frame that follows, [N], where these are near enough.

        Returns:
            [N] bool: which were near enough. The others are as before.
        """
        first, age = self.points, (self.end - self.begin)[:, None]
        reach = _POSITION * np.median(points.scales, axis=1, keepdims=True)
        way = points.means.astype(np.float64) - first.means
        low, high = np.maximum(self.low, (way - reach) / age), np.minimum(self.high, (way + reach) / age)
        now = _averaged(points)
        now[:, :4] *= np.where(np.sum(now[:, :4] * self.sums[:, :4], axis=1, keepdims=True) < 0, -1, 1)
        away = np.abs(now - self.sums / age)
        near = (
            (low <= high).all(1)
            & (away[:, :4] < _ROTATION).all(1)
            & (away[:, 4] < _OPACITY)
            & (away[:, 5:] < _COLOR).all(1)
            & (np.abs(np.log(points.scales / first.scales)) < _SCALE).all(1)
            & (np.abs(points.sh[:, 1:] - first.sh[:, 1:]) < _COLOR).all((1, 2))
        )
        self.low[near], self.high[near] = low[near], high[near]
        self.sums[near] += now[near]
        self.end[near] += 1
        return near


def _averaged(points: Gaussians) -> np.ndarray:
    """Return the values that a row holds as averages, [N, 8]."""
    return np.concatenate([points.quats, points.opacities[:, None], points.sh[:, 0]], 1).astype(np.float64)


def write_fourdgs(path: Path, film: Film, fps: float) -> None:
    """Write the Gaussians at all times as one .4dgs file, atomically. Its y axis is up.

    A frame is shown from its time to that of the next one, and a row is exact in the middle between the two.

    Raises:
        GaussiansError: The package fourdgs is missing.
        StorageError: The file cannot be written.
    """
    import_for_splats("fourdgs", f"{path}: writing it")
    turn = film.placement.turn
    frames = (film.identified(seconds) for seconds in film.seconds)
    rows = _divide((turned(points, turn).at_degree(_DEGREE), ids) for points, ids in frames)
    write_bytes(path, _Encoder(rows, fps, len(film.seconds)).file())


def _divide(frames: Iterable[tuple[Gaussians, np.ndarray]]) -> _Rows:
    """Return the rows that show the Gaussians of all frames, which come with their ids."""
    done = list[_Rows]()
    live = _Rows.start(Gaussians.empty(_DEGREE), np.zeros(0, np.int64), 0)
    for frame, (points, ids) in enumerate(frames):
        _, mine, theirs = np.intersect1d(ids, live.ids, return_indices=True)
        rest = np.ones(len(live), bool)
        rest[theirs] = False
        done.append(live[rest])
        live = live[theirs]
        near = live.extend(points[mine])
        done.append(live[~near])
        new = np.ones(len(ids), bool)
        new[mine[near]] = False
        live = _Rows.concatenate([live[near], _Rows.start(points[new], ids[new], frame)])
    return _Rows.concatenate([part for part in [*done, live] if len(part)])


class _Encoder:
    """Content of a file."""

    def __init__(self, rows: _Rows, fps: float, frames: int) -> None:
        from fourdgs import quantization  # pyright: ignore[reportMissingImports] - optional

        points = rows.points
        self._rows, self._fps, self._frames = rows, fps, frames
        self._bounds = quantization.Bounds.for_profile("default", median_scale=float(np.median(points.scales)))
        self._bounds.rgb, self._bounds.alpha, self._bounds.time = _RGB_BOUND, _ALPHA_BOUND, 0.25 / fps
        self._steps = quantization.Steps.of(self._bounds)
        self._origin = points.means.min(0).astype(np.float64)
        self._degree = _degree(points.sh[:, 1:])
        self._windows, window = np.unique(np.stack([rows.begin, rows.end], 1), axis=0, return_inverse=True)
        self._window = window.reshape(-1)

    def file(self) -> bytes:
        """Return the whole file."""
        from fourdgs import records, serialization  # pyright: ignore[reportMissingImports] - optional

        rows = self._rows
        parts = [serialization.MAGIC, *self._head()]
        at, index = sum(map(len, parts)), b""
        for chosen in self._chunks():
            t0, t1 = (float(time / self._fps) for time in (rows.begin[chosen].min(), rows.end[chosen].max()))
            chunk = records.encode_chunk(t0, t1, 0, len(chosen), self._streams(rows[chosen], self._window[chosen]))
            entry = records.ChunkIndexEntry(t0, t1, at, len(chunk), len(chosen))
            parts.append(chunk)
            at += len(chunk)
            for band, record in self._bands(rows[chosen]):
                entry.bands.append((band, at, len(record)))
                parts.append(record)
                at += len(record)
            index += entry.encode()
        footer = records.Footer(summary_start=at, summary_offset_start=0, summary_crc=serialization.crc32(index))
        return b"".join([*parts, index, footer.encode(), serialization.MAGIC])

    def _head(self) -> list[bytes]:
        """Return the records in front of the chunks."""
        from fourdgs import records  # pyright: ignore[reportMissingImports] - optional

        means = self._rows.points.means
        header = records.Header(
            duration_sec=self._frames / self._fps,
            gaussian_count=len(means),
            aabb=[*means.min(0).tolist(), *means.max(0).tolist()],
            profile="",
            library="splatreel",
            temporal_model="gaussian-birth",
            cutoff=0.05,
            sh_degree=self._degree,
            flags=0,
            attributes={"visibility_profile": "box"},
        )
        steps = {f"step_{name}": value for name, value in asdict(self._steps).items()}
        origin, bounds = self._origin.tolist(), self._bounds.as_strings()
        quantization = records.Quantization("uniform-v1", origin, **steps, bounds=bounds)
        windows = records.WindowTable([(float(begin), float(end)) for begin, end in self._windows / self._fps])
        return [header.encode(), quantization.encode(), windows.encode()]

    def _chunks(self) -> Iterator[np.ndarray]:
        """Yield the numbers of the rows of each chunk: those that begin in the same second, apart from those that last longer."""
        from fourdgs import quantization  # pyright: ignore[reportMissingImports] - optional

        rows, second = self._rows, max(round(self._fps), 1)
        _, first, which = np.unique(rows.ids, return_index=True, return_inverse=True)
        place = np.empty(len(first), np.int64)
        place[quantization.morton_order(rows.points.means[first])] = np.arange(len(first))
        part = 2 * (rows.begin // second) + (rows.end - rows.begin <= second)
        order = np.lexsort((rows.begin, place[which.reshape(-1)], part))
        yield from np.split(order, np.flatnonzero(np.diff(part[order])) + 1)

    def _streams(self, rows: _Rows, windows: np.ndarray) -> bytes:
        """Return the attributes of a chunk."""
        from fourdgs import opcode, quantization  # pyright: ignore[reportMissingImports] - optional

        steps, points, n = self._steps, rows.points, len(rows)
        length = rows.end - rows.begin
        classes = quantization.life_class(np.zeros(n), steps.sigma_log, np.ones(n, bool), length / self._fps)
        pitch = quantization.motion_steps(classes, steps.motion)[:, None]
        moves = (rows.low > 0) | (rows.high < 0)
        velocity = (np.where(moves, rows.low, 0) + np.where(moves, rows.high, 0)) / 2
        mean = rows.sums / length[:, None]
        largest, rest = quantization.quantize_rotation(np.roll(mean[:, :4], -1, axis=1), steps.rot)
        color = np.clip(mean[:, 5:] * C0 + 0.5, 0, 1)
        zero = np.zeros(n, np.int64)
        streams = {
            opcode.A_POSITION: quantization.quantize(points.means, steps.pos, self._origin),
            opcode.A_SCALE: quantization.quantize(np.log(points.scales), steps.scale_log),
            opcode.A_ROTATION_INDEX: largest,
            opcode.A_ROTATION: rest,
            opcode.A_COLOR: quantization.rct_forward(quantization.quantize(color, steps.rgb)),
            opcode.A_OPACITY: quantization.quantize(np.clip(mean[:, 4], 0, 1), steps.alpha),
            opcode.A_MOTION: quantization.quantize(velocity * self._fps / pitch, 1.0),
            opcode.A_MU_T: 2 * rows.begin + 1,
            opcode.A_SIGMA_T: zero,
            opcode.A_FLAGS: zero + opcode.FLAG_NEVER_FADES,
            opcode.A_WINDOW_INDEX: windows,
        }
        return b"".join(_stream(name, values) for name, values in streams.items())

    def _bands(self, rows: _Rows) -> Iterator[tuple[int, bytes]]:
        """Yield the bands of view-dependent color of a chunk, each a record."""
        from fourdgs import opcode, serialization  # pyright: ignore[reportMissingImports] - optional

        for band in range(1, self._degree + 1):
            sh = rows.points.sh[:, 1:][:, _COEFFICIENTS[band]].transpose(0, 2, 1).reshape(len(rows), -1)
            stream = _stream(opcode.SH_BAND_STREAM, _bytes(sh, rows.ids))
            yield band, serialization.put_record(opcode.SH_BAND_STREAM, bytes([band]) + stream)


def _stream(name: int, values: np.ndarray) -> bytes:
    from fourdgs import serialization  # pyright: ignore[reportMissingImports] - optional

    table = values.reshape(len(values), -1)
    return serialization.encode_stream(name, table, channels=table.shape[1], level=_LEVEL)


def _bytes(sh: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Return spherical harmonics [N, C] as bytes.

    Zero is between two bytes, and rounding would shift the colors of all Gaussians the same way. The error of a Gaussian is
    passed on to the next one, which is near it. Rows of the same Gaussian that follow each other get the same bytes.
    """
    changes = np.ones(len(sh), bool)
    changes[1:] = (ids[1:] != ids[:-1]) | (sh[1:] != sh[:-1]).any(1)
    exact = (np.clip(sh[changes].astype(np.float64), LOWEST, HIGHEST) - LOWEST) * (255 / (HIGHEST - LOWEST))
    stored = np.clip(np.diff(np.rint(np.cumsum(exact, axis=0)), axis=0, prepend=0), 0, 255).astype(np.int64)
    return stored[np.cumsum(changes) - 1]


def _degree(sh: np.ndarray) -> int:
    """Return the highest band in which enough Gaussians differ from zero by a step. `sh`: [N, 15, 3], the constant one left out."""
    strong = np.abs(sh) > (HIGHEST - LOWEST) / 255
    needed = [band for band, of_band in _COEFFICIENTS.items() if strong[:, of_band].any((1, 2)).mean() > _ENOUGH]
    return max(needed, default=0)
