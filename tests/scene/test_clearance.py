import numpy as np
import pytest

from splatreel.scene.clearance import NONE, Clearance
from tests.method.scenes import look_at

ROOM = Clearance((0.0, 0.0, 0.0), 0.25)


@pytest.mark.parametrize(("away", "depth"), [(4.0, 1.0), (8.0, 2.0), (0.4, 0.1)])
def test_clearance_shrinks_near_the_focus(away: float, depth: float) -> None:
    assert ROOM.depth(look_at([0, 0, -away])) == pytest.approx(depth)
    assert NONE.depth(look_at([0, 0, -away])) == 0


def test_clearance_shrinks_when_looking_away() -> None:
    assert ROOM.depth(look_at([0, 0, -4], target=[0, 0, -9])) == 0
    assert 0 < ROOM.depth(look_at([0, 0, -4], target=[2, 0, -2])) < 0.8


def test_clearance_hides_only_near_points_in_front() -> None:
    camera = look_at([0, 0, -4])
    points = np.array([[0, 0, -3.5], [2, 0, -3.01], [0, 0, -2.99], [0, 0, 1], [0, 0, -4.5]], np.float32)
    assert ROOM.hides(points, camera).tolist() == [True, True, False, False, False]
    assert not NONE.hides(points, camera).any()
