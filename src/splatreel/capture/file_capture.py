"""Captures whose images come from files, some with lens distortion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture, Request, read_cameras
from splatreel.capture.capture_sound import Track
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.images import same_shape
from splatreel.capture.lens import Lens, describe_crops
from splatreel.scene.camera import Camera

NEARLY = 0.15
"""Maximum relative difference of sizes between which images were probably cropped, as by undistortion, and not resized."""


class FrameSource(Protocol):
    """Images of cameras by name.

    Attributes:
        fps: Time steps per second.
        frames: Number of time steps.
        notes: Sentences about what was chosen or skipped.
    """

    fps: float
    notes: list[str]

    @property
    def frames(self) -> int:
        """Number of time steps."""
        ...

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images.

        Args:
            name: Name of the camera.
            calibrated: Width and height of its calibration. A source may use them to choose an orientation.
        """
        ...

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        ...

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8, resized to H x W.

        Raises:
            CaptureError: An image has another size than the camera's first one.
        """

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the time steps for which a camera has no image. A nearby image stands in for it."""
        ...

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that hold `count` time steps from `first` on."""
        ...

    def tracks(self, first: int) -> dict[str, Track]:
        """Return the sound from time step `first` on by camera, for cameras with videos."""
        ...

    def tables(self) -> dict[Path, FrameTable]:
        """Return the frame tables of complete videos."""
        ...

    def close(self) -> None:
        """Close open files. A later read opens them again."""


@runtime_checkable
class GrowingSource(FrameSource, Protocol):
    """Images that are still being written. `frames` counts the time steps complete in all cameras so far."""

    def counts(self) -> dict[str, int]:
        """Return the number of complete time steps by camera."""
        ...

    def waiting_for(self, name: str) -> Path:
        """Return the file that will hold a camera's next image."""
        ...

    def failure(self, name: str) -> str | None:
        """Return the reason why no more images of a camera will be read; None while there is none."""
        ...

    def update(self) -> None:
        """Check for new images."""

    def settle(self) -> None:
        """Count everything that exists, after the capture has ended."""


class FileCapture(Capture):
    """Capture whose images come from files.

    Args:
        path: Folder of the capture.
        cameras: All cameras, at the output size.
        source: Source of the images.
        request: Options; its held-out cameras take precedence.
        held_out: Default of the format.
        lenses: Lenses of cameras with distortion.
        points: Sparse points, [P, 3] float32.
        point_colors: Their colors, [P, 3] float32 0..1.
        near: Near bound, world units.
        origin: File or folder of the poses.
        notes: Sentences about the reader's choices.
        calibrated: Width and height of the calibration by camera. By default, those at which a camera is read.

    Raises:
        CaptureError: A camera's images have another aspect ratio than its calibration.
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
        notes: Sequence[str] = (),
        calibrated: dict[str, tuple[int, int]] | None = None,
    ) -> None:
        kept = request.kept(cameras, path)
        self._source = source
        self._lenses = {camera.name: lenses[camera.name] for camera in kept if lenses and camera.name in lenses}
        held_out = [name for name in held_out if name not in request.left_out]
        sizes = self._check_shapes(path, kept, calibrated or {})
        super().__init__(
            path,
            kept,
            held_out=held_out if request.held_out is None else request.held_out,
            frame_range=request.range(source.frames, path),
            fps=source.fps,
            points=points,
            point_colors=point_colors,
            near=near,
            origin=origin,
            growing=request.growth is not None,
            limit=request.frames[1] if request.growth is not None and request.frames is not None else None,
            notes=[*notes, *sizes, *describe_crops(self._lenses), *source.notes, *source.conversions()],
        )
        self.left_out = tuple(request.left_out)

    def _check_shapes(self, path: Path, cameras: list[Camera], calibrated: dict[str, tuple[int, int]]) -> list[str]:
        """Check the first image of every camera. Sources check that its other images have the same size.

        Returns:
            Sentences about images that are nearly, but not exactly, as large as their calibration.
        """
        nearly: dict[tuple[tuple[int, int], tuple[int, int]], list[str]] = {}
        for camera in cameras:
            read_at = self._lenses.get(camera.name, camera)
            expected = calibrated.get(camera.name, (read_at.width, read_at.height))
            found = self._source.size(camera.name, expected)
            if not same_shape(found, expected):
                turned = same_shape(found, (expected[1], expected[0]))
                raise CaptureError(
                    f"{path}: camera {camera.name} is calibrated for {expected[0]}x{expected[1]}, but its images are "
                    f"{found[0]}x{found[1]}, {'turned by a quarter' if turned else 'another aspect ratio'}. "
                    f"{'Turn' if turned else 'Crop'} them as for the calibration, or calibrate again."
                )
            differs = max(abs(found[0] - expected[0]), abs(found[1] - expected[1])) > 1  # not only by rounding
            if differs and abs(found[0] / expected[0] - 1) <= NEARLY:
                nearly.setdefault((found, expected), []).append(camera.name)
        return [self._describe_scaling(*sizes, names) for sizes, names in nearly.items()]

    def _describe_scaling(self, found: tuple[int, int], expected: tuple[int, int], names: list[str]) -> str:
        whose = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]} ({len(names)} cameras)"
        text = (
            f"the images of {whose} are {found[0]}x{found[1]}, and their calibration is for {expected[0]}x{expected[1]}: they are "
            f"scaled by {expected[0] / found[0]:.3f}"
        )
        if all(name in self._lenses for name in names):
            return f"{text}. If they were cropped instead, crop them as for the calibration"
        return (
            f"{text}. That is right only if both show the same. If the calibration is of undistorted images, which are cropped, these "
            f"images still have the distortion of the lens: undistort them in the same way, or calibrate from them"
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        read_cameras(self._read_camera, out, first, cameras)

    def _read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        self.read_undistorted(self._source.read_camera, out, first, name)

    def read_undistorted(
        self, read: Callable[[np.ndarray, int, str], None], out: np.ndarray, first: int, name: str
    ) -> None:
        """Read images of a camera and remove its lens distortion.

        Args:
            read: Function like `FrameSource.read_camera`.
            out: Receives the images [count, H, W, 3] uint8.
            first: First time step, counted from the first one of the files.
            name: Name of the camera.
        """
        lens = self._lenses.get(name)
        if lens is None:
            read(out, first, name)
            return
        bent = np.empty((len(out), lens.height, lens.width, 3), np.uint8)
        read(bent, first, name)
        for t, image in enumerate(bent):
            out[t] = lens.undistort(image)

    def _missing(self, first: int, count: int, name: str) -> np.ndarray:
        return self._source.missing(first, count, name)

    @property
    def source(self) -> FrameSource:
        """Source of the images."""
        return self._source

    def read_any(self, first: int, count: int, cameras: list[str]) -> np.ndarray:
        """Return the images [count, len(cameras), H, W, 3] uint8 of time steps that count from the first one of the files.

        The time steps may be outside of the frame range.
        """
        out = np.empty((count, len(cameras), self.height, self.width, 3), np.uint8)
        self._read_into(out, first, cameras)
        return out

    def grow(self, available: int) -> None:
        """Update the number of complete time steps, counted from the first one of the files."""
        self.frames = min(available, self.limit or available) - self.first_frame

    def sources(self) -> list[Path]:
        """Return the files that are read."""
        return self._source.sources(self.first_frame, self.frames)

    def frame_tables(self) -> dict[str, FrameTable]:
        """Return the frame tables of the videos."""
        return {path.relative_to(self.path).as_posix(): table for path, table in self._source.tables().items()}

    def tracks(self) -> dict[str, Track]:
        """Return the sound by camera."""
        return self._source.tracks(self.first_frame)

    def close(self) -> None:
        """Close open files."""
        self._source.close()
