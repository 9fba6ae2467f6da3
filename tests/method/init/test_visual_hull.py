import numpy as np

from splatreel.capture.masks import LIKELY, UNLIKELY
from splatreel.method.init.visual_hull import VisualHull, is_sparse, without_background
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


def test_places_are_inside_by_unlikely_pixels_of_one_camera_only() -> None:
    masks, origin = masks_of_box(5), np.zeros((1, 3))
    masks[2][masks[2] > 0] = UNLIKELY
    assert VisualHull(ring(5), masks).contains(origin)[0]
    masks[1][masks[1] > 0] = LIKELY
    assert VisualHull(ring(5), masks).contains(origin)[0]
    masks[4][masks[4] > 0] = UNLIKELY
    assert not VisualHull(ring(5), masks).contains(origin)[0]


def test_angle_between_cameras_decides_whether_a_rig_is_sparse() -> None:
    assert is_sparse(scenes.ring(6)), "60 degrees apart"
    assert not is_sparse(scenes.ring(24)), "15 degrees apart"
    assert not is_sparse(scenes.ring(1))


def test_pixels_outside_of_masks_take_the_nearest_color_inside() -> None:
    images = np.full((2, 32, 48, 3), (0, 255, 255), np.uint8)
    images[:, 12:20, 20:24] = 10
    images[:, 12:20, 24:28] = 90
    masks = masks_of_box(2)
    masks[1] = 0
    found = without_background(images, masks)
    assert (found[0, :, :22] == 10).all()
    assert (found[0, :, 26:] == 90).all()
    assert (found[1] == images[1]).all(), "no pixel is inside"
