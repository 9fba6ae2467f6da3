from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.evaluation.comparison_images import (
    chosen_frames,
    comparison,
    image_file,
    layers_overlay,
    write_images,
    write_png,
)
from splatreel.play.timeline import open_reel
from tests.evaluation import scenes


def test_comparison_shows_truth_render_and_error(tmp_path: Path) -> None:
    truth, render = np.full((4, 5, 3), 0.5, np.float32), np.full((4, 5, 3), 0.6, np.float32)
    strip = comparison(truth, render)
    assert strip.shape == (4, 15, 3)
    assert [int(strip[0, x, 0]) for x in (0, 5, 10)] == [128, 153, 102]
    write_png(tmp_path / "made" / "a.png", strip)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "made" / "a.png")), strip)
    assert [p.name for p in (tmp_path / "made").iterdir()] == ["a.png"]


def test_worst_and_median_frame_are_chosen() -> None:
    assert chosen_frames({0: 30.0, 1: 25.0, 2: 31.0, 3: 29.0, 4: 32.0}) == {"worst": 1, "median": 0}
    assert chosen_frames({7: 30.0}) == {"worst": 7, "median": 7}
    assert chosen_frames({1: 20.0, 2: 30.0}) == {"worst": 1, "median": 1}


def test_overlay_is_blue_where_points_move(tmp_path: Path) -> None:
    timeline = open_reel(scenes.write_reel(tmp_path / "reel"))
    moment, view = timeline.at(0), scenes.cameras()[2]
    gray = np.full((scenes.HEIGHT, scenes.WIDTH, 3), 0.5, np.float32)
    blueness = np.ptp(layers_overlay(timeline, moment, view, gray).astype(int), axis=-1)
    object.__setattr__(moment, "is_static", np.ones(len(moment), bool))
    assert not np.ptp(layers_overlay(timeline, moment, view, gray).astype(int), axis=-1).any()
    object.__setattr__(moment, "is_static", np.zeros(len(moment), bool))
    all_blue = np.ptp(layers_overlay(timeline, moment, view, gray).astype(int), axis=-1)
    assert 0 < blueness.sum() < all_blue.sum()


def test_images_of_each_camera_are_written(tmp_path: Path) -> None:
    timeline = open_reel(scenes.write_reel(tmp_path / "reel"))
    psnr = {"cam00": {0: 30.0, 1: 20.0, 2: 31.0}, "cam03": {0: 30.0}}
    capture = scenes.capture(tmp_path)
    write_images(tmp_path / "pictures", timeline, capture, psnr)
    for kind, width in (("worst", 3), ("median", 3), ("layers", 1)):
        for name in psnr:
            image = Image.open(image_file(tmp_path / "pictures", kind, name))
            assert image.size == (width * scenes.WIDTH, scenes.HEIGHT)
    worst = np.asarray(Image.open(image_file(tmp_path / "pictures", "worst", "cam00")))
    np.testing.assert_array_equal(worst[:, : scenes.WIDTH], capture.read(1, 1, ["cam00"])[0, 0])
