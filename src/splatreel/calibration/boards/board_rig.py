"""Lenses and poses of cameras that see a board, by pycolmap's bundle adjustment.

The board stands still and the rig of cameras moves in front of it, one pose per frame. The corners of the board are known
points, which makes the rig metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.calibration.boards.board import Board, Sighting
from splatreel.capture.lens import import_cv2

FISHEYE = 0.97
"""Share of the error of the model OPENCV that OPENCV_FISHEYE must reach to be chosen. Both fit alike in narrow views."""
FOCALS = 0.3 * 1.25 ** np.arange(12)
"""Tried focal lengths of a camera, in units of the longer side of its images: fields of view of 118 to 8 degrees."""
ROBUST = 1.0
"""Error in pixels above which an observation counts less."""

Pose = np.ndarray
"""Rigid transform, [3, 4]."""
Views = dict[int, dict[str, Sighting]]
"""Sightings by frame and camera."""


@dataclass(frozen=True)
class BoardRig:
    """Cameras that were adjusted to sightings of a board.

    Attributes:
        lenses: pycolmap.Camera by camera.
        poses: Rig to camera. The rig has the axes of the first camera, and the unit meter.
        boards: Board to rig by frame.
        errors: Median reprojection error in pixels by camera.
    """

    lenses: dict[str, Any]
    poses: dict[str, Pose]
    boards: dict[int, Pose]
    errors: dict[str, float]


def solve_camera(
    colmap: ModuleType, board: Board, name: str, seen: dict[int, Sighting], size: tuple[int, int]
) -> BoardRig:
    """Return the lens of one camera, and where the board was. `size`: width and height of its images."""
    views, middle = {frame: {name: sighting} for frame, sighting in seen.items()}, np.array(size) / 2
    focal = min(FOCALS * max(size), key=lambda f: _error_of_focal(board, list(seen.values()), f, middle))
    boards = {frame: solve_pose(board, sighting, _pinhole(focal, middle)) for frame, sighting in seen.items()}
    found = []
    for model in ("OPENCV", "OPENCV_FISHEYE"):
        lens = colmap.Camera(model=model, width=size[0], height=size[1], params=[focal, focal, *middle, 0, 0, 0, 0])
        start = BoardRig({name: lens}, {name: np.eye(3, 4)}, boards, {})
        found.append(adjust_rig(colmap, board, views, start))
    return found[1] if found[1].errors[name] < FISHEYE * found[0].errors[name] else found[0]


def connect(views: Views, boards: dict[str, dict[int, Pose]], fewest: int) -> tuple[dict[str, Pose], list[set[str]]]:
    """Return rough poses of the cameras in the first camera's axes, and the groups of cameras that frames connect.

    The pose between two cameras is that of the frame that agrees best with all frames that both share. The pairs with the
    most frames come first.

    Args:
        views: Sightings by frame and camera.
        boards: Board to camera by camera and frame.
        fewest: Minimum number of frames that connect two cameras.
    """
    names = list(boards)
    shared = {
        pair: [f for f, seen in views.items() if pair[0] in seen and pair[1] in seen] for pair in combinations(names, 2)
    }
    groups, links = [{name} for name in names], dict[str, list[tuple[str, Pose]]]()
    for (one, other), frames in sorted(shared.items(), key=lambda item: -len(item[1])):
        group, group2 = (next(g for g in groups if name in g) for name in (one, other))
        if group is group2 or len(frames) < fewest:
            continue
        groups = [g for g in groups if g is not group and g is not group2] + [group | group2]
        between = _most_typical([_joined(boards[other][f], _inverse(boards[one][f])) for f in frames])
        links.setdefault(one, []).append((other, between))
        links.setdefault(other, []).append((one, _inverse(between)))
    poses, waiting = {names[0]: np.eye(3, 4)}, [names[0]]
    while waiting:
        name = waiting.pop()
        for other, between in links.get(name, []):
            if other not in poses:
                poses[other] = _joined(between, poses[name])
                waiting.append(other)
    return poses, sorted(groups, key=lambda group: names.index(min(group, key=names.index)))


def place_boards(
    board: Board, views: Views, lenses: dict[str, Any], poses: dict[str, Pose], alone: dict[str, dict[int, Pose]]
) -> dict[int, Pose]:
    """Return the pose of the board in the rig at each frame: of those that each camera gives alone, the best for all cameras."""
    found = {}
    for frame, seen in views.items():
        tried = [_joined(_inverse(poses[name]), alone[name][frame]) for name in seen]
        errors = [
            sum(
                float(np.median(_errors(lenses[name], _joined(poses[name], pose), board, sighting)))
                for name, sighting in seen.items()
            )
            for pose in tried
        ]
        found[frame] = tried[int(np.argmin(errors))]
    return found


def adjust_rig(colmap: ModuleType, board: Board, views: Views, start: BoardRig) -> BoardRig:
    """Return the lenses, poses and boards that fit all sightings best, from rough ones."""
    model, images = _write_model(colmap, board, views, start)
    options, config = colmap.BundleAdjustmentOptions(), colmap.BundleAdjustmentConfig()
    options.refine_points3D = False
    options.refine_principal_point = True
    options.print_summary = False
    options.ceres.loss_function_type = colmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = ROBUST
    options.ceres.solver_options.num_threads = 1  # several threads sum in any order, which changes the result
    options.ceres.solver_options.max_num_iterations = 200
    for number in images.values():
        config.add_image(number)
    colmap.create_default_bundle_adjuster(options, config, model).solve()
    poses: dict[str, Pose] = {}
    boards: dict[int, Pose] = {}
    lenses: dict[str, Any] = {}
    errors: dict[str, list[np.ndarray]] = {}
    for (frame, name), number in images.items():
        image = model.image(number)
        boards[frame] = np.asarray(image.frame.rig_from_world.matrix())
        pose = np.asarray(image.cam_from_world().matrix())
        poses.setdefault(name, _joined(pose, _inverse(boards[frame])))
        lenses[name] = image.camera
        errors.setdefault(name, []).append(_errors(image.camera, pose, board, views[frame][name]))
    medians = {name: float(np.median(np.concatenate(found))) for name, found in errors.items()}
    lenses = {name: copy(lens) for name, lens in lenses.items()}
    return BoardRig(lenses, {name: poses[name] for name in start.poses if name in poses}, boards, medians)


def solve_pose(board: Board, sighting: Sighting, K: np.ndarray) -> Pose:
    """Return the board's pose in a pinhole camera."""
    cv2 = import_cv2("Placing a board")
    points = board.points[sighting.corners]
    _, turn, shift = cv2.solvePnP(points, sighting.places, K, None, flags=cv2.SOLVEPNP_IPPE)
    return np.hstack([cv2.Rodrigues(turn)[0], shift])


def _write_model(
    colmap: ModuleType, board: Board, views: Views, start: BoardRig
) -> tuple[Any, dict[tuple[int, str], int]]:
    """Return a pycolmap.Reconstruction with a rig, the board as points, and the numbers of the images by frame and camera."""
    model, rig, images = colmap.Reconstruction(), colmap.Rig(rig_id=1), dict[tuple[int, str], int]()
    numbers = {name: number for number, name in enumerate(start.poses, 1)}
    for name, number in numbers.items():
        lens = copy(start.lenses[name])
        lens.camera_id = number
        model.add_camera(lens)
        if number == 1:
            rig.add_ref_sensor(lens.sensor_id)
        else:
            rig.add_sensor(lens.sensor_id, colmap.Rigid3d(start.poses[name]))
    model.add_rig(rig)
    for place, (frame, seen) in enumerate(views.items(), 1):
        made = colmap.Frame(frame_id=place, rig_id=1, rig_from_world=colmap.Rigid3d(start.boards[frame]))
        added = []
        for name, sighting in seen.items():
            image = colmap.Image(
                name=f"{frame}/{name}", keypoints=sighting.places, camera_id=numbers[name], image_id=len(images) + 1
            )
            image.frame_id = place
            images[frame, name] = image.image_id
            made.add_data_id(image.data_id)
            added.append(image)
        model.add_frame(made)
        for image in added:
            model.add_image(image)
        model.register_frame(place)
    tracks = [colmap.Track() for _ in board.points]
    for (frame, name), number in images.items():
        for row, corner in enumerate(views[frame][name].corners):
            tracks[corner].add_element(number, row)
    for point, track in zip(board.points, tracks, strict=True):
        if track.length():
            model.add_point3D(point, track)
    return model, images


def _errors(lens: Any, pose: Pose, board: Board, sighting: Sighting) -> np.ndarray:
    """Return the distances in pixels between the corners of a sighting and those of a placed board, [N]."""
    points = board.points[sighting.corners] @ pose[:, :3].T + pose[:, 3]
    shown = np.asarray(lens.img_from_cam(points), np.float64).reshape(-1, 2)
    return np.nan_to_num(np.linalg.norm(shown - sighting.places, axis=1), nan=1e4)


def _error_of_focal(board: Board, seen: Sequence[Sighting], focal: float, middle: np.ndarray) -> float:
    """Return the median error in pixels of a pinhole camera with a focal length."""
    K, errors = _pinhole(focal, middle), []
    for sighting in seen:
        pose = solve_pose(board, sighting, K)
        points = board.points[sighting.corners] @ pose[:, :3].T + pose[:, 3]
        shown = points[:, :2] / points[:, 2:] * focal + middle
        errors.append(np.linalg.norm(shown - sighting.places, axis=1))
    return float(np.median(np.concatenate(errors)))


def _pinhole(focal: float, middle: np.ndarray) -> np.ndarray:
    return np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])


def _most_typical(poses: list[Pose]) -> Pose:
    """Return the pose that is nearest to the others: the median of angles in radians plus relative distances is the least."""
    all_poses = np.stack(poses)
    size = max(float(np.median(np.linalg.norm(all_poses[:, :, 3], axis=1))), 1e-9)
    traces = np.einsum("aij,bij->ab", all_poses[:, :, :3], all_poses[:, :, :3])
    angles = np.arccos(np.clip((traces - 1) / 2, -1, 1))
    away = np.linalg.norm(all_poses[:, None, :, 3] - all_poses[None, :, :, 3], axis=2) / size
    return poses[int(np.median(angles + away, 1).argmin())]


def _joined(one: Pose, other: Pose) -> Pose:
    """Return the transform that applies `other` first and then `one`."""
    return np.hstack([one[:, :3] @ other[:, :3], one[:, :3] @ other[:, 3:] + one[:, 3:]])


def _inverse(pose: Pose) -> Pose:
    return np.hstack([pose[:, :3].T, -pose[:, :3].T @ pose[:, 3:]])
