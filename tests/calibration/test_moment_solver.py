"""Moments are solved reproducibly, by SIFT or by a learned matcher."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.progress import Silent
from splatreel.calibration.calibrate import calibrate
from splatreel.calibration.learned_matches import Features
from splatreel.calibration.moment_solver import MomentSolver
from splatreel.capture.opening import open_capture
from tests.capture import folders
from tests.capture.rigs import SPREAD, images, rig

POINTS = 200


class KnownPoints:
    """Matcher that knows which camera and moment a flat image is of, and where that sees random points.

    Attributes:
        views: Positions of the points by camera, [moments, POINTS, 2].
    """

    def __init__(self, views: list[np.ndarray]) -> None:
        self.views = views

    def describe(self, image: np.ndarray) -> Features:
        camera, frame = folders.which(image)
        points = self.views[camera][frame].astype(np.float32)
        return Features(points, np.arange(POINTS, dtype=np.float32)[:, None], (640, 480))

    def match(self, one: Features, other: Features) -> np.ndarray:
        """Return the same points, a tenth of them wrong."""
        rows = np.arange(POINTS)
        return np.stack([rows, np.where(rows % 10, rows, rows[::-1])], 1)


@pytest.mark.slow
def test_learned_matches_place_cameras_without_features(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    space = np.random.default_rng(0).uniform(-SPREAD, SPREAD, (3, POINTS, 3))
    known = images(rig(colmap))[:6]  # colors of no more cameras are distinct
    views = [
        np.array([[image.camera.img_from_cam(image.cam_from_world() * point) for point in moment] for moment in space])
        for image in known
    ]
    for camera in range(len(known)):
        folders.write_video(tmp_path / f"cam{camera}.mp4", [folders.frame(camera, n, 640, 480) for n in range(3)])
    found = calibrate(tmp_path, Silent(), matcher=KnownPoints(views))
    assert (len(found.placed), found.lost, found.moments) == (6, [], 3)
    turns = np.stack([camera.viewmat[:3, :3] for camera in open_capture(tmp_path).cameras])
    true = np.stack([image.cam_from_world().rotation.matrix() for image in known])
    errors = (turns[1:] @ turns[:1].swapaxes(1, 2)) @ (true[1:] @ true[:1].swapaxes(1, 2)).swapaxes(1, 2)
    traces = np.trace(errors, axis1=1, axis2=2)
    assert np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1))).max() < 0.5


def test_images_are_numbered_in_order(tmp_path: Path) -> None:
    """The order must not depend on the time to extract features, because COLMAP's initial pairs depend on it."""
    colmap = pytest.importorskip("pycolmap")
    names = [f"{number}.png" for number in range(4)]
    solver = MomentSolver(colmap, tmp_path / "work", Silent())
    images = tmp_path / "work" / "images"
    for name, size in zip(names, [800, 96, 96, 96], strict=True):
        Image.fromarray(np.random.default_rng(size).integers(0, 255, (size, size, 3), np.uint8)).save(images / name)
    solver._extract(tmp_path / "moment.db", names, colmap.CameraMode.PER_IMAGE)
    with colmap.Database.open(tmp_path / "moment.db") as database:
        assert {image.name: image.image_id for image in database.read_all_images()} == dict(
            zip(names, range(1, 5), strict=True)
        )
