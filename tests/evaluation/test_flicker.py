"""Flicker of images whose changes have a known error."""

import dataclasses

import numpy as np
import pytest

from splatreel.codec.reader import ReelReader
from splatreel.evaluation.flicker import Flicker, border_frames
from tests.evaluation import scenes


def make_images(levels: list[float]) -> list[np.ndarray]:
    return [np.full((4, 6, 3), level / 255, np.float32) for level in levels]


def test_motion_like_the_truth_has_no_flicker() -> None:
    flicker = Flicker(set())
    truths = make_images([10, 30, 90, 20])
    for frame, truth in enumerate(truths):
        flicker.add(frame, "a", truth + 0.1, truth)
    assert flicker.mean(at_borders=False) == pytest.approx(0, abs=1e-3)
    assert flicker.mean(at_borders=True) is None


def test_flicker_separates_borders_from_other_frames() -> None:
    flicker = Flicker({2})
    truth = make_images([50])[0]
    for frame, image in enumerate(make_images([50, 51, 56, 56])):
        for camera in ("a", "b"):
            flicker.add(frame, camera, image, truth)
    assert flicker.mean(at_borders=True) == pytest.approx(5, abs=1e-3)
    assert flicker.mean(at_borders=False) == pytest.approx(0.5, abs=1e-3)


def test_flicker_ignores_nonconsecutive_frames() -> None:
    flicker = Flicker(set())
    for frame, image in zip([0, 4, 8], make_images([0, 50, 100]), strict=True):
        flicker.add(frame, "a", image, image * 0)
    assert flicker.mean(at_borders=False) is None


def test_border_frames_cover_cross_fades_and_cuts(tmp_path) -> None:
    manifest = ReelReader(scenes.write_reel(tmp_path / "reel")).manifest
    assert border_frames(manifest) == set(), "one group has none"
    first = manifest.groups[0]
    two = [first, dataclasses.replace(first, first_frame=30)]
    assert border_frames(dataclasses.replace(manifest, groups=two, overlap=3)) == {31, 32, 33}
    assert border_frames(dataclasses.replace(manifest, groups=two, overlap=0)) == {30}
