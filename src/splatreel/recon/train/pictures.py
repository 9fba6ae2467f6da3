"""The pictures that training compares with, and the views that took them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatreel.recon.train.render import View


@dataclass(frozen=True)
class Pictures:
    """At one resolution. images: [T, C, H, W, 3] uint8, of a keyframe T = 1; views: C.

    near: plane before which nothing is drawn; unit: typical viewing distance; both in world units.
    """

    images: Tensor
    views: list[View]
    near: float
    unit: float

    @property
    def count(self) -> int:
        """Frames T."""
        return self.images.shape[0]

    def halved(self) -> Pictures:
        """The same at half size. A frame at a time, into its place: as floats, or in pieces, a group's pictures take much memory."""
        count, cameras, height, width, channels = self.images.shape
        small = self.images.new_empty(count, cameras, height // 2, width // 2, channels)
        for place, images in zip(small, self.images, strict=True):
            place.copy_(halved(images))
        return replace(self, images=small, views=[view.halved() for view in self.views])


def halved(images: Tensor) -> Tensor:
    """Images [C, H, W, 3] uint8 at half size, averaged over blocks of 2 x 2; an odd row or column is cut off."""
    small = torch.nn.functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), 2)
    return small.round().to(torch.uint8).permute(0, 2, 3, 1).contiguous()
