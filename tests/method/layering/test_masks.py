"""Motion masks and their completion."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.config import LayeringConfig
from splatreel.method.images.flow import DisFlow
from splatreel.method.layering.masks import FLOW_WIDTH, GrabCutSegmenter, later_frames, make_segmenter, motion_masks

CONFIG = LayeringConfig()


def noise(height: int, width: int, seed: int) -> np.ndarray:
    smooth = cv2.GaussianBlur(np.random.default_rng(seed).random((height, width, 3)).astype(np.float32), (0, 0), 1.5)
    return (255 * (smooth - smooth.min()) / (smooth.max() - smooth.min())).astype(np.uint8)


def sliding_square(steps: list[int]) -> np.ndarray:
    """Return a textured square of 30 pixels, `steps` pixels to the right of its start; [T, 1, H, W, 3]."""
    background, square = noise(100, 160, 0), noise(30, 30, 1)
    frames = np.repeat(background[None, None], len(steps), 0).copy()
    for frame, step in zip(frames, steps, strict=True):
        frame[0, 40:70, 40 + step : 70 + step] = square
    return frames


class ConstantFlow:
    """Constant flow in pixels of an image of a certain width; smaller images have less."""

    def __init__(self, pixels: float, width: int | None = None) -> None:
        self.pixels, self.width = pixels, width

    def __call__(self, a: np.ndarray, b: np.ndarray, guess=None, wanted=None) -> np.ndarray:
        scale = a.shape[1] / (self.width or a.shape[1])
        return np.full((*a.shape[:2], 2), self.pixels * scale / np.sqrt(2), np.float32)


def test_masks_find_moving_square() -> None:
    mask = motion_masks(sliding_square([0, 2, 4, 6]), DisFlow(), CONFIG)[0]
    assert mask[42:68, 42:68].mean() > 0.95
    assert mask[:25].sum() == 0
    assert mask[:, :25].sum() == 0
    assert mask[:, 100:].sum() == 0


def test_masks_find_returning_motion_by_intermediate_frames() -> None:
    frames = sliding_square([0, 3, 6, 3, 0])
    assert not motion_masks(frames, DisFlow(), replace(CONFIG, flow_frames=1)).any()
    assert motion_masks(frames, DisFlow(), replace(CONFIG, flow_frames=4))[0, 42:68, 42:68].mean() > 0.95


class FlowWhereDifferent:
    """Flow of 5 pixels wherever the frames differ, the same in both directions: it never returns."""

    def __call__(self, a: np.ndarray, b: np.ndarray, guess=None, wanted=None) -> np.ndarray:
        flow = np.zeros((*a.shape[:2], 2), np.float32)
        flow[(a != b).any(-1), 0] = 5
        return flow


def test_masks_exclude_passed_background() -> None:
    frames = np.repeat(noise(100, 160, 0)[None, None], 8, 0)
    frames[3, 0, 40:70, 44:74] = 255 - frames[3, 0, 40:70, 44:74]
    alone = motion_masks(frames[[0, 3]], FlowWhereDifferent(), replace(CONFIG, flow_frames=1))[0]
    assert alone[42:68, 46:72].all(), "to the paper's rule it looks like motion"
    assert not motion_masks(frames, FlowWhereDifferent(), CONFIG).any()
    frames[4:6] = frames[3]
    assert motion_masks(frames, FlowWhereDifferent(), CONFIG)[0, 42:68, 46:72].all()


def test_masks_find_late_motion() -> None:
    mask = motion_masks(sliding_square([0, 0, 0, 0, 0, 0, 0, 3]), DisFlow(), CONFIG)[0]
    assert mask[44:66, 44:64].mean() > 0.8


def test_nothing_moves_and_everything_moves() -> None:
    still = np.repeat(noise(60, 80, 0)[None, None], 3, 0)
    assert not motion_masks(still, DisFlow(), CONFIG).any()
    changing = np.stack([noise(60, 80, s) for s in range(3)])[:, None]
    assert motion_masks(changing, ConstantFlow(5), CONFIG).all()


def test_flow_threshold_scales_with_width() -> None:
    frames = np.stack([noise(20, 1352, s) for s in range(2)])[:, None]
    assert not motion_masks(frames, ConstantFlow(1.9, 1352), CONFIG).any()
    assert motion_masks(frames, ConstantFlow(2.1, 1352), CONFIG).all()
    assert not motion_masks(frames[:, :, :, :676], ConstantFlow(0.9, 676), CONFIG).any()
    assert motion_masks(frames[:, :, :, :676], ConstantFlow(1.1, 676), CONFIG).all()
    assert not motion_masks(frames[:, :, :, :64], ConstantFlow(0.4), CONFIG).any(), "half a pixel is noise at any width"


def test_masks_of_large_images_use_small_flow() -> None:
    """The scene at four and eight times the size has the same flow, and masks of the image size."""
    small, widths = sliding_square([0, 2, 4, 6]), []
    dis = DisFlow()

    def flow(a: np.ndarray, b: np.ndarray, guess=None, wanted=None) -> np.ndarray:
        widths.append(a.shape[1])
        return dis(a, b)

    for scale in (2, 4, 8):
        large = small.repeat(scale, 2).repeat(scale, 3)
        mask = motion_masks(large, flow, CONFIG)[0]
        assert mask.shape == (100 * scale, 160 * scale)
        assert mask[42 * scale : 68 * scale, 42 * scale : 68 * scale].mean() > 0.95
        assert not mask[: 25 * scale].any()
        assert not mask[:, 100 * scale :].any()
    assert set(widths) == {FLOW_WIDTH}


def test_masks_ignore_flow_without_color_change() -> None:
    frames = np.repeat(noise(40, 60, 0)[None, None], 2, 0)
    assert not motion_masks(frames, ConstantFlow(9), CONFIG).any()


def test_later_frames() -> None:
    assert later_frames(31, 1) == [30]
    assert later_frames(31, 3) == [10, 20, 30]
    assert later_frames(3, 7) == [1, 2]
    assert later_frames(1, 7) == []


def disc(radius: int) -> np.ndarray:
    y, x = np.mgrid[:120, :160]
    return (x - 80) ** 2 + (y - 60) ** 2 < radius**2


def test_grabcut_completes_an_object_and_stops_at_its_border() -> None:
    rng = np.random.default_rng(0)
    image = np.where(disc(20)[..., None], [200, 40, 40], [40, 90, 160]) + rng.integers(-8, 8, (120, 160, 3))
    seed = disc(17)
    completed = GrabCutSegmenter(reach=0.05).complete(seed[None], image.astype(np.uint8)[None])[0]
    assert (completed & disc(20)).sum() / disc(20).sum() > 0.97
    assert (completed & ~disc(21)).sum() == 0


def test_grabcut_does_not_grow_without_border() -> None:
    rng = np.random.default_rng(0)
    image = (120 + rng.integers(-8, 8, (120, 160, 3))).astype(np.uint8)
    completed = GrabCutSegmenter(reach=0.05).complete(disc(17)[None], image[None])[0]
    assert (completed & disc(17)).sum() == disc(17).sum()
    assert completed.sum() < 1.3 * disc(17).sum()


@pytest.mark.parametrize("value", [False, True])
def test_grabcut_keeps_empty_and_full_masks(value: bool) -> None:
    masks = np.full((2, 40, 60), value)
    images = np.stack([noise(40, 60, s) for s in range(2)])
    np.testing.assert_array_equal(GrabCutSegmenter().complete(masks, images), masks)


def test_make_segmenter_by_name() -> None:
    assert make_segmenter("none") is None
    assert isinstance(make_segmenter("grabcut"), GrabCutSegmenter)
    with pytest.raises(UsageError, match="'watershed'"):
        make_segmenter("watershed")
