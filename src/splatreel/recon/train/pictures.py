"""The pictures that training compares with, and the views that took them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from splatreel import threads
from splatreel.capture.frame_file import frame_array, release_pages
from splatreel.recon.train.render import View


@dataclass(frozen=True)
class Pictures:
    """At one resolution. images: [T, C, H, W, 3] uint8, of a keyframe T = 1; views: C.

    near: plane before which nothing is drawn; unit: typical viewing distance; both in world units.
    unknown: [C, H, W] bool, of a keyframe, where its pictures mean nothing; None: nowhere.
    array: the array of `frame_array` that images are a view of, if they are one.
    """

    images: Tensor
    views: list[View]
    near: float
    unit: float
    unknown: Tensor | None = None
    array: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Frames T."""
        return self.images.shape[0]

    def target(self, camera: int, drawn: Tensor, gain: Tensor | None) -> Tensor:
        """[H, W, 3] uint8, what a camera's picture of the keyframe should be. Where that is unknown it may be as it is.

        drawn: [H, W, 3] what is drawn now, 0..1, before the camera's color gain [3].
        """
        image = self.images[0, camera]
        if self.unknown is None:
            return image
        shown = drawn.detach() if gain is None else drawn.detach() * gain.detach()
        as_shown = (shown.clamp(0, 1) * 255).round().to(torch.uint8)
        return torch.where(self.unknown[camera][..., None], as_shown, image)

    def sizes(self, iterations: int, coarse_share: float, afforded: float) -> list[tuple[int, Pictures]]:
        """In which sizes training looks at them, the smallest first, and at which of its iterations it ends to look at each.

        coarse_share: of the iterations, which look at half size. afforded: see `Config.training_megapixels`.
        """
        *_, height, width, _ = self.images.shape
        sizes, shown = [], self
        for end in size_ends(1e-6 * width * height, coarse_share, afforded):
            if sizes:
                shown = shown.halved()
            sizes.append((round(end * iterations), shown))
        return sizes[::-1]

    def give_back(self) -> None:
        """Take the pages of pictures that lie in a file out of this process; they are read again as they are needed."""
        if self.array is not None:
            release_pages(self.array)

    def halved(self) -> Pictures:
        """The same at half size. A frame at a time, into its place: as floats, or in pieces, a group's pictures take much memory."""
        count, cameras, height, width, channels = self.images.shape
        shape = (count, cameras, height // 2, width // 2, channels)
        array = None if self.images.is_cuda else frame_array(shape)
        small = self.images.new_empty(shape) if array is None else torch.from_numpy(array)

        def halve(frame: int) -> None:
            small[frame].copy_(halved(self.images[frame]))
            self.give_back()

        with ThreadPoolExecutor(threads.count()) as pool:
            list(pool.map(halve, range(count)))
        unknown = self.unknown
        if unknown is not None:  # where any of the four pixels is
            unknown = torch.nn.functional.max_pool2d(unknown[:, None].float(), 2)[:, 0] > 0
        views = [view.halved() for view in self.views]
        return replace(self, images=small, views=views, unknown=unknown, array=array)


def size_ends(megapixels: float, coarse_share: float, afforded: float) -> list[float]:
    """Shares of training after which one looks at pictures halved 0, 1, 2 times and so on no more.

    Of large pictures each size has the iterations that are afforded; the smallest of these sizes stands for the whole one, which the
    coarse ones are half of.
    """
    ends = [1.0]
    while afforded and (share := afforded / megapixels) < ends[-1] - coarse_share:
        ends.append(ends[-1] - share)
        megapixels /= 4
    return [*ends, coarse_share] if coarse_share else ends


def halved(images: Tensor) -> Tensor:
    """Images [C, H, W, 3] uint8 at half size, averaged over blocks of 2 x 2; an odd row or column is cut off."""
    if images.is_cuda:
        small = torch.nn.functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), 2)
        return small.round().to(torch.uint8).permute(0, 2, 3, 1).contiguous()
    height, width = images.shape[1] // 2, images.shape[2] // 2
    even = images[:, : 2 * height, : 2 * width].numpy()
    small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in even]
    return torch.from_numpy(np.stack(small))
