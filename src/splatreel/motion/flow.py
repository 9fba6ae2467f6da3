"""Optical flow between two frames of one camera (paper section 4.1, 2D motion segmentation)."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, TypeVar

import cv2
import numpy as np

from splatreel.errors import MissingDependencyError, UsageError

T = TypeVar("T")

RAFT_FILE = "raft_large_C_T_SKHT_V2-ff5fadd5.pth"
RAFT_URL = f"https://download.pytorch.org/models/{RAFT_FILE}"
RAFT_VARIABLE = "SPLATREEL_RAFT_WEIGHTS"
RAFT_LEAST = 128
"""RAFT's correlation pyramid needs at least this many pixels a side."""


class Flow(Protocol):
    """Where the pixels of frame a go in frame b. a, b: [H, W, 3] uint8 sRGB. Returns [H, W, 2] float32, x and y in pixels.

    guess: [H, W, 2], where they are likely to go; what is small and fast is out of reach of a coarse-to-fine search without it.
    """

    def __call__(self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray: ...


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


class DisFlow:
    """Dense inverse search (Kroeger et al. 2016) by OpenCV: classical, fast, needs no weights. Threads may share it."""

    def __init__(self) -> None:
        self._own = threading.local()

    @property
    def _dis(self) -> Any:
        """OpenCV's object of this thread: it keeps its buffers."""
        if not hasattr(self._own, "dis"):
            self._own.dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
            self._own.dis.setFinestScale(0)
        return self._own.dis

    def __call__(self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        grays = [cv2.cvtColor(np.ascontiguousarray(x), cv2.COLOR_RGB2GRAY) for x in (a, b)]
        least = min(a.shape[:2])
        if least < 16:  # below DIS's patch pyramid; nothing goes far in such images
            grays, guess = [cv2.resize(g, None, fx=16 / least, fy=16 / least) for g in grays], None
        flow = self._dis.calc(*grays, None if guess is None else guess.astype(np.float32))  # a copy: it is written to
        if least < 16:
            flow = cv2.resize(flow, (a.shape[1], a.shape[0]), interpolation=cv2.INTER_AREA) * (least / 16)
        return np.ascontiguousarray(flow, np.float32)


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

    def __call__(self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """It compares all pixels with all, and needs no guess."""
        import torch

        height, width = a.shape[:2]
        # The network halves its input three times: pad to multiples of 8 by repeating the border.
        below = max(-height % 8, RAFT_LEAST - height)
        right = max(-width % 8, RAFT_LEAST - width)
        pair = np.pad(np.stack([a, b]), ((0, 0), (0, below), (0, right), (0, 0)), mode="edge")
        frames = torch.from_numpy(pair).to(self.device).permute(0, 3, 1, 2).float() / 127.5 - 1
        with torch.inference_mode():
            flow = self.model(frames[:1], frames[1:], num_flow_updates=self.updates)[-1]
        return np.ascontiguousarray(flow[0, :, :height, :width].permute(1, 2, 0).float().cpu().numpy())


def _load_raft(weights: Path | None) -> Any:
    import torch

    try:
        from torchvision.models.optical_flow import raft_large
    except (ImportError, RuntimeError) as error:  # a build for another torch fails with RuntimeError
        raise MissingDependencyError(
            f"RAFT flow needs torchvision, which cannot be imported ({error}). "
            "Run: pip install 'splatreel[models]', with the torchvision that fits your torch; or use the flow 'dis'."
        ) from error
    path = weights_path(weights, RAFT_VARIABLE, RAFT_FILE)
    if not path.is_file():
        raise MissingDependencyError(
            f"RAFT flow needs its weights, and {path} does not exist. Download {RAFT_URL} to that place, or set "
            f"{RAFT_VARIABLE} to where the file is; or use the flow 'dis'."
        )
    model = raft_large(weights=None)
    try:
        model.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises a dozen types for a damaged file
        raise MissingDependencyError(
            f"{path}: these are not weights of torchvision's raft_large ({type(error).__name__}). Download {RAFT_URL} again."
        ) from error
    return model


def weights_path(given: Path | None, variable: str, file: str) -> Path:
    """Where a model's weights are looked for: the given path, the environment variable, torch's cache of downloads."""
    import torch

    if given is not None:
        return Path(given)
    if os.environ.get(variable):
        return Path(os.environ[variable])
    return Path(torch.hub.get_dir()) / "checkpoints" / file
