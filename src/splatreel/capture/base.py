"""Common interface of all capture formats."""

from __future__ import annotations

import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base import threads
from splatreel.base.errors import CaptureError
from splatreel.capture.capture_sound import Track
from splatreel.capture.files import LOCAL, Files
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growth import Growth
from splatreel.capture.pose_checks import validate_poses
from splatreel.scene.camera import Camera
from splatreel.scene.reel_source import ReelSource

Color = tuple[float, float, float]
"""Red, green and blue, 0..1."""
SLOWEST, FASTEST = 1e-3, 1e5
"""Supported frame rates of a reel."""
WIDEST = 16384
"""Maximum image width and height in pixels."""
MIN_CAMERAS = 3
"""Fewer cameras do not determine the geometry of a scene."""
LAYOUTS = {
    "Calibrated": "another program's calibration",
    "Colmap": "COLMAP",
    "Panoptic": "Panoptic Sports",
    "Transforms": "transforms.json",
}
"""Names of layouts that differ from the names of their readers' classes."""
FAR_OFF = 1e4
"""A camera has a broken pose if it is this many times farther from the others than they are apart."""


@dataclass(frozen=True)
class Request:
    """Options of a capture that do not depend on its format.

    Attributes:
        width: Output width in pixels.
        scale: Output size over input size. Without width and scale the input size is kept.
        frames: First frame and end (exclusive); None means all frames.
        held_out: Names of held-out cameras; None uses the format's default.
        growth: State of a capture that is still being written. The end of its frames may be in the future.
        left_out: Names of cameras that are not read at all.
    """

    width: int | None = None
    scale: float | None = None
    frames: tuple[int, int] | None = None
    held_out: list[str] | None = None
    growth: Growth | None = None
    files: Files = LOCAL
    """Access to the videos and images."""
    tables: dict[str, FrameTable] = field(default_factory=dict)
    """Known frame tables of videos by paths within the capture. Other videos are scanned."""
    left_out: frozenset[str] = frozenset()

    def size(self, width: int, height: int, path: Path) -> tuple[int, int]:
        """Return output width and height for an input size, with the same aspect ratio."""
        if self.width is not None and self.scale is not None:
            raise CaptureError(f"{path}: both width {self.width} and scale {self.scale} were given; give one of them.")
        if self.width is not None and not 1 <= self.width <= WIDEST:
            raise CaptureError(f"{path}: cannot be read {self.width} pixels wide; choose a width of 1 to {WIDEST}.")
        scale = self.width / width if self.width is not None else self.scale if self.scale is not None else 1.0
        if not 0 < scale < math.inf:
            raise CaptureError(f"{path}: cannot be resized by {scale}; width and scale must be positive numbers.")
        out = round(width * scale), round(height * scale)
        if max(out) > WIDEST:
            raise CaptureError(
                f"{path}: {width}x{height} cannot be resized to {out[0]}x{out[1]}, more than {WIDEST} pixels; ask for less."
            )
        if min(out) < 1:
            raise CaptureError(
                f"{path}: {width}x{height} cannot be resized to {out[0]}x{out[1]}; ask for a larger size."
            )
        return out

    def kept(self, cameras: list[Camera], path: Path) -> list[Camera]:
        """Return the cameras that are not left out. Raise `CaptureError` for a name that none of them has."""
        names = [camera.name for camera in cameras]
        if unknown := sorted(self.left_out - set(names)):
            raise CaptureError(
                f"{path}: there is no camera {unknown[0]!r} to leave out; the cameras are {', '.join(names)}."
            )
        return [camera for camera in cameras if camera.name not in self.left_out]

    def range(self, available: int, path: Path) -> tuple[int, int]:
        """Return the first frame and the end to read from a capture with `available` frames."""
        first, end = self.frames if self.frames is not None else (0, available)
        if self.growth is not None:
            end = min(end, available)
        if not 0 <= first < end <= available:
            raise CaptureError(
                f"{path}: frames {first}:{end} were asked for, the capture has frames 0:{available}. "
                f"Choose 0 <= first < end <= {available}."
            )
        return first, end


class Capture(ABC):
    """Synchronized images of static cameras.

    Attributes:
        cameras: All cameras, at the output size.
        held_out: Names of held-out cameras.
        frames: Number of time steps within the frame range.
        fps: Time steps per second.
        points: Sparse points of the first frame, [P, 3] float32, or None.
        point_colors: Their colors, [P, 3] float32 0..1, or None.
        near: Reliable near bound of the format in world units, or None.
        origin: File or folder of the poses.
        doubts: Sentences about doubtful poses.
        notes: Sentences about what was chosen or skipped where the files leave a choice.
        left_out: Names of cameras that are not read.
        growing: True while the capture is still being written. `frames` then grows up to `limit`.
        limit: End of the frames of a growing capture, or None.
        unmasked: Names of cameras whose subject is not known, in a capture of a subject.
    """

    unmasked: Sequence[str] = ()

    def __init__(
        self,
        path: Path,
        cameras: list[Camera],
        *,
        held_out: list[str],
        frame_range: tuple[int, int] = (0, 1),
        fps: float = 30.0,
        points: np.ndarray | None = None,
        point_colors: np.ndarray | None = None,
        near: float | None = None,
        origin: Path | None = None,
        growing: bool = False,
        limit: int | None = None,
        notes: Sequence[str] = (),
    ) -> None:
        self.notes = list(notes)
        self.left_out = tuple[str, ...]()
        self.path = Path(path)
        self.growing = growing
        self.limit = limit
        self.origin = self.path if origin is None else origin
        self.name = self.path.resolve().name
        self.cameras = cameras
        self.held_out = list(held_out)
        self.first_frame, end = frame_range
        self.frames = end - self.first_frame
        self.fps = float(fps)
        self.points = points
        self.point_colors = point_colors
        self.near = near
        self._check()

    def _check(self) -> None:
        names = [c.name for c in self.cameras]
        if len(names) < MIN_CAMERAS:
            raise CaptureError(
                f"{self.path}: {len(names)} cameras ({', '.join(names) or 'none'}); at least {MIN_CAMERAS} are needed. "
                f"Add the missing ones with their poses."
            )
        if len(set(names)) < len(names):
            raise CaptureError(f"{self.path}: two cameras have the same name, among {', '.join(names)}.")
        sizes = {(c.width, c.height): c.name for c in self.cameras}
        if len(sizes) > 1:
            found = ", ".join(f"{name} {width}x{height}" for (width, height), name in sizes.items())
            raise CaptureError(
                f"{self.path}: the cameras have different sizes ({found}). Bring them to one size first."
            )
        unknown = [n for n in self.held_out if n not in names]
        if unknown:
            raise CaptureError(
                f"{self.path}: there is no camera {unknown[0]!r} to hold out; the cameras are {', '.join(names)}."
            )
        if not self.training_cameras:
            raise CaptureError(f"{self.path}: all {len(names)} cameras are held out; leave some to train on.")
        if not SLOWEST <= self.fps <= FASTEST:
            raise CaptureError(
                f"{self.path}: has {self.fps:g} frames a second, expected {SLOWEST:g} to {FASTEST:g}; correct the number in its files."
            )
        self.doubts = validate_poses(self.cameras, self.points, str(self.origin))
        self._check_places()

    def _check_places(self) -> None:
        centers = np.stack([c.center for c in self.cameras]).astype(np.float64)
        gaps = np.linalg.norm(centers - np.median(centers, 0), axis=1)
        if gaps.max() <= 1e-6 * np.abs(centers).max():
            raise CaptureError(
                f"{self.path}: all {len(gaps)} cameras have the same position {centers[0].round(3).tolist()}, which gives no "
                f"depth. Check their poses."
            )
        if gaps.max() > FAR_OFF * np.median(gaps) > 0:
            lost = int(gaps.argmax())
            raise CaptureError(
                f"{self.path}: camera {self.cameras[lost].name!r} stands {gaps[lost]:.3g} units away from the others, which "
                f"are {np.median(gaps):.3g} apart. Correct its pose or leave the camera out."
            )

    @property
    def layout(self) -> str:
        """Name of the layout of files."""
        name = type(self).__name__.removesuffix("Capture")
        return LAYOUTS.get(name, name)

    @property
    def training_cameras(self) -> list[Camera]:
        """Cameras that are not held out."""
        return [c for c in self.cameras if c.name not in self.held_out]

    @property
    def width(self) -> int:
        """Width of the images in pixels."""
        return self.cameras[0].width

    @property
    def height(self) -> int:
        """Height of the images in pixels."""
        return self.cameras[0].height

    def camera(self, name: str) -> Camera:
        """Return a camera by name. Raise `CaptureError` if it does not exist."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise CaptureError(
            f"{self.path}: there is no camera {name!r}; the cameras are {', '.join(c.name for c in self.cameras)}."
        )

    def read(self, first: int, count: int, cameras: list[str]) -> np.ndarray:
        """Return frames as uint8 [count, len(cameras), H, W, 3] sRGB. `first` is counted within the frame range."""
        out = np.empty((max(count, 0), len(cameras), self.height, self.width, 3), np.uint8)
        self.read_into(out, first, cameras)
        return out

    def read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        """Read frames into an array, as `read` does."""
        count = len(out)
        if first < 0 or count < 1 or first + count > self.frames:
            raise CaptureError(f"{self.path}: frames {first}:{first + count} asked for, there are 0:{self.frames}.")
        for name in cameras:
            self.camera(name)
        self._read_into(out, self.first_frame + first, cameras)

    @abstractmethod
    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        """Fill out [count, len(cameras), H, W, 3] from frame `first` of the files, which includes the start of the range."""

    def missing(self, first: int, count: int, cameras: list[str]) -> np.ndarray:
        """Return [count, len(cameras)] bool, the images that do not exist. `read` returns images of nearby frames for them."""
        columns = [self._missing(self.first_frame + first, count, name) for name in cameras]
        return np.stack(columns, 1) if columns else np.zeros((count, 0), bool)

    def _missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool for one camera. `first` includes the start of the range."""
        return np.zeros(count, bool)

    @property
    def scene(self) -> Capture:
        """Capture of the whole scene, for a capture that shows a subject only."""
        return self

    @property
    def backgrounds(self) -> dict[str, Color]:
        """Color behind the subject by camera, 0..1; empty for a capture of the whole scene."""
        return {}

    def alpha(self, first: int, count: int, cameras: list[str]) -> np.ndarray | None:
        """Return the opacity of the subject, [count, len(cameras), H, W] uint8; None for a capture of the whole scene.

        Pixels of which masks do not tell have one of two values (`masks.LIKELY`).
        """
        return None

    def close(self) -> None:  # noqa: B027 - most formats hold nothing open
        """Close open files. A later read opens them again."""

    def tracks(self) -> dict[str, Track]:
        """Return the sound of the chosen frames by camera, for cameras with videos."""
        return {}

    def frame_tables(self) -> dict[str, FrameTable]:
        """Return the frame tables of the videos by paths within the capture, for other processes that open it."""
        return {}

    def sources(self) -> list[Path]:
        """Return the files that are read, whose sizes belong to the fingerprint."""
        return []

    def reel_source(self) -> ReelSource | None:
        """Return what a reel of this capture says about its frames and cameras."""
        return ReelSource(self.first_frame, tuple(sorted(self.held_out)), tuple(sorted(self.left_out)))

    def fingerprint(self) -> str:
        """Return a short string that changes with the cameras, the frames, the held-out cameras or the files.

        A continued run compares it, because checkpoints of another capture do not fit. The location of the capture does
        not matter. Files are compared by size, since two takes of one rig have no other difference. A growing capture
        has no frame count or sizes.

        Raises:
            CaptureError: A file is missing.
        """
        digest = hashlib.sha256()
        frames = self.limit if self.growing else self.frames
        digest.update(repr((self.name, self.first_frame, frames, self.fps, sorted(self.held_out))).encode())
        for camera in self.cameras:
            digest.update(repr((camera.name, camera.width, camera.height)).encode())
            digest.update(camera.viewmat.tobytes() + camera.K.tobytes())
        for file in self.sources():
            try:
                digest.update(repr((file.name, 0 if self.growing else file.stat().st_size)).encode())
            except OSError as error:
                raise CaptureError(
                    f"{file}: cannot be read ({error.strerror}). Put the file back or leave the camera out."
                ) from error
        return digest.hexdigest()[:16]

    def describe(self) -> dict[str, Any]:
        """Return the readable differences between captures, and the fingerprint, as JSON values."""
        end = (self.limit or "") if self.growing else self.first_frame + self.frames
        return {
            "name": self.name,
            "frames": f"{self.first_frame}:{end}",
            "fps": self.fps,
            "size": f"{self.width}x{self.height}",
            "held_out": sorted(self.held_out),
            "cameras": [camera.name for camera in self.cameras],
            "fingerprint": self.fingerprint(),
        }


def read_cameras(read: Callable[[np.ndarray, int, str], None], out: np.ndarray, first: int, cameras: list[str]) -> None:
    """Fill out [count, len(cameras), H, W, 3] by read(out [count, H, W, 3], first, camera), cameras in parallel.

    FFmpeg and OpenCV release the interpreter lock.
    """
    with ThreadPoolExecutor(min(len(cameras), threads.count()) or 1) as pool:
        jobs = [pool.submit(read, out[:, c], first, name) for c, name in enumerate(cameras)]
        for job in jobs:
            job.result()
