from collections import Counter
from typing import Any

import pytest

from splatreel.calibration.board import Board
from splatreel.calibration.board_sightings import Sightings, board_scale
from splatreel.capture.readers.colmap_model import import_pycolmap
from tests.capture.boards import FilmedBoard, moves

BOARD = Board(6, 8, 0.09)
pytest.importorskip("pycolmap")


class Rig:
    """The film's cameras in a world whose unit has some meters.

    Attributes:
        model: pycolmap.Reconstruction, which owns the images.
        views: pycolmap.Image by camera.
    """

    def __init__(self, film: FilmedBoard, unit: float, names: list[str]) -> None:
        colmap = import_pycolmap()
        self.model = colmap.Reconstruction()
        for number, name in enumerate(names, 1):
            lens = film.lenses[name]
            lens.camera_id = number
            self.model.add_camera_with_trivial_rig(lens)
            pose = film.poses[name].copy()
            pose[:, 3] /= unit
            image = colmap.Image(name=f"{name}.png", camera_id=number, image_id=number)
            self.model.add_image_with_trivial_frame(image, colmap.Rigid3d(pose))
        self.views: dict[str, Any] = {name: self.model.image(number) for number, name in enumerate(names, 1)}


def test_a_board_gives_the_meters_of_a_unit() -> None:
    film = FilmedBoard(import_pycolmap(), [-30, 0, 25])
    found = Sightings(film.sightings(BOARD, moves(BOARD, 6, 20)))
    rig = Rig(film, 3.7, list(film.lenses))
    assert board_scale(rig.views, BOARD, found) == pytest.approx(3.7, rel=0.01)


def test_a_board_that_no_two_cameras_see_gives_no_scale() -> None:
    film = FilmedBoard(import_pycolmap(), [-30, 0, 25])
    found = Sightings(film.sightings(BOARD, moves(BOARD, 6, 20)))
    rig = Rig(film, 1.0, ["cam01"])
    said = board_scale(rig.views, BOARD, found)
    assert "no frame shows the board 6x8:0.09 to two of the placed cameras" in str(said)
    assert "Cameras that see it at any time: cam00, cam01, cam02" in str(said)
    assert "No camera sees it, but other" in str(
        board_scale(rig.views, BOARD, Sightings({}, {"cam01": Counter(["other"])}))
    )


def test_frames_that_do_not_agree_on_the_scale_give_none() -> None:
    """Each camera sees the board at another time."""
    film = FilmedBoard(import_pycolmap(), [-30, 25])
    poses = moves(BOARD, 12, 10, reach=0.5)
    found, late = film.sightings(BOARD, poses), film.sightings(BOARD, poses[::-1])
    for frame, seen in found.items():
        seen.pop("cam01", None)
        seen |= {name: sighting for name, sighting in late.get(frame, {}).items() if name == "cam01"}
    rig = Rig(film, 1.0, list(film.lenses))
    assert "in different frames, which do not agree" in str(board_scale(rig.views, BOARD, Sightings(found)))
