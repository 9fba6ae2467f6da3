"""Captures whose pictures are files: one source of frames for all cameras, some of which may have lens distortion."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from splatreel.capture.base import Capture, Request, read_cameras
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.lens import Lens
from splatreel.capture.soundtrack import Track
from splatreel.scene.camera import Camera


class FrameSource(Protocol):
    """Pictures of cameras by name. frames: how many time steps all of them have; fps: time steps a second."""

    fps: float

    @property
    def frames(self) -> int: ...

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Time steps first .. first + len(out) - 1 of a camera into out [count, H, W, 3] uint8, resized to H x W."""

    def sources(self, first: int, count: int) -> list[Path]:
        """The files that hold `count` time steps from `first` on."""
        ...

    def tracks(self, first: int) -> dict[str, Track]:
        """By camera, where the sound from time step `first` on is; nothing of cameras without a video."""
        ...

    def tables(self) -> dict[Path, FrameTable]:
        """Return the frame tables of its videos; nothing of pictures, or of what is still being written."""
        ...

    def close(self) -> None:
        """Release open files; reading again reopens them."""


@runtime_checkable
class GrowingSource(FrameSource, Protocol):
    """Pictures that are still being written. frames: how many time steps are whole in all cameras, so far."""

    def counts(self) -> dict[str, int]:
        """By camera, how many time steps of it are whole."""
        ...

    def waiting_for(self, name: str) -> Path:
        """The file in which a camera's next picture will be."""
        ...

    def update(self) -> None:
        """Look for what was written."""

    def settle(self) -> None:
        """Once the capture has ended: all that is there counts."""


class FileCapture(Capture):
    """A capture whose pictures are files.

    held_out: what the format holds out; the request comes first. lenses: of those cameras whose pictures are distorted.
    """

    def __init__(
        self,
        path: Path,
        cameras: list[Camera],
        source: FrameSource,
        request: Request,
        *,
        held_out: list[str],
        lenses: dict[str, Lens] | None = None,
        points: np.ndarray | None = None,
        point_colors: np.ndarray | None = None,
        near: float | None = None,
        origin: Path | None = None,
    ) -> None:
        self._source, self._lenses = source, lenses or {}
        super().__init__(
            path,
            cameras,
            held_out=held_out if request.held_out is None else request.held_out,
            frame_range=request.range(source.frames, path),
            fps=source.fps,
            points=points,
            point_colors=point_colors,
            near=near,
            origin=origin,
            growing=request.growth is not None,
            limit=request.frames[1] if request.growth is not None and request.frames is not None else None,
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        read_cameras(self._read_camera, out, first, cameras)

    def _read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        lens = self._lenses.get(name)
        if lens is None:
            self._source.read_camera(out, first, name)
            return
        bent = np.empty((len(out), lens.height, lens.width, 3), np.uint8)
        self._source.read_camera(bent, first, name)
        for t, picture in enumerate(bent):
            out[t] = lens.undistort(picture)

    @property
    def source(self) -> FrameSource:
        """Where the pictures come from."""
        return self._source

    def grow(self, available: int) -> None:
        """More time steps are whole: so many in all, from the first one of the files on."""
        self.frames = min(available, self.limit or available) - self.first_frame

    def sources(self) -> list[Path]:
        return self._source.sources(self.first_frame, self.frames)

    def frame_tables(self) -> dict[str, FrameTable]:
        return {path.relative_to(self.path).as_posix(): table for path, table in self._source.tables().items()}

    def tracks(self) -> dict[str, Track]:
        return self._source.tracks(self.first_frame)

    def close(self) -> None:
        self._source.close()
