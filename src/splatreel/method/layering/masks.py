"""Motion masks at a keyframe (paper section 4.1, 2D motion segmentation), and their completion to whole objects."""

from __future__ import annotations

import math
from typing import Protocol

import cv2
import numpy as np

from splatreel.base.errors import UsageError
from splatreel.config import LayeringConfig
from splatreel.config.config import PAPER_WIDTH
from splatreel.method.images.flow import Flow, map_views
from splatreel.method.layering.sam2 import Sam2Segmenter

FLOW_WIDTH = 320
"""Flow is computed on images halved as long as at least this width remains. Masks need no more detail, and flow is slow."""
MIN_FLOW = 0.5
"""Minimum length of flow, pixels. Shorter flow is noise at any image size."""
FLOW_THRESHOLD = 2.0
"""Flow, pixels at a width of `PAPER_WIDTH`, above which a pixel moves (lambda_raft)."""
MIN_MOVING_SHARE = 0.4
"""Share of the selected frames in which a pixel must move to be labeled without a flow that returns."""
MIN_COLOR_CHANGE = 6 / 255
"""Minimum color difference, 0..1, for flow to count: flow on plain walls is noise. A lower value admits camera noise; a higher
one misses content that moves in front of its own color."""
RETURN_GAP = 0.15
"""Maximum distance between start and end of flow forth and back, relative to the length of the flow."""


class Segmenter(Protocol):
    """Completion of motion masks to whole objects."""

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray:
        """Return completed masks [C, H, W] bool of images [C, H, W, 3] uint8."""
        ...


def make_segmenter(name: str) -> Segmenter | None:
    """Create a segmenter by name: 'grabcut' or 'sam2'; 'none' gives None.

    Raises:
        UsageError: If the name is unknown.
    """
    if name == "none":
        return None
    if name == "grabcut":
        return GrabCutSegmenter()
    if name == "sam2":
        return Sam2Segmenter()
    raise UsageError(f"Unknown segmenter {name!r}. Choose grabcut, sam2 or none.")


def motion_masks(frames: np.ndarray, flow: Flow, config: LayeringConfig) -> np.ndarray:
    """Return masks [C, H, W] bool of the pixels of the keyframe that move towards later frames of the group.

    A pixel moves towards a later frame if its flow is longer than lambda_raft (at the paper's width) and its color differs
    there. It is labeled if it moves in enough of the selected frames, or if the flow back returns to it once. Background that
    something passes in front of does neither. Content that is too fast for its flow to return has left in most frames. With one
    selected frame this is the paper's rule. Content that appears later has no pixel at the keyframe; adaptive conversion
    handles it.
    """
    count, cameras, height, width = frames.shape[:4]
    halvings = max(int(math.log2(width / FLOW_WIDTH)), 0)
    threshold = max(FLOW_THRESHOLD * (width >> halvings) / PAPER_WIDTH, MIN_FLOW)
    later = later_frames(count, config.flow_frames)
    enough = math.ceil(MIN_MOVING_SHARE * len(later))

    def moving(c: int) -> np.ndarray:
        first = _smaller(frames[0, c], halvings)
        evidence = np.zeros(first.shape[:2], int)
        for t in later:
            other = _smaller(frames[t, c], halvings)
            vectors = flow(first, other)
            moves = np.hypot(vectors[..., 0], vectors[..., 1]) > threshold
            moves &= _difference(first, other) >= MIN_COLOR_CHANGE
            evidence += moves
            if enough > 1:
                evidence[moves & _returns(vectors, flow(other, first))] = enough
        mask = _clean((evidence >= enough) & (evidence > 0))
        return cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0

    return np.stack(map_views(moving, cameras, flow))


def _smaller(image: np.ndarray, halvings: int) -> np.ndarray:
    """Halve the width and height of an image [H, W, 3] uint8 several times."""
    size = image.shape[1] >> halvings, max(image.shape[0] >> halvings, 1)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA) if halvings else image


def _returns(forth: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return [H, W] bool, the pixels whose flow forth is undone by the flow back, [H, W, 2] each."""
    y, x = np.mgrid[: forth.shape[0], : forth.shape[1]].astype(np.float32)
    there = cv2.remap(back, x + forth[..., 0], y + forth[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    gap = np.linalg.norm(forth + there, axis=-1)
    return gap < np.maximum(MIN_FLOW, RETURN_GAP * np.linalg.norm(forth, axis=-1))


def later_frames(count: int, wanted: int) -> list[int]:
    """Return up to `wanted` frames after the first, spread evenly over `count` frames. The last frame is always included."""
    return sorted({round(t) for t in np.linspace(0, count - 1, wanted + 1)[1:]} - {0})


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the mean absolute color difference [H, W] float32, 0..1, over a 5 x 5 neighborhood."""
    return cv2.GaussianBlur(cv2.absdiff(a, b).mean(-1, dtype=np.float32) / 255, (5, 5), 0)


def _clean(mask: np.ndarray) -> np.ndarray:
    """Remove specks and close small holes. Their sizes follow the image width."""
    speck, hole = (2 * max(round(half * mask.shape[1] / 640), 1) + 1 for half in (1, 2))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((speck, speck), np.uint8))
    return cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((hole, hole), np.uint8)) > 0


GRABCUT_WIDTH, GRABCUT_ITERATIONS = 480, 2
"""Largest width, pixels, at which GrabCut runs, and its iterations."""


class GrabCutSegmenter:
    """Segmenter by GrabCut, seeded by the mask. It needs no weights.

    It may grow a mask by less than `reach` of the image width. Growth up to that limit found no border, because object and
    background have similar colors. It is undone, patch by patch.

    Source:
        Rother et al. 2004.
    """

    def __init__(self, reach: float = 0.03) -> None:
        self.reach = reach

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray:
        """See `Segmenter`."""
        return np.stack([self._complete_one(mask, image) for mask, image in zip(masks, images, strict=True)])

    def _complete_one(self, mask: np.ndarray, image: np.ndarray) -> np.ndarray:
        height, width = mask.shape
        scale = min(GRABCUT_WIDTH / width, 1.0)
        size = max(round(width * scale), 1), max(round(height * scale), 1)
        seed = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        reach = max(round(self.reach * size[0]), 1)
        near = cv2.dilate(seed, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        around = cv2.dilate(near, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        if not seed.any() or near.all():
            return mask.copy()
        trimap = np.full(seed.shape, cv2.GC_BGD, np.uint8)
        trimap[near > 0] = cv2.GC_PR_BGD
        trimap[seed > 0] = cv2.GC_FGD
        rows, columns = (slice(i.min(), i.max() + 1) for i in np.nonzero(around))
        small = np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)[rows, columns])
        window = np.ascontiguousarray(trimap[rows, columns])
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.setRNGSeed(0)
        cv2.grabCut(small, window, (0, 0, 0, 0), *models, GRABCUT_ITERATIONS, cv2.GC_INIT_WITH_MASK)
        added = np.zeros_like(seed)
        added[rows, columns] = (window == cv2.GC_FGD) | (window == cv2.GC_PR_FGD)
        added[seed > 0] = 0
        limit = near - cv2.erode(near, np.ones((3, 3), np.uint8))
        patches = cv2.connectedComponents(added)[1]
        added[np.isin(patches, np.unique(patches[limit > 0]))] = 0
        return mask | (cv2.resize(added, (width, height), interpolation=cv2.INTER_NEAREST) > 0)
