"""Object-level completion of motion masks by SAM2 (paper section 4.1), behind the extra `splatreel[models]`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splatreel.motion.pretrained import Pretrained

SAM2 = Pretrained(
    purpose="SAM2 completion",
    package="the package sam2",
    file="sam2.1_hiera_large.pt",
    url="https://dl.fbaipublicfiles.com/segment_anything_2/092824/sam2.1_hiera_large.pt",
    variable="SPLATREEL_SAM2_WEIGHTS",
    remedy="use the segmenter 'grabcut'",
)
SAM2_CONFIG = "configs/sam2.1/sam2.1_hiera_l.yaml"
LEAST_AREA = 0.0005
"""Share of the image; smaller parts of a mask prompt nothing."""


class Sam2Segmenter:
    """SAM2 (Ravi et al. 2024): the view with the largest mask prompts it, and the views, taken as a video, carry the objects on.

    weights: a SAM2 checkpoint that fits `config`; None looks at SPLATREEL_SAM2_WEIGHTS, then in torch's cache. Nothing is downloaded.
    predictor: a ready video predictor in their place. Every part of the mask is an object with up to `points` prompts. Raises
    `MissingDependencyError` where the package or the weights are missing.
    """

    def __init__(
        self,
        weights: Path | None = None,
        config: str = SAM2_CONFIG,
        device: str | None = None,
        objects: int = 8,
        points: int = 5,
        seed: int = 0,
        predictor: Any = None,
    ) -> None:
        self.predictor = predictor if predictor is not None else _load_predictor(weights, config, device)
        self.objects = objects
        self.points = points
        self.seed = seed

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray:
        """See `Segmenter`: the given masks with SAM2's added (M = M_raft + M_sam)."""
        completed = masks.copy()
        start = int(masks.sum((1, 2)).argmax())
        prompts = object_prompts(masks[start], self.objects, self.points, self.seed)
        if not prompts:
            return completed
        with tempfile.TemporaryDirectory() as folder:
            for i, image in enumerate(images):  # the predictor reads a video as numbered JPEG files
                cv2.imwrite(str(Path(folder) / f"{i:05d}.jpg"), np.ascontiguousarray(image[..., ::-1]))
            state = self.predictor.init_state(video_path=folder)
            for number, pixels in enumerate(prompts, 1):
                self.predictor.add_new_points_or_box(
                    inference_state=state,
                    frame_idx=start,
                    obj_id=number,
                    points=pixels,
                    labels=np.ones(len(pixels), np.int32),
                )
            for view, found in self._propagate(state, start):
                completed[view] |= found
        return completed

    def _propagate(self, state: Any, start: int) -> Iterator[tuple[int, np.ndarray]]:
        """Every view and the union of the objects' masks in it, [H, W] bool, in both directions from the prompted view."""
        for reverse in (False, True):
            passes = self.predictor.propagate_in_video(state, start_frame_idx=start, reverse=reverse)
            for view, _, logits in passes:
                yield int(view), (logits > 0).any(0)[0].cpu().numpy()


def object_prompts(mask: np.ndarray, objects: int, points: int, seed: int) -> list[np.ndarray]:
    """Points inside the largest connected parts of a mask [H, W], one array [P, 2] float32 of pixels (x, y) a part.

    The first is the one farthest from the part's border, where a prompt is least ambiguous; the others are drawn at random.
    """
    rng = np.random.default_rng(seed)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    areas = stats[1:count, cv2.CC_STAT_AREA]
    prompts = []
    for part in np.argsort(-areas, kind="stable")[:objects]:
        if areas[part] < LEAST_AREA * mask.size:
            break
        inside = np.pad((parts == part + 1).astype(np.uint8), 1)
        depth = cv2.distanceTransform(inside, cv2.DIST_L2, 3)[1:-1, 1:-1]
        deepest = np.unravel_index(int(depth.argmax()), depth.shape)
        rows, columns = np.nonzero(depth >= 0.5 * depth.max())
        chosen = rng.choice(len(rows), min(points - 1, len(rows)), replace=False)
        places = [(deepest[1], deepest[0]), *zip(columns[chosen], rows[chosen], strict=True)]
        prompts.append(np.array(places, np.float32) + 0.5)
    return prompts


def _load_predictor(weights: Path | None, config: str, device: str | None) -> Any:
    import torch

    def load() -> Any:
        from sam2.build_sam import build_sam2_video_predictor

        return build_sam2_video_predictor

    build, path = SAM2.imported(load), SAM2.weights(weights)
    return build(config, str(path), device=device or ("cuda" if torch.cuda.is_available() else "cpu"))
