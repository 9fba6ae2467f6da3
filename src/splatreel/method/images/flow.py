"""Optical flow between two frames of one camera (paper section 4.1, 2D motion segmentation)."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.method.images.pretrained import Pretrained

T = TypeVar("T")
Box = tuple[slice, slice]
"""Rows and columns."""

RAFT = Pretrained(
    purpose="RAFT flow",
    package="torchvision",
    module="torchvision.models.optical_flow",
    file="raft_large_C_T_SKHT_V2-ff5fadd5.pth",
    url="https://download.pytorch.org/models/raft_large_C_T_SKHT_V2-ff5fadd5.pth",
    variable="SPLATREEL_RAFT_WEIGHTS",
    remedy="use the flow 'dis'",
    install=", with the torchvision that fits your torch",
)
RAFT_MIN_SIDE = 128
"""Minimum side, pixels, for RAFT's correlation pyramid."""
MARGIN = 0.03
"""Margin around wanted pixels in which DIS runs at full size, as a share of the image width, but at least `MIN_MARGIN`
pixels."""
MIN_MARGIN = 14
PATCH = 7
"""Side of the patch, pixels, by which a guess is judged."""
COARSE_WIDTH = 320
"""Width at which DIS ends on the whole image if boxes are compared more finely. Smaller images end one halving before the boxes."""
DIS_PATCH = 8
"""Side of the patches that DIS compares, pixels. It crashes if an image is halved to fewer pixels."""
HALF_FROM = 200
"""Width of the image from which DIS ends at half size (experiments/2026-11-27-half-size-flow.md and
2026-11-27-flow-of-fast-things.md)."""
MAX_BOX_SHARE = 0.7
"""Share of the image covered by boxes above which the whole image at full size takes less time."""


class Flow(Protocol):
    """Optical flow function."""

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the flow [H, W, 2] float32 from frame a to frame b [H, W, 3] uint8, x and y in pixels.

        `guess` [H, W, 2] is likely flow; without it a coarse-to-fine search misses small, fast content. Only pixels of
        `wanted` [H, W] are needed: the result elsewhere is finite but arbitrary.
        """
        ...


def make_flow(name: str) -> Flow:
    """Create a flow function by name: 'dis' or 'raft'.

    Raises:
        UsageError: If the name is unknown.
    """
    if name == "dis":
        return DisFlow()
    if name == "raft":
        return RaftFlow()
    raise UsageError(f"Unknown optical flow {name!r}. Choose dis or raft.")


def map_views(work: Callable[[int], T], views: int, flow: Flow) -> list[T]:
    """Return the results of `work`, which computes flow, for the views 0, 1 and so on.

    DIS hardly gains from a second core within a pair of frames. Its views run in parallel. A network takes all cores for a view.
    """
    return (
        threads.map_parallel(work, range(views)) if isinstance(flow, DisFlow) else [work(view) for view in range(views)]
    )


class _ThreadCache(threading.local):
    """OpenCV objects of one thread, by finest scale and image size."""

    def __init__(self) -> None:
        self.dis: dict[tuple[int, ...], Any] = {}


class DisFlow:
    """Dense inverse search by OpenCV. It is fast and needs no weights. Threads may share it. Source: Kroeger et al. 2016."""

    def __init__(self) -> None:
        self._cache = _ThreadCache()

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the flow; see `Flow`. If few pixels are wanted, only boxes around them are compared finely."""
        least = min(a.shape[:2])
        here, there = (cv2.cvtColor(np.ascontiguousarray(x), cv2.COLOR_RGB2GRAY) for x in (a, b))
        if least < 16:  # too small for DIS's patch pyramid; motion is short in such images
            here, there = (cv2.resize(gray, None, fx=16 / least, fy=16 / least) for gray in (here, there))
            flow = _dis(0).calc(here, there, None)
            return cv2.resize(flow, (a.shape[1], a.shape[0]), interpolation=cv2.INTER_AREA) * (least / 16)
        finest = int(here.shape[1] >= HALF_FROM)
        boxes = [] if wanted is None else _boxes(wanted, guess)
        if wanted is None or sum(_area(box) for box in boxes) > MAX_BOX_SHARE * wanted.size:
            return self._whole(finest, here, there, guess)
        halvings = max(finest + 1, math.ceil(math.log2(here.shape[1] / COARSE_WIDTH)))
        halvings = min(halvings, int(math.log2(min(here.shape) / DIS_PATCH)))
        flow = self._whole(halvings, here, there, guess)
        for box in boxes:
            near = np.ascontiguousarray(here[box]), np.ascontiguousarray(there[box])
            start = flow[box] if guess is None else _better_flow(*near, flow[box], guess[box])
            flow[box] = _dis(finest).calc(*near, np.ascontiguousarray(start))
        return flow

    def _whole(self, finest: int, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
        """Return the flow between whole gray images, by an object of this thread and image size, which reuses its buffers."""
        key = finest, *a.shape
        if key not in self._cache.dis:
            self._cache.dis[key] = _dis(finest)
        start = None if guess is None else guess.astype(np.float32)  # a copy, since OpenCV writes to it
        return self._cache.dis[key].calc(a, b, start)


def _dis(finest: int) -> Any:
    """Create an OpenCV object that ends at images halved `finest` times.

    It must not be used for two image sizes: its buffers have the first size, and it reads past their ends for a larger image.
    """
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(finest)
    return dis


def _better_flow(a: np.ndarray, b: np.ndarray, flow: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return the flow between gray images, replaced by the guess wherever the guess matches better."""
    y, x = np.mgrid[: a.shape[0], : a.shape[1]].astype(np.float32)
    a, b = (cv2.blur(gray, (PATCH, PATCH)) for gray in (a, b))  # a guess may be some pixels wrong
    errors = []
    for way in (flow, guess):
        met = cv2.remap(b, x + way[..., 0], y + way[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        errors.append(cv2.blur(cv2.absdiff(a, met).astype(np.float32), (PATCH, PATCH)))
    return np.where((errors[1] < errors[0])[..., None], guess, flow)


def _boxes(wanted: np.ndarray, guess: np.ndarray | None) -> list[Box]:
    """Return boxes around wanted pixels and the targets of their guesses, with a margin. No box is too small for DIS."""
    reach = max(round(MARGIN * wanted.shape[1]), MIN_MARGIN)
    side = 2 * reach + 1
    near = cv2.dilate(wanted.astype(np.uint8), np.ones((side, side), np.uint8))
    boxes = []
    for part in cv2.connectedComponentsWithStats(near)[2][1:].tolist():
        x, y, width, height = part[:4]
        rows, columns = slice(y, y + height), slice(x, x + width)
        if guess is not None:
            ways = guess[rows, columns][wanted[rows, columns]]
            rows, columns = (_extended(span, ways[:, axis]) for span, axis in ((rows, 1), (columns, 0)))
        rows, columns = (_clipped(span, size, side) for span, size in zip((rows, columns), wanted.shape, strict=True))
        boxes.append((rows, columns))
    return boxes


def _extended(span: slice, ways: np.ndarray) -> slice:
    """Extend a range of one axis by the guesses of its pixels."""
    return slice(span.start + math.floor(min(ways.min(), 0)), span.stop + math.ceil(max(ways.max(), 0)))


def _clipped(span: slice, size: int, least: int) -> slice:
    """Clip a range to an image side, with at least `least` pixels if the image has them."""
    start, stop = max(span.start, 0), min(span.stop, size)
    start = max(min(start, size - least), 0)
    return slice(start, min(max(stop, start + least), size))


def _area(box: Box) -> int:
    rows, columns = box
    return (rows.stop - rows.start) * (columns.stop - columns.start)


class RaftFlow:
    """RAFT by torchvision (extra `splatreel[models]`), the flow of the paper. Source: Teed and Deng 2020."""

    def __init__(
        self, weights: Path | None = None, device: str | None = None, updates: int = 20, model: Any = None
    ) -> None:
        """Load the network. Nothing is downloaded. `weights`: a state dict; None uses SPLATREEL_RAFT_WEIGHTS or torch's cache."""
        model = model if model is not None else _load_raft(weights)
        import torch

        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.updates = updates
        self.model = model.to(self.device).eval()

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the flow; see `Flow`. RAFT compares all pixels with all, so it ignores the guess and the wanted pixels."""
        import torch

        height, width = a.shape[:2]
        # The network halves its input three times: pad to multiples of 8 by repeating the border.
        below = max(-height % 8, RAFT_MIN_SIDE - height)
        right = max(-width % 8, RAFT_MIN_SIDE - width)
        pair = np.pad(np.stack([a, b]), ((0, 0), (0, below), (0, right), (0, 0)), mode="edge")
        frames = torch.from_numpy(pair).to(self.device).permute(0, 3, 1, 2).float() / 127.5 - 1
        with torch.inference_mode():
            flow = self.model(frames[:1], frames[1:], num_flow_updates=self.updates)[-1]
        return np.ascontiguousarray(flow[0, :, :height, :width].permute(1, 2, 0).float().cpu().numpy())


def _load_raft(weights: Path | None) -> Any:
    raft_large, path = RAFT.import_module().raft_large, RAFT.find_weights(weights)
    import torch

    model = raft_large(weights=None)
    try:
        model.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises a dozen types for a damaged file
        raise MissingDependencyError(
            f"{path}: not the weights of torchvision's raft_large ({type(error).__name__}). Download {RAFT.url} again."
        ) from error
    return model
