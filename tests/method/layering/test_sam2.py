"""Completion of masks by SAM2, with a replaced predictor."""

import sys
import types
from pathlib import Path

import cv2
import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError
from splatreel.method.layering.masks import make_segmenter
from splatreel.method.layering.sam2 import SAM2, Sam2Segmenter, object_prompts


class Predictor:
    """Replacement of SAM2's video predictor. An object is every pixel of a view that is as bright as the prompted ones."""

    def init_state(self, video_path: str) -> dict:
        files = sorted(Path(video_path).glob("*.jpg"))
        return {"views": [cv2.imread(str(f), cv2.IMREAD_GRAYSCALE).astype(float) for f in files], "objects": {}}

    def add_new_points_or_box(self, inference_state, frame_idx, obj_id, points, labels) -> None:
        assert (labels == 1).all()
        x, y = points.astype(int).T
        inference_state["objects"][obj_id] = inference_state["views"][frame_idx][y, x].mean()
        inference_state["start"] = frame_idx

    def propagate_in_video(self, state, start_frame_idx, reverse):
        torch = pytest.importorskip("torch")
        assert start_frame_idx == state["start"]
        views = range(start_frame_idx, -1, -1) if reverse else range(start_frame_idx, len(state["views"]))
        for v in views:
            logits = np.stack([10 - np.abs(state["views"][v] - level) for level in state["objects"].values()])
            yield v, list(state["objects"]), torch.from_numpy(logits)[:, None]


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Return three views of a bright box that moves with the view; the mask covers half of it in the middle view."""
    images = np.full((3, 64, 96, 3), 30, np.uint8)
    for v in range(3):
        images[v, 16:48, 16 + 8 * v : 48 + 8 * v] = 220
    masks = np.zeros((3, 64, 96), bool)
    masks[1, 16:32, 24:56] = True
    return masks, images


def test_sam2_completes_objects_in_all_views() -> None:
    masks, images = scene()
    completed = Sam2Segmenter(predictor=Predictor()).complete(masks, images)
    for v in range(3):
        assert completed[v, 18:46, 18 + 8 * v : 46 + 8 * v].all()
        assert completed[v].sum() < 1.1 * 32 * 32
    assert masks.sum() == 16 * 32, "the masks given are not written to"


def test_sam2_empty_mask_prompts_nothing() -> None:
    masks, images = scene()
    assert not Sam2Segmenter(predictor=Predictor()).complete(np.zeros_like(masks), images).any()


def test_object_prompts_lie_in_parts_largest_first() -> None:
    mask = np.zeros((50, 70), bool)
    mask[5:15, 5:15] = True
    mask[20:45, 30:60] = True
    mask[48, 2] = True
    prompts = object_prompts(mask, objects=4, points=5, seed=0)
    assert [p.shape for p in prompts] == [(5, 2), (5, 2)]
    for points, (left, right) in zip(prompts, [(30, 60), (5, 15)], strict=True):
        x, y = points.astype(int).T
        assert mask[y, x].all()
        assert (x >= left).all()
        assert (x < right).all()
    assert len(object_prompts(mask, objects=1, points=5, seed=0)) == 1


def test_sam2_without_package_or_weights_raises(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "sam2", None)
    monkeypatch.setitem(sys.modules, "sam2.build_sam", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[models\]"):
        make_segmenter("sam2")
    package, build = types.ModuleType("sam2"), types.ModuleType("sam2.build_sam")
    monkeypatch.setattr(
        build, "build_sam2_video_predictor", lambda config, path, device: (config, path, device), raising=False
    )
    monkeypatch.setitem(sys.modules, "sam2", package)
    monkeypatch.setitem(sys.modules, "sam2.build_sam", build)
    weights = tmp_path / "weights.pt"
    monkeypatch.setenv(SAM2.variable, str(weights))
    with pytest.raises(MissingDependencyError, match=r"weights\.pt does not exist"):
        make_segmenter("sam2")
    weights.write_bytes(b"")
    pytest.importorskip("torch")
    segmenter = make_segmenter("sam2")
    assert isinstance(segmenter, Sam2Segmenter)
    assert segmenter.predictor[1] == str(weights)
