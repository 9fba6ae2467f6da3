"""Optical flow between two frames of one camera (paper section 4.1, 2D motion segmentation)."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, TypeVar

import cv2
import numpy as np

from splatreel.errors import MissingDependencyError, UsageError
from splatreel.motion.pretrained import Pretrained

T = TypeVar("T")
Box = tuple[slice, slice]
"""Rows and columns."""

RAFT = Pretrained(
    purpose="RAFT flow",
    package="torchvision",
    file="raft_large_C_T_SKHT_V2-ff5fadd5.pth",
    url="https://download.pytorch.org/models/raft_large_C_T_SKHT_V2-ff5fadd5.pth",
    variable="SPLATREEL_RAFT_WEIGHTS",
    remedy="use the flow 'dis'",
    install=", with the torchvision that fits your torch",
)
RAFT_MIN_SIDE = 128
"""RAFT's correlation pyramid needs at least this many pixels a side."""
REACH = 0.03
"""Of the picture's width: how far around the pixels that are asked for DIS looks closely, and `REACH_LEAST` pixels at least."""
REACH_LEAST = 14
PATCH = 7
"""Pixels around one, a side, by which a guess is judged."""
ENOUGH_WIDTH = 320
"""Pixels of the width at which whole pictures are compared, if their half is wider: boxes are then looked at closely."""
MOST = 0.7
"""Share of the picture that boxes fill above which it is less work to look closely at everything."""


class Flow(Protocol):
    """Where the pixels of frame a go in frame b. a, b: [H, W, 3] uint8 sRGB. Returns [H, W, 2] float32, x and y in pixels.

    guess: [H, W, 2], where they are likely to go; what is small and fast is out of reach of a coarse-to-fine search without it.
    wanted: [H, W] bool, the pixels that are asked for; what is said of others may be anything finite.
    """

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray: ...


def make_flow(name: str) -> Flow:
    """The flow of a configuration: 'dis' or 'raft'. Raises `UsageError` for another name."""
    if name == "dis":
        return DisFlow()
    if name == "raft":
        return RaftFlow()
    raise UsageError(f"Unknown optical flow {name!r}. Choose dis or raft.")


def each_view(work: Callable[[int], T], views: int, flow: Flow) -> list[T]:
    """What `work`, which computes flow, returns for the views 0, 1 and so on.

    DIS hardly gains from a second core within a pair of frames, so its views run side by side, on as many cores as OpenCV may use.
    """
    with ThreadPoolExecutor(max(cv2.getNumThreads(), 1) if isinstance(flow, DisFlow) else 1) as pool:
        return list(pool.map(work, range(views)))


class _Kept(threading.local):
    """What a thread keeps: OpenCV's objects, by how fine they search and in pictures of which size."""

    def __init__(self) -> None:
        self.dis: dict[tuple[int, ...], Any] = {}


class DisFlow:
    """Dense inverse search (Kroeger et al. 2016) by OpenCV: classical, fast, needs no weights. Threads may share it."""

    def __init__(self) -> None:
        self._kept = _Kept()

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        """Where few pixels are wanted, whole pictures are compared in a smaller size, and only boxes around those at full size."""
        least = min(a.shape[:2])
        here, there = (cv2.cvtColor(np.ascontiguousarray(x), cv2.COLOR_RGB2GRAY) for x in (a, b))
        if least < 16:  # below DIS's patch pyramid; nothing goes far in such images
            here, there = (cv2.resize(gray, None, fx=16 / least, fy=16 / least) for gray in (here, there))
            flow = _dis(0).calc(here, there, None)
            return cv2.resize(flow, (a.shape[1], a.shape[0]), interpolation=cv2.INTER_AREA) * (least / 16)
        boxes = [] if wanted is None else _boxes(wanted, guess)
        if wanted is None or sum(_area(box) for box in boxes) > MOST * wanted.size:
            return self._whole(0, here, there, guess)
        halvings = max(1, math.ceil(math.log2(here.shape[1] / ENOUGH_WIDTH)))
        flow = self._whole(halvings, here, there, guess)
        for box in boxes:
            near = np.ascontiguousarray(here[box]), np.ascontiguousarray(there[box])
            start = flow[box] if guess is None else _better(*near, flow[box], guess[box])
            flow[box] = _dis(0).calc(*near, np.ascontiguousarray(start))
        return flow

    def _whole(self, finest: int, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
        """Flow between whole gray pictures, by an object of this thread and their size, which keeps its buffers."""
        key = finest, *a.shape
        if key not in self._kept.dis:
            self._kept.dis[key] = _dis(finest)
        start = None if guess is None else guess.astype(np.float32)  # a copy: it is written to
        return self._kept.dis[key].calc(a, b, start)


def _dis(finest: int) -> Any:
    """OpenCV's object, which halves pictures until it ends at those halved `finest` times.

    It must not see a second size: its buffers are of the first, and it looks past their ends in a larger one.
    """
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(finest)
    return dis


def _better(a: np.ndarray, b: np.ndarray, flow: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Flow between gray pictures, but the guess wherever it takes a pixel and those around it to more alike ones."""
    y, x = np.mgrid[: a.shape[0], : a.shape[1]].astype(np.float32)
    a, b = (cv2.blur(gray, (PATCH, PATCH)) for gray in (a, b))  # a guess may be some pixels wrong
    errors = []
    for way in (flow, guess):
        met = cv2.remap(b, x + way[..., 0], y + way[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        errors.append(cv2.blur(cv2.absdiff(a, met).astype(np.float32), (PATCH, PATCH)))
    return np.where((errors[1] < errors[0])[..., None], guess, flow)


def _boxes(wanted: np.ndarray, guess: np.ndarray | None) -> list[Box]:
    """Boxes that hold these pixels, what is in reach of them, and where a guess takes them; none is too small for DIS."""
    reach = max(round(REACH * wanted.shape[1]), REACH_LEAST)
    side = 2 * reach + 1
    near = cv2.dilate(wanted.astype(np.uint8), np.ones((side, side), np.uint8))
    boxes = []
    for part in cv2.connectedComponentsWithStats(near)[2][1:].tolist():
        x, y, width, height = part[:4]
        rows, columns = slice(y, y + height), slice(x, x + width)
        if guess is not None:
            ways = guess[rows, columns][wanted[rows, columns]]
            rows, columns = (_stretched(span, ways[:, axis]) for span, axis in ((rows, 1), (columns, 0)))
        rows, columns = (_within(span, size, side) for span, size in zip((rows, columns), wanted.shape, strict=True))
        boxes.append((rows, columns))
    return boxes


def _stretched(span: slice, ways: np.ndarray) -> slice:
    """Pixels of one axis and where these ways take them."""
    return slice(span.start + math.floor(min(ways.min(), 0)), span.stop + math.ceil(max(ways.max(), 0)))


def _within(span: slice, size: int, least: int) -> slice:
    """The part that a picture of a size has, at least so many pixels if it has them."""
    start, stop = max(span.start, 0), min(span.stop, size)
    start = max(min(start, size - least), 0)
    return slice(start, min(max(stop, start + least), size))


def _area(box: Box) -> int:
    rows, columns = box
    return (rows.stop - rows.start) * (columns.stop - columns.start)


class RaftFlow:
    """RAFT (Teed and Deng 2020), the paper's flow, as torchvision implements it (extra `splatreel[models]`).

    weights: path of a state dict; None looks at the environment variable SPLATREEL_RAFT_WEIGHTS, then in torch's cache. Nothing is
    downloaded. model: a ready network in place of raft_large with those weights. Raises `MissingDependencyError` where torchvision
    or the weights are missing.
    """

    def __init__(
        self, weights: Path | None = None, device: str | None = None, updates: int = 20, model: Any = None
    ) -> None:
        import torch

        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.updates = updates
        self.model = (model if model is not None else _load_raft(weights)).to(self.device).eval()

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        """It compares all pixels with all, whatever is wanted, and needs no guess."""
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
    import torch

    def load() -> Any:
        from torchvision.models.optical_flow import raft_large

        return raft_large

    raft_large, path = RAFT.imported(load), RAFT.weights(weights)
    model = raft_large(weights=None)
    try:
        model.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises a dozen types for a damaged file
        raise MissingDependencyError(
            f"{path}: these are not weights of torchvision's raft_large ({type(error).__name__}). Download {RAFT.url} again."
        ) from error
    return model
