import numpy as np

from splatreel.method.init.visual_hull import VisualHull, hull_of_few
from tests.method.scenes import ring
from tests.segmentation import scenes


def masks_of_box(count: int) -> np.ndarray:
    """Masks of a square in the middle of all images."""
    masks = np.zeros((count, 32, 48), np.uint8)
    masks[:, 12:20, 20:28] = 255
    return masks


def test_hull_holds_what_all_cameras_show_in_their_masks() -> None:
    hull = VisualHull(ring(5), masks_of_box(5))
    inside = np.array([[0.0, 0, 0], [0.2, 0, 0.1]])
    outside = np.array([[1.5, 0, 0], [0, 0.9, 0], [0, 0, 2.0], [0, 0, -50.0]])
    assert hull.contains(inside).tolist() == [True, True]
    assert hull.contains(outside).tolist() == [False] * 4
    assert hull.contains(inside[:, None]).shape == (2, 1)


def test_one_bad_mask_of_ten_removes_nothing() -> None:
    masks = masks_of_box(10)
    masks[3] = 0
    origin = np.zeros((1, 3))
    assert VisualHull(ring(10), masks).contains(origin)[0]
    masks[4] = 0
    assert not VisualHull(ring(10), masks).contains(origin)[0]


def test_faint_edges_of_soft_masks_are_outside() -> None:
    masks = masks_of_box(5)
    masks[masks == 0] = 30
    assert not VisualHull(ring(5), masks).contains(np.array([[1.5, 0, 0]]))[0]


def test_angle_between_cameras_decides_whether_points_must_stay_in_the_hull() -> None:
    def hull(count: int) -> VisualHull | None:
        masks = np.full((count, scenes.HEIGHT, scenes.WIDTH), 255, np.uint8)
        return hull_of_few(scenes.ring(count), masks, 0.0)

    assert hull(6) is not None, "60 degrees apart"
    assert hull(24) is None, "15 degrees apart"
    assert hull_of_few(scenes.ring(6), None, 0.0) is None
