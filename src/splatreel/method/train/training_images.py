"""Training images and the views that took them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.paged_arrays import frame_array, release_pages
from splatreel.method.train.render import View


@dataclass(frozen=True)
class TrainingImages:
    """Training images at one resolution.

    Attributes:
        pixels: [T, C, H, W, 3] uint8. A keyframe has T = 1.
        unknown: [T, C, H, W] bool, pixels without a valid value; None if all are valid.
        array: The array of `frame_array` that `pixels` is a view of, if there is one.
        opposite: The same images over the opposite backgrounds, for a subject before few cameras; None for all others.
    """

    pixels: np.ndarray
    views: list[View]
    near: float
    unit: float
    unknown: np.ndarray | None = None
    array: np.ndarray | None = None
    opposite: TrainingImages | None = None

    @property
    def count(self) -> int:
        """Number of frames, T."""
        return self.pixels.shape[0]

    @property
    def all_views(self) -> list[View]:
        """The views, and those over the opposite backgrounds."""
        return self.views if self.opposite is None else self.views + self.opposite.views

    def of_iteration(self, iteration: int) -> tuple[TrainingImages, int]:
        """Return the images over the backgrounds of an iteration, and the place of their first view in `all_views`."""
        if self.opposite is None or iteration // len(self.views) % 2 == 0:
            return self, 0
        return self.opposite, len(self.views)

    def target(self, frame: int, camera: int, drawn: np.ndarray, gain: np.ndarray | None) -> np.ndarray:
        """Return a target image [H, W, 3] uint8.

        Unknown pixels repeat the drawing before the color gain, so that they cause no loss.
        """
        image = self.pixels[frame, camera]
        if self.unknown is None:
            return image
        shown = drawn if gain is None else drawn * gain
        as_shown = (shown.clip(0, 1) * 255).round().astype(np.uint8)
        return np.where(self.unknown[frame, camera][..., None], as_shown, image)

    def sizes(self, iterations: int, coarse_share: float, afforded: float) -> list[tuple[int, TrainingImages]]:
        """Return the resolutions that training uses, smallest first, each with the iteration at which its use ends.

        Images are at half size for the share `coarse_share`. For `afforded` see `Config.training_megapixels`.
        """
        *_, height, width, _ = self.pixels.shape
        sizes, shown = [], self
        for end in size_ends(1e-6 * width * height, coarse_share, afforded):
            if sizes:
                shown = shown.halved()
            sizes.append((round(end * iterations), shown))
        return sizes[::-1]

    def release_pages(self) -> None:
        """Release the memory pages of images that are backed by a file. They are read again when needed."""
        if self.array is not None:
            release_pages(self.array)
        if self.opposite is not None:
            self.opposite.release_pages()

    def halved(self) -> TrainingImages:
        """Return the images at half size."""
        count, cameras, height, width, channels = self.pixels.shape
        small = frame_array((count, cameras, height // 2, width // 2, channels))

        def halve(frame: int) -> None:
            small[frame] = halved(self.pixels[frame])
            self.release_pages()

        threads.map_parallel(halve, range(count))
        unknown = self.unknown
        if unknown is not None:  # unknown if any of the four pixels is
            even = unknown[..., : 2 * (height // 2), : 2 * (width // 2)]
            unknown = even.reshape(count, cameras, height // 2, 2, width // 2, 2).any((3, 5))
        views = [view.halved() for view in self.views]
        opposite = None if self.opposite is None else self.opposite.halved()
        return replace(self, pixels=small, views=views, unknown=unknown, array=small, opposite=opposite)


def size_ends(megapixels: float, coarse_share: float, afforded: float) -> list[float]:
    """Return the shares of training at which the use of images halved 0, 1, 2 times and so on ends.

    Large images use each size for the iterations that are afforded. The smallest of these sizes then counts as full
    size, which the coarse iterations halve. For `afforded` see `Config.training_megapixels`; 0 means no limit.
    """
    ends = [1.0]
    while afforded and (share := afforded / megapixels) < ends[-1] - coarse_share:
        ends.append(ends[-1] - share)
        megapixels /= 4
    return [*ends, coarse_share] if coarse_share else ends


def halved(images: np.ndarray) -> np.ndarray:
    """Average images [C, H, W, 3] uint8 over blocks of 2 x 2 pixels. An odd row or column is cut off."""
    height, width = images.shape[1] // 2, images.shape[2] // 2
    even = images[:, : 2 * height, : 2 * width]
    return np.stack([cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in even])
