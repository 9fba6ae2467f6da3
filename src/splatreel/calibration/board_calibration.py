"""Calibration of a rig by a board that is carried through the common view, for cameras that share no texture.

Each camera's lens is found by its own sightings. Frames in which two cameras see the board connect these. All sightings
together then refine lenses and poses. Either half of the frames must give the same cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from splatreel.base.atomic import scratch
from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress
from splatreel.calibration.board import Board, Sighting
from splatreel.calibration.board_sightings import Sightings, find_board
from splatreel.calibration.calibrate import move_into_place
from splatreel.calibration.calibration_agreement import CalibratedCamera, CalibratedRig, agreeing
from splatreel.calibration.calibration_files import camera_files, open_uncalibrated, uncalibrated_files
from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.lens import import_cv2
from splatreel.capture.readers.colmap_model import import_pycolmap, write_model

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
    """Return the lenses, poses and boards that fit all sightings best, from rough ones, by pycolmap's bundle adjustment.

    The board stands still and the rig of cameras moves in front of it, one pose per frame. The corners of the board are known
    points, which makes the rig metric.
    """
    model, images = _board_model(colmap, board, views, start)
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


def _board_model(
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


FRAMES = 6
"""Minimum number of sightings of a camera."""
LINKS = 3
"""Minimum number of frames that connect two cameras."""
WORSE = 3.0
"""Maximum ratio between the error of a camera among the others and alone."""
EXACT = 0.5
"""Error in pixels that is never too large."""
COVERED = 0.5
"""Share of a camera's image that its sightings should cover. The distortion of the lens is uncertain beyond."""


@dataclass(frozen=True)
class BoardCalibration:
    """Result of a calibration by a board.

    Attributes:
        placed: Number of sightings by camera.
        lost: Cameras that come out elsewhere from either half of the frames.
        errors: Median reprojection error in pixels by camera.
        degrees: Largest angle between the poses of a camera from either half.
        meters: Largest distance between these poses.
        extent: Largest distance between two cameras in meters.
        notes: Sentences about what was chosen or converted in reading the videos.
    """

    placed: dict[str, int]
    lost: list[str]
    errors: dict[str, float]
    degrees: float
    meters: float
    extent: float
    notes: list[str]


def calibrate_by_board(
    path: Path,
    board: Board,
    progress: Progress,
    shown_in: Path | None = None,
    leave_out: Sequence[str] = (),
    record: dict[str, Any] | None = None,
) -> BoardCalibration:
    """Write the COLMAP model `sparse/0` of a folder of videos, in meters, by the sightings of a board.

    Args:
        path: Folder of videos.
        board: The board.
        progress: Progress display.
        shown_in: Folder of the videos that show the board, with the same names; by default the videos of `path`.
        leave_out: Names of videos that are not used.
        record: `calibration_record` of the command, to be written beside the model.

    Raises:
        CaptureError: The folder is calibrated already, a camera does not see the board often enough, frames do not connect
            all cameras, or the sightings contradict each other.
    """
    names = list(uncalibrated_files(path, leave_out))
    folder = path if shown_in is None else shown_in
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is not a folder. Name the folder of the videos that show the board.")
    films = camera_files(folder, ())
    if absent := [name for name in names if name not in films]:
        raise CaptureError(
            f"{folder}: shows the board in no video of {', '.join(absent)}; there are {', '.join(films) or 'none'}. Name each video as "
            f"in {path}, or leave cameras out ({quoted(option('--leave-out', ','.join(absent)))})."
        )
    colmap = import_pycolmap()
    colmap.logging.minloglevel = colmap.logging.Level.FATAL.value
    videos = open_uncalibrated(folder, {name: films[name] for name in names})
    try:
        sightings = find_board(videos, names, board, progress)
        check_sightings(folder, board, names, sightings)
        sizes = {name: videos.size(name) for name in names}
        notes = [*videos.notes, *videos.conversions()]
    finally:
        videos.close()
    views = sightings.chosen({name: width for name, (width, _) in sizes.items()}).found
    progress.stage("placing the cameras", len(names) + 3)
    rig = _solve(colmap, folder, board, views, sizes, progress)
    halves = [_half(colmap, board, views, rig, remainder) for remainder in (0, 1)]
    found = _judged(folder, views, rig, halves, [*notes, *_uncovered(views, sizes)])
    with scratch(path, "calibrate") as temporary:
        _write_model(colmap, rig, list(found.placed), temporary / "model")
        move_into_place(temporary / "model", path, record)
    return found


def check_sightings(folder: Path, board: Board, names: Sequence[str], sightings: Sightings) -> None:
    """Raise `CaptureError` if a camera sees the board in too few frames."""
    few = {name: count for name in names if (count := len(sightings.of(name))) < FRAMES}
    if not few:
        return
    phrases: dict[str, list[str]] = {}
    for name, count in few.items():
        phrase = f"{count} frame{'s' if count > 1 else ''}" if count else "no frame"
        if others := sightings.others.get(name):
            phrase += f" (other frames show {others.most_common(1)[0][0]})"
        phrases.setdefault(phrase, []).append(name)
    found = "; ".join(f"{phrase} of {', '.join(cameras)}" for phrase, cameras in phrases.items())
    raise CaptureError(
        f"{folder}: each camera must show the board {board.spec} in {FRAMES} frames or more. It is in {found}. Check --board, hold the "
        f"board closer and tilted to all sides, or leave cameras out ({quoted(option('--leave-out', ','.join(few)))})."
    )


def _solve(
    colmap: ModuleType, folder: Path, board: Board, views: Views, sizes: dict[str, tuple[int, int]], progress: Progress
) -> BoardRig:
    alone = {}
    for count, (name, size) in enumerate(sizes.items(), 1):
        seen = {frame: found[name] for frame, found in views.items() if name in found}
        alone[name] = solve_camera(colmap, board, name, seen, size)
        progress.update(count)
    boards = {name: found.boards for name, found in alone.items()}
    poses, groups = connect(views, boards, LINKS)
    if len(groups) > 1:
        raise CaptureError(
            f"{folder}: the cameras are in {len(groups)} groups that no {LINKS} frames connect: "
            f"{' | '.join(', '.join(sorted(group)) for group in groups)}. Carry the board also where cameras of two groups see "
            f"it at the same time, or leave cameras out (--leave-out)."
        )
    lenses = {name: found.lenses[name] for name, found in alone.items()}
    start = BoardRig(lenses, poses, place_boards(board, views, lenses, poses, boards), {})
    rig = adjust_rig(colmap, board, views, start)
    progress.update(len(sizes) + 1)
    off = [name for name in sizes if rig.errors[name] > max(WORSE * alone[name].errors[name], EXACT)]
    if off:
        name = max(off, key=lambda name: rig.errors[name])
        raise CaptureError(
            f"{folder}: the cameras contradict each other: {name} sees the board {rig.errors[name]:.1f} pixels from where all "
            f"cameras place it, and {alone[name].errors[name]:.1f} pixels from where it does so alone. Run `splatreel capture sync` on "
            f"these videos if they do not start together, hold the board still at each place, and do not move the cameras."
        )
    return rig


def _half(colmap: ModuleType, board: Board, views: Views, rig: BoardRig, remainder: int) -> BoardRig:
    """Return the cameras by every other frame."""
    some = {frame: seen for number, (frame, seen) in enumerate(views.items()) if number % 2 == remainder}
    return adjust_rig(colmap, board, some, rig)


def _judged(folder: Path, views: Views, rig: BoardRig, halves: list[BoardRig], notes: list[str]) -> BoardCalibration:
    """Return the cameras on which both halves agree. Raise `CaptureError` if these are too few."""
    counts = {name: sum(name in seen for seen in views.values()) for name in rig.poses}
    whole, *parts = (_rig(found, counts) for found in (rig, *halves))
    kept = [name for name in rig.poses if all(name in agreeing(whole, part) for part in parts)]
    if len(kept) < MIN_CAMERAS:
        raise CaptureError(
            f"{folder}: either half of the frames places the cameras elsewhere; {len(kept)} of {len(counts)} agree. Show the board "
            f"longer: near and far, in all corners of each image, and tilted to all sides."
        )
    one, other = parts
    turned = [Rotation.from_matrix(one[name].rotation @ other[name].rotation.T).magnitude() for name in kept]
    moved = [np.linalg.norm(one[name].center - other[name].center) for name in kept]
    centers = np.stack([whole[name].center for name in kept])
    extent = np.linalg.norm(centers[:, None] - centers[None], axis=2).max()
    placed, lost = {name: counts[name] for name in sorted(kept)}, sorted(set(counts) - set(kept))
    degrees = float(np.degrees(max(turned)))
    return BoardCalibration(placed, lost, rig.errors, degrees, float(max(moved)), float(extent), notes)


def _uncovered(views: Views, sizes: dict[str, tuple[int, int]]) -> list[str]:
    little = []
    for name, (width, height) in sizes.items():
        places = np.concatenate([seen[name].places for seen in views.values() if name in seen])
        share = ConvexHull(places).volume / (width * height)
        if share < COVERED:
            little.append(f"{name} ({share:.0%})")
    if not little:
        return []
    return [f"lenses are uncertain beyond the part of the image in which the board was: {', '.join(little)}"]


def _rig(found: BoardRig, counts: dict[str, int]) -> CalibratedRig:
    rig = {}
    for name, pose in found.poses.items():
        lens = found.lenses[name]
        focal = lens.mean_focal_length() / max(lens.width, lens.height)
        rig[name] = CalibratedCamera(pose[:, :3], -pose[:, :3].T @ pose[:, 3], focal, counts[name])
    return rig


def _write_model(colmap: ModuleType, rig: BoardRig, names: list[str], folder: Path) -> None:
    """Write a COLMAP model of some cameras, without points, since the board is not part of the scene."""
    model = colmap.Reconstruction()
    for number, name in enumerate(names, 1):
        lens: Any = rig.lenses[name]
        lens.camera_id = number
        model.add_camera_with_trivial_rig(lens)
        image = colmap.Image(name=f"{name}.png", camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, colmap.Rigid3d(rig.poses[name]))
    write_model(model, folder)
