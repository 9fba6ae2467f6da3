"""Tables of the benchmark of few cameras."""

import importlib
from pathlib import Path

import pytest


def test_cameras_are_grouped_by_their_angle(benchmarks: Path) -> None:
    few = importlib.import_module("few_cameras")
    cameras = [
        {"name": "a", "degrees": 26.0, "psnr": 20.0, "ssim": 0.7, "lpips": None},
        {"name": "b", "degrees": 8.0, "psnr": 25.0, "ssim": 0.8, "lpips": None},
        {"name": "c", "degrees": 24.0, "psnr": 22.0, "ssim": 0.6, "lpips": None},
    ]
    near, far = few.by_angle(cameras)
    assert near == {"degrees": 10, "cameras": ["b"], "psnr": 25.0, "ssim": 0.8}
    assert far == {"degrees": 25, "cameras": ["a", "c"], "psnr": 21.0, "ssim": pytest.approx(0.65)}


def test_small_parts_of_masks_are_not_counted(benchmarks: Path) -> None:
    import numpy as np

    masks = importlib.import_module("masks")
    mask = np.zeros((100, 100), bool)
    mask[20:60, 20:60] = mask[80:83, 80:83] = mask[97:, 50:53] = True
    found = masks.blobs(mask)
    assert found[80:83, 80:83].all()
    assert not found[20:60, 20:60].any()
    assert not found[97:, 50:53].any(), "a body that the border cuts"
