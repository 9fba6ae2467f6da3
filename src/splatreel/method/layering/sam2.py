"""Completion of motion masks to objects by SAM2 (paper section 4.1), with the extra `splatreel[models]`."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splatreel.base.errors import MissingDependencyError
from splatreel.method.images.pretrained import Pretrained

SAM2 = Pretrained(
    purpose="SAM2 completion",
    package="the package sam2",
    module="sam2.build_sam",
    file="sam2.1_hiera_large.pt",
    url="https://dl.fbaipublicfiles.com/segment_anything_2/092824/sam2.1_hiera_large.pt",
    variable="SPLATREEL_SAM2_WEIGHTS",
    remedy="use the segmenter 'grabcut'",
)
SAM2_CONFIG = "configs/sam2.1/sam2.1_hiera_l.yaml"
LEAST_AREA = 0.0005
"""Minimum area of a part of a mask to prompt SAM2, as a share of the image."""
MOST_OBJECTS, MOST_PROMPTS = 8, 5
"""Largest number of parts of a mask that prompt SAM2, each as an object, and of prompts of each."""


class Sam2Segmenter:
    """Segmenter by SAM2. The view with the largest mask prompts it; the views, taken as a video, propagate the objects.

    Source:
        Ravi et al. 2024.
    """

    def __init__(
        self,
        weights: Path | None = None,
        config: str = SAM2_CONFIG,
        device: str | None = None,
        predictor: Any = None,
    ) -> None:
        """Load the network. Nothing is downloaded. `weights` fit `config`; None uses SPLATREEL_SAM2_WEIGHTS or torch's cache.

        Missing packages or weights, or weights of another configuration, raise a `MissingDependencyError`.
        """
        self.predictor = predictor if predictor is not None else _load_predictor(weights, config, device)

    def complete(self, masks: np.ndarray, images: np.ndarray) -> np.ndarray:
        """Return the masks united with those of SAM2 (M = M_raft + M_sam); see `Segmenter`."""
        completed = masks.copy()
        start = int(masks.sum((1, 2)).argmax())
        prompts = object_prompts(masks[start], MOST_OBJECTS, MOST_PROMPTS, seed=0)
        if not prompts:
            return completed
        # SAM2 draws progress bars over the display of the run, and warns that its CUDA extension was not compiled.
        with tempfile.TemporaryDirectory() as folder, redirect_stderr(io.StringIO()):
            for i, image in enumerate(images):  # the predictor reads a folder of numbered JPEG files
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
        """Yield every view and the union of its objects' masks [H, W] bool, in both directions from the prompted view."""
        for reverse in (False, True):
            passes = self.predictor.propagate_in_video(state, start_frame_idx=start, reverse=reverse)
            for view, _, logits in passes:
                yield int(view), (logits > 0).any(0)[0].cpu().numpy()


def find_sam2() -> Sam2Segmenter | None:
    """Return SAM2 if the package and its weights are installed, else None."""
    try:
        return Sam2Segmenter()
    except MissingDependencyError:
        return None


def object_prompts(mask: np.ndarray, objects: int, points: int, seed: int) -> list[np.ndarray]:
    """Return prompts inside the largest connected parts of a mask: one array [P, 2] float32 of pixels (x, y) per part.

    The first prompt is farthest from the part's border, where it is least ambiguous; the others are random.
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
    build, path = SAM2.import_module().build_sam2_video_predictor, SAM2.find_weights(weights)
    import torch

    try:
        return build(config, str(path), device=device or ("cuda" if torch.cuda.is_available() else "cpu"))
    except (
        Exception
    ) as error:  # torch and SAM2 raise a dozen types for a damaged file or one of another size of the network
        raise MissingDependencyError(
            f"{path}: not the weights of SAM2 for {config} ({type(error).__name__}). Download {SAM2.url} again."
        ) from error
