"""Capture of a subject: the images of another capture, with everything outside of masks replaced by a color."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from splatreel.capture.base import Capture, Color, read_cameras
from splatreel.capture.capture_sound import Track
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.mask_files import DOUBT
from splatreel.capture.srgb import over_color
from splatreel.scene.reel_source import ReelSource

PALETTE: tuple[Color, ...] = ((0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (0, 0, 1), (1, 1, 0))
"""Backgrounds of the cameras, in turn. No Gaussian outside of the masks has the right color for several cameras. Levels of 0 and
255 carry no exposure, so that `motion.exposure` ignores them."""


UNLIKELY, LIKELY = 127, 128
"""Opacities of pixels that may or may not show the subject: less likely, and more likely. In masks without doubts, opacities of 127 and
128 become 126 and 129."""


class Masks(Protocol):
    """Masks of all cameras.

    Attributes:
        notes: Sentences about masks that are paired with images of other names.
    """

    notes: list[str]

    @property
    def have_doubts(self) -> bool:
        """True if gray is doubt (`mask_files.DOUBT`) instead of opacity."""
        ...

    def read(self, first: int, count: int, name: str) -> np.ndarray:
        """Return the masks of a camera as the images are read, [count, H, W] uint8. `first` counts from the files' first step."""
        ...

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        ...

    def digest(self, first: int, count: int) -> str:
        """Return a short string that changes with the content of the masks."""
        ...

    def close(self) -> None:
        """Close open files."""
        ...


class MaskedCapture(Capture):
    """Capture of a subject.

    Args:
        capture: Capture of the whole scene.
        masks: Masks of its images.
        background: Color outside of the masks, 0..1; None gives each camera its color of the `PALETTE`, for training.
    """

    def __init__(self, capture: Capture, masks: Masks, background: Color | None = None) -> None:
        self._capture = capture
        self._masks = masks
        colors = cycle(PALETTE if background is None else (background,))
        self._backgrounds = {camera.name: color for camera, color in zip(capture.cameras, colors, strict=False)}
        super().__init__(
            capture.path,
            capture.cameras,
            held_out=capture.held_out,
            frame_range=(capture.first_frame, capture.first_frame + capture.frames),
            fps=capture.fps,
            points=capture.points,
            point_colors=capture.point_colors,
            near=capture.near,
            origin=capture.origin,
            notes=[*capture.notes, *masks.notes],
        )
        # Images with an opacity are composed over black when they are read. If that opacity is the mask, it counts once.
        read = set(masks.sources(self.first_frame, self.frames))
        self._is_composed = bool(read) and read <= set(capture.sources())

    @property
    def layout(self) -> str:
        """Name of the layout of files."""
        return self._capture.layout

    @property
    def scene(self) -> Capture:
        """Capture of the whole scene."""
        return self._capture

    @property
    def backgrounds(self) -> dict[str, Color]:
        """Color behind the subject by camera, 0..1."""
        return self._backgrounds

    def alpha(self, first: int, count: int, cameras: list[str]) -> np.ndarray:
        """Return the opacity of the subject, [count, len(cameras), H, W] uint8, `UNLIKELY` or `LIKELY` where masks do not tell."""
        levels = np.stack([self._masks.read(self.first_frame + first, count, name) for name in cameras], 1)
        if self._masks.have_doubts:
            return np.where(_in_doubt(levels), np.where(levels < LIKELY, np.uint8(UNLIKELY), np.uint8(LIKELY)), levels)
        return np.where(
            levels == UNLIKELY, np.uint8(UNLIKELY - 1), np.where(levels == LIKELY, np.uint8(LIKELY + 1), levels)
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self._capture.read_into(out, first - self._capture.first_frame, cameras)
        read_cameras(self._compose, out, first, cameras)

    def _compose(self, out: np.ndarray, first: int, name: str) -> None:
        color = np.rint(255 * np.array(self._backgrounds[name])).astype(np.uint8)
        levels = self._masks.read(first, len(out), name)
        if self._masks.have_doubts:
            levels = np.where(_in_doubt(levels), np.where(levels < LIKELY, np.uint8(0), np.uint8(255)), levels)
        for image, alpha in zip(out, levels, strict=True):
            if self._is_composed:
                image += over_color(np.zeros_like(image), alpha, color)
            else:
                image[:] = over_color(image, alpha, color)

    def _missing(self, first: int, count: int, name: str) -> np.ndarray:
        return self._capture.missing(first - self._capture.first_frame, count, [name])[:, 0]

    def tracks(self) -> dict[str, Track]:
        """Return the sound by camera."""
        return self._capture.tracks()

    def frame_tables(self) -> dict[str, FrameTable]:
        """Return the frame tables of the videos."""
        return self._capture.frame_tables()

    def sources(self) -> list[Path]:
        """Return the files of the capture. `describe` has the content of the masks."""
        return self._capture.sources()

    def reel_source(self) -> ReelSource | None:
        """Return what a reel of this capture says about its frames and cameras."""
        source = self._capture.reel_source()
        return source and replace(source, part="masks")

    def describe(self) -> dict[str, Any]:
        """Return the readable differences between captures, with a string for the content of the masks."""
        return super().describe() | {"masks": self._digest}

    @cached_property
    def _digest(self) -> str:
        return self._masks.digest(self.first_frame, self.frames)

    def close(self) -> None:
        """Close open files."""
        self._masks.close()
        self._capture.close()


def is_doubtful(alpha: np.ndarray) -> np.ndarray:
    """Return which opacities [...] uint8 are in doubt, [...] bool."""
    return (alpha == UNLIKELY) | (alpha == LIKELY)


def _in_doubt(levels: np.ndarray) -> np.ndarray:
    """Return which pixels of masks with doubts are in doubt."""
    return (levels >= DOUBT[0]) & (levels < DOUBT[1])
