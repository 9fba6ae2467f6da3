"""Motion masks at a keyframe (paper section 4.1, 2D motion segmentation), and their completion to whole objects."""

from __future__ import annotations

import math
from typing import Protocol

import cv2
import numpy as np

from splatreel.config import LayeringConfig
from splatreel.config.layering import PAPER_WIDTH
from splatreel.errors import UsageError
from splatreel.motion.flow import Flow, each_view
from splatreel.motion.sam2 import Sam2Segmenter

ENOUGH_WIDTH = 320
"""Pictures are halved for their flow as long as this many pixels are left of their width: masks need no more, and flow is slow."""
LEAST_FLOW = 0.5
"""Pixels; shorter flow is not told from noise, however small the images."""
ENOUGH_FRAMES = 0.4
"""Share of the selected frames in which a pixel must move to be labeled without a flow that returns."""
CHANGED = 6 / 255
"""Flow counts only where the two images also differ by this much, in 0..1: flow on flat walls is noise. Lower lets noise of the
cameras in, higher loses what moves before something of its own color."""
RETURN_GAP = 0.15
"""How far from its start, relative to its length, a flow forth and back may end."""


class Segmenter(Protocol):
    """Grows motion masks to whole objects. masks: [C, H, W] bool; images: [C, H, W, 3] uint8. Returns [C, H, W] bool."""

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray: ...


def make_segmenter(name: str) -> Segmenter | None:
    """The segmenter of a configuration: 'grabcut', 'sam2', or 'none' for None. Raises `UsageError` for another name."""
    if name == "none":
        return None
    if name == "grabcut":
        return GrabCutSegmenter()
    if name == "sam2":
        return Sam2Segmenter()
    raise UsageError(f"Unknown segmenter {name!r}. Choose grabcut, sam2 or none.")


def motion_masks(frames: np.ndarray, flow: Flow, config: LayeringConfig) -> np.ndarray:
    """What moves between the keyframe and later frames of its group, seen at the keyframe; [C, H, W] bool.

    frames: [T, C, H, W, 3] uint8, the keyframe first. A pixel moves towards a later frame if its flow is longer than lambda_raft (at
    the paper's width) and it also looks different there: flow on flat walls is noise. It is labeled if that happens in enough of
    the selected frames, or if the flow back returns to it once: background that something passes before does neither, while
    what is too fast for the flow to return has left for most frames. With one selected frame this is the paper's rule. What
    appears only later has no pixel at the keyframe and is left to the adaptive conversion of static points.
    """
    count, cameras, height, width = frames.shape[:4]
    halvings = max(int(math.log2(width / ENOUGH_WIDTH)), 0)
    threshold = max(config.flow_threshold * (width >> halvings) / PAPER_WIDTH, LEAST_FLOW)
    later = later_frames(count, config.flow_frames)
    enough = math.ceil(ENOUGH_FRAMES * len(later))

    def moving(c: int) -> np.ndarray:
        first = _smaller(frames[0, c], halvings)
        evidence = np.zeros(first.shape[:2], int)
        for t in later:
            other = _smaller(frames[t, c], halvings)
            vectors = flow(first, other)
            moves = np.hypot(vectors[..., 0], vectors[..., 1]) > threshold
            moves &= _difference(first, other) >= CHANGED
            evidence += moves
            if enough > 1:
                evidence[moves & _returns(vectors, flow(other, first))] = enough
        mask = _clean((evidence >= enough) & (evidence > 0))
        return cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0

    return np.stack(each_view(moving, cameras, flow))


def _smaller(image: np.ndarray, halvings: int) -> np.ndarray:
    """[H, W, 3] uint8, its width and height halved so many times."""
    size = image.shape[1] >> halvings, max(image.shape[0] >> halvings, 1)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA) if halvings else image


def _returns(forth: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Where the flow back, [H, W, 2], undoes the flow forth, [H, W, 2]; [H, W] bool."""
    y, x = np.mgrid[: forth.shape[0], : forth.shape[1]].astype(np.float32)
    there = cv2.remap(back, x + forth[..., 0], y + forth[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    gap = np.linalg.norm(forth + there, axis=-1)
    return gap < np.maximum(LEAST_FLOW, RETURN_GAP * np.linalg.norm(forth, axis=-1))


def later_frames(count: int, wanted: int) -> list[int]:
    """Up to `wanted` frames after the first, spread evenly over `count` frames; the last one always."""
    return sorted({round(t) for t in np.linspace(0, count - 1, wanted + 1)[1:]} - {0})


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean absolute difference of the colors over a 5 x 5 neighborhood, [H, W] float32 0..1."""
    return cv2.GaussianBlur(cv2.absdiff(a, b).mean(-1, dtype=np.float32) / 255, (5, 5), 0)


def _clean(mask: np.ndarray) -> np.ndarray:
    """Without specks, and with small holes closed; sizes follow the image's width."""
    speck, hole = (2 * max(round(half * mask.shape[1] / 640), 1) + 1 for half in (1, 2))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((speck, speck), np.uint8))
    return cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((hole, hole), np.uint8)) > 0


class GrabCutSegmenter:
    """GrabCut (Rother et al. 2004) seeded by the mask: classical, needs no weights.

    It may grow a mask by less than `reach` of the image's width. Growth that runs up to that limit found no border of its own (the
    colors do not tell the object from its background) and is taken back, patch by patch.
    """

    def __init__(self, reach: float = 0.03, iterations: int = 2, width: int = 480) -> None:
        self.reach = reach
        self.iterations = iterations
        self.width = width

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray:
        return np.stack([self._complete_one(mask, image) for mask, image in zip(masks, images, strict=True)])

    def _complete_one(self, mask: np.ndarray, image: np.ndarray) -> np.ndarray:
        height, width = mask.shape
        scale = min(self.width / width, 1.0)
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
        cv2.grabCut(small, window, (0, 0, 0, 0), *models, self.iterations, cv2.GC_INIT_WITH_MASK)
        added = np.zeros_like(seed)
        added[rows, columns] = (window == cv2.GC_FGD) | (window == cv2.GC_PR_FGD)
        added[seed > 0] = 0
        limit = near - cv2.erode(near, np.ones((3, 3), np.uint8))
        patches = cv2.connectedComponents(added)[1]
        added[np.isin(patches, np.unique(patches[limit > 0]))] = 0
        return mask | (cv2.resize(added, (width, height), interpolation=cv2.INTER_NEAREST) > 0)
