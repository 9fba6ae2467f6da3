import xml.etree.ElementTree as ElementTree

import numpy as np

from splatreel.evaluation.page.rig_plan import LETTER, LINE, SIDE, RigPlan
from splatreel.scene.camera import Camera, facing


def ring(count: int) -> list[Camera]:
    """Return cameras around the y axis at a height of 1, looking at it."""
    angles = 2 * np.pi * np.arange(count) / count
    centers = np.stack([3 * np.cos(angles), np.ones(count), 3 * np.sin(angles)], 1)
    return [facing(f"c{i}", c, -c / np.linalg.norm(c), 50.0, 64, 48) for i, c in enumerate(centers)]


def marks(svg: str) -> dict[str, tuple[str, float, float]]:
    """Return kind and place of each camera by its name."""
    found = {}
    for group in ElementTree.fromstring(svg).iter("g"):
        title, _, mark = group
        shift = 4 if mark.tag == "rect" else 0
        x, y = (float(mark.attrib.get(n) or mark.attrib[f"c{n}"]) + shift for n in "xy")
        found[title.text] = group.attrib["class"], x, y
    return found


def test_plan_shows_a_ring_and_elevation_a_line() -> None:
    cameras = ring(6)
    drawn = RigPlan(cameras[:5], cameras[5:], np.array([0.0, 1, 0]), np.zeros((1, 3))).drawings()
    plan, elevation = map(marks, drawn)
    assert [kind for kind, _, _ in plan.values()] == ["train"] * 5 + ["held"]
    places = np.array([place[1:] for place in plan.values()])
    assert ((places > 0) & (places < SIDE)).all()
    distances = np.linalg.norm(places - places.mean(0), axis=1)
    np.testing.assert_allclose(distances, distances.mean(), rtol=0.01)
    heights = {y for _, _, y in elevation.values()}
    assert max(heights) - min(heights) < 1


def test_names_cover_neither_each_other_nor_cameras() -> None:
    """Two rows of seven cameras, as in a studio: most names have room, and all are in the drawing."""
    cameras = [
        facing(f"cam{i:02d}", np.array([i // 2, i % 2, 0.3 * (i % 2)]), np.array([0.0, 0, 1]), 50.0, 64, 48)
        for i in range(14)
    ]
    for drawing in RigPlan(cameras, [], np.array([0.0, 1, 0]), np.zeros((0, 3))).drawings():
        svg = ElementTree.fromstring(drawing)
        names = [(float(e.attrib["x"]), float(e.attrib["y"])) for e in svg.iter("text")]
        assert len(names) >= 7
        boxes = [(x, y - LINE, x + 5 * LETTER, y) for x, y in names]
        points = [place[1:] for place in marks(drawing).values()]
        assert all(a >= 0 and c <= SIDE and b >= 0 and d <= SIDE for a, b, c, d in boxes)
        assert not any(a < x < c and b < y < d for a, b, c, d in boxes for x, y in points)
        pairs = [(p, q) for i, p in enumerate(boxes) for q in boxes[:i]]
        assert not any(p[0] < q[2] and q[0] < p[2] and p[1] < q[3] and q[1] < p[3] for p, q in pairs)


def test_higher_cameras_are_higher_in_the_elevation() -> None:
    low = facing("low", np.array([0.0, 0, -3]), np.array([0.0, 0, 1]), 50.0, 64, 48)
    high = facing("high", np.array([0.5, 2, -3]), np.array([0.0, 0, 1]), 50.0, 64, 48)
    plan, elevation = map(marks, RigPlan([low, high], [], np.array([0.0, 1, 0]), np.zeros((0, 3))).drawings())
    assert elevation["high"][2] < elevation["low"][2]
    assert plan["high"][2] == plan["low"][2]
