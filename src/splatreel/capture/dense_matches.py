"""Refinement of a rig by learned matches of several moments.

COLMAP's SIFT features tell which cameras are neighbors and roughly where they stand, from few but distinctive matches.
Learned features match many more points of cameras far apart, but confuse repeated patterns. The rough poses remove
these matches: a match counts only near the epipolar line of its point.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.capture.calibration_agreement import placed_images
from splatreel.capture.learned_matches import Features, nearest
from splatreel.progress import Progress

ROUNDS = 4.0, 3.0, 2.0
"""Maximum distance from the epipolar line in each round, in pixels of a picture 640 pixels wide."""
BEST = 200
"""Maximum number of matches of two cameras at a moment, the most similar first. The less similar ones are less exact."""
ENOUGH = 30
"""Number of SIFT matches of two cameras from which on learned matches are not added. They are less exact, and many more."""
SURE_MIDDLE = 0.02
"""Maximum difference of the principal points that either half of the points gives, root mean square, as a share of the
longer side. The error with all points is about half of it. Lenses are off by about 1 %."""
WIDEST = 75.0
"""Maximum angle in degrees between the directions from which two cameras look at the scene; wider pairs do not match."""

View = tuple[np.ndarray, Any]
"""World to camera [3, 4] and lens (pycolmap.Camera) of a placed camera."""


def refine_by_matches(
    colmap: ModuleType, model: Any, features: dict[str, list[Features]], folder: Path, progress: Progress
) -> Any:
    """Return a model with the same cameras, whose poses and lenses fit learned matches of all moments.

    If a camera loses half of its points, the matches contradict the model, and the given model is returned.

    Args:
        colmap: Module pycolmap.
        model: The rough model, a pycolmap.Reconstruction.
        features: Features of the cameras at each moment, by name. Other cameras are ignored.
        folder: Folder for temporary files.
        progress: Progress display.
    """
    given = model
    rough, known = _sift_tracks(model), dict[tuple[str, str], list[np.ndarray]]()
    for number, distance in enumerate(ROUNDS):
        views = {Path(image.name).stem: _view(image) for image in placed_images(model)}
        near = _near_pairs(views, np.array([point.xyz for point in model.points3D.values()]))
        near = [pair for pair in near if len(rough.matches.get(pair, ())) < ENOUGH]
        if not near:
            return given
        progress.stage(f"matching cameras, round {number + 1} of {len(ROUNDS)}", len(near))
        matches = {}
        for count, (one, other) in enumerate(near, 1):
            if (one, other) not in known:
                known[one, other] = [nearest(*both) for both in zip(features[one], features[other], strict=True)]
            found = _filter(features[one], features[other], known[one, other], views[one], views[other], distance)
            if len(found):
                matches[one, other] = found
            progress.update(count)
        model = _triangulate(colmap, model, rough, features, matches, folder / f"round{number}.db")
        refine_lenses(colmap, model)
    return model if _keeps_points(given, model) else given


def refine_by_moments(colmap: ModuleType, model: Any, models: list[Any], folder: Path) -> Any:
    """Return a model with the same cameras, whose poses and lenses fit the points of the models of all moments.

    The cameras stand still, so that points of several moments are points of one picture per camera.

    Args:
        colmap: Module pycolmap.
        model: Model of the best moment, a pycolmap.Reconstruction.
        models: Models of all moments.
        folder: Folder for temporary files, with a folder `images`.
    """
    names = sorted(Path(image.name).stem for image in placed_images(model))
    tracks = _merge_tracks([_sift_tracks(moment) for moment in models], names)
    found = _triangulate(colmap, model, tracks, {name: [] for name in names}, {}, folder / "moments.db")
    refine_lenses(colmap, found)
    return found if _keeps_points(model, found) else model


def _keeps_points(before: Any, after: Any) -> bool:
    """Return whether every camera still sees half of its points or more."""
    counts = {image.name: image.num_points3D for image in placed_images(after)}
    return all(2 * counts[image.name] >= image.num_points3D for image in placed_images(before))


def refine_lenses(colmap: ModuleType, model: Any) -> None:
    """Refine poses, points and lenses, with the principal points if the points determine these.

    COLMAP's mapper keeps principal points in the middle of the picture. One that is off by 1 % of the width looks like a
    camera that is turned by half a degree. If all points are near the middle, the two cannot be told apart, and noise
    would turn the cameras by degrees. Therefore principal points must be the same from either half of the points.
    """
    halves = [_half(colmap, model, remainder) for remainder in (0, 1)]
    for half in halves:
        _adjust(colmap, half, True)
    apart = _principal_points(halves[0]) - _principal_points(halves[1])
    _adjust(colmap, model, float(np.sqrt((apart**2).sum(1).mean())) < SURE_MIDDLE)


def _half(colmap: ModuleType, model: Any, remainder: int) -> Any:
    """Return a copy of a model with every other point."""
    copy = colmap.Reconstruction(model)
    for number, point in enumerate(sorted(copy.points3D)):
        if number % 2 != remainder:
            copy.delete_point3D(point)
    return copy


def _principal_points(model: Any) -> np.ndarray:
    """Return the principal points of the placed cameras as shares of the longer side, [N, 2]."""
    lenses = [image.camera for image in sorted(placed_images(model), key=lambda image: image.name)]
    return np.array([[lens.principal_point_x, lens.principal_point_y] for lens in lenses]) / [
        [max(lens.width, lens.height)] for lens in lenses
    ]


def _adjust(colmap: ModuleType, model: Any, middle: bool) -> None:
    """Adjust poses, points and lenses together. `middle` includes the principal points."""
    options = colmap.BundleAdjustmentOptions()
    options.refine_principal_point = middle
    options.print_summary = False
    options.ceres.loss_function_type = colmap.LossFunctionType.CAUCHY  # a few wrong matches remain
    options.ceres.loss_function_scale = 0.5
    options.ceres.solver_options.num_threads = 1  # several threads sum in any order, which changes the result
    options.ceres.solver_options.function_tolerance = 1e-5
    config = colmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(colmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = colmap.create_default_bundle_adjuster(options, config, model)
    adjuster.solve()  # `bundle_adjustment` would write to standard error
    model.update_point_3d_errors()


def _view(image: Any) -> View:
    return np.asarray(image.cam_from_world().matrix()), image.camera


def _near_pairs(views: dict[str, View], points: np.ndarray) -> list[tuple[str, str]]:
    """Return the pairs of cameras that look at the middle of the points from similar directions."""
    middle = np.median(points, 0)
    sights = {name: -pose[:, :3].T @ pose[:, 3] - middle for name, (pose, _) in views.items()}
    units = {name: sight / max(float(np.linalg.norm(sight)), 1e-12) for name, sight in sights.items()}
    pairs = combinations(sorted(views), 2)
    return [pair for pair in pairs if units[pair[0]] @ units[pair[1]] >= np.cos(np.radians(WIDEST))]


def _filter(
    one: list[Features], other: list[Features], found: list[np.ndarray], here: View, there: View, distance: float
) -> np.ndarray:
    """Return the matches of all moments near their epipolar lines, as rows of the concatenated features, [M, 2]."""
    rows, first, second = [], 0, 0
    for a, b, pairs in zip(one, other, found, strict=True):
        away = _epipolar_distances(here, there, a.points[pairs[:, 0]], b.points[pairs[:, 1]])
        rows.append(pairs[away < distance / 640][:BEST] + np.array([first, second]))
        first, second = first + len(a.points), second + len(b.points)
    return np.concatenate(rows)


def _epipolar_distances(one: View, other: View, points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the distances of matching points [M, 2] from their epipolar lines, as shares of the longer side of the pictures."""
    (pose, _), (pose2, _) = one, other
    turn = pose2[:, :3] @ pose[:, :3].T
    x, y, z = pose2[:, 3] - turn @ pose[:, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    rays, rays2 = (_rays(lens, places) for (_, lens), places in ((one, points), (other, others)))
    lines, back = rays @ essential.T, rays2 @ essential
    product = np.abs((rays2 * lines).sum(1))
    shares = [
        product
        / np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)
        * lens.mean_focal_length()
        / max(lens.width, lens.height)
        for line, (_, lens) in ((lines, other), (back, one))
    ]
    return np.maximum(*shares)


def _rays(lens: Any, points: np.ndarray) -> np.ndarray:
    """Return the directions of pixels [M, 2] without the lens's distortion, [M, 3]."""
    return np.column_stack([lens.cam_from_img(points.astype(np.float64)), np.ones(len(points))])


@dataclass(frozen=True)
class _Tracks:
    """Points of a model in its images.

    Attributes:
        points: Positions in the images by camera, [N, 2].
        matches: Rows of these that show the same point, by pair of cameras, [M, 2].
    """

    points: dict[str, np.ndarray]
    matches: dict[tuple[str, str], np.ndarray]


def _sift_tracks(model: Any) -> _Tracks:
    """Return the tracks of a model. They hold cameras in place that have few learned matches."""
    rows: dict[tuple[int, int], int] = {}
    points, names = {}, {image.image_id: Path(image.name).stem for image in placed_images(model)}
    for image in placed_images(model):
        seen = [(number, point.xy) for number, point in enumerate(image.points2D) if point.has_point3D()]
        rows |= {(image.image_id, number): row for row, (number, _) in enumerate(seen)}
        points[names[image.image_id]] = np.array([place for _, place in seen], np.float32).reshape(-1, 2)
    matches: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for point in model.points3D.values():
        seen = sorted((names[e.image_id], rows[e.image_id, e.point2D_idx]) for e in point.track.elements)
        for (one, row), (other, row2) in combinations(seen, 2):
            if one != other:
                matches.setdefault((one, other), []).append((row, row2))
    return _Tracks(points, {pair: np.array(found) for pair, found in matches.items()})


def _merge_tracks(moments: list[_Tracks], names: list[str]) -> _Tracks:
    """Return the tracks of several moments between some cameras."""
    points: dict[str, list[np.ndarray]] = {name: [np.zeros((0, 2), np.float32)] for name in names}
    matches: dict[tuple[str, str], list[np.ndarray]] = {}
    for tracks in moments:
        before = {name: sum(map(len, points[name])) for name in names}
        for (one, other), rows in tracks.matches.items():
            if one in before and other in before:
                matches.setdefault((one, other), []).append(rows + np.array([before[one], before[other]]))
        for name in set(names) & set(tracks.points):
            points[name].append(tracks.points[name])
    joined = {pair: np.concatenate(rows) for pair, rows in matches.items()}
    return _Tracks({name: np.concatenate(found) for name, found in points.items()}, joined)


def _triangulate(
    colmap: ModuleType,
    model: Any,
    rough: _Tracks,
    features: dict[str, list[Features]],
    matches: dict[tuple[str, str], np.ndarray],
    database: Path,
) -> Any:
    """Return a model with the cameras of another and points from learned matches and rough tracks."""
    numbers = _write_database(colmap, model, rough, features, matches, database)
    with colmap.Database.open(database) as file:
        options = colmap.DatabaseCacheOptions()
        options.min_num_matches = 1
        cache = colmap.DatabaseCache.create(file, options)
    made = colmap.Reconstruction()
    made.load(cache)
    for image in placed_images(model):
        written = made.image(numbers[Path(image.name).stem])
        made.frame(written.frame_id).set_cam_from_world(written.camera_id, image.cam_from_world())
        made.register_frame(written.frame_id)
    options = colmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.triangulation.ignore_two_view_tracks = False
    out = database.with_suffix("")
    out.mkdir()
    return colmap.triangulate_points(made, database, database.parent / "images", out, True, options, False)


def _write_database(
    colmap: ModuleType,
    model: Any,
    rough: _Tracks,
    features: dict[str, list[Features]],
    matches: dict[tuple[str, str], np.ndarray],
    database: Path,
) -> dict[str, int]:
    """Write cameras, points and matches, and return the numbers of the images by camera. Rough points come first."""
    numbers, rigs = {}, dict[int, tuple[int, int]]()
    with colmap.Database.open(database) as file:
        for image in placed_images(model):
            name = Path(image.name).stem
            numbers[name] = _write_image(colmap, file, image, rigs)
            points = [rough.points[name], *(moment.points for moment in features[name])]
            file.write_keypoints(numbers[name], np.concatenate(points).astype(np.float32))
        for one, other in sorted(set(matches) | set(rough.matches)):
            offsets = len(rough.points[one]), len(rough.points[other])
            learned = matches.get((one, other), np.zeros((0, 2), int)) + np.array(offsets)
            rows = np.concatenate([rough.matches.get((one, other), np.zeros((0, 2), int)), learned])
            geometry = colmap.TwoViewGeometry()
            geometry.config = colmap.TwoViewGeometryConfiguration.UNCALIBRATED
            geometry.inlier_matches = rows.astype(np.uint32)
            file.write_two_view_geometry(numbers[one], numbers[other], geometry)
    return numbers


def _write_image(colmap: ModuleType, file: Any, image: Any, rigs: dict[int, tuple[int, int]]) -> int:
    """Write a placed camera and its image into a database, and return the number of the image.

    `rigs` has the numbers of the lens and the rig in the database by the number of the lens in the model. Cameras may
    share a lens.
    """
    lens = image.camera
    if image.camera_id not in rigs:
        made = colmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=lens.params)
        camera, rig = file.write_camera(made), colmap.Rig()
        rig.add_ref_sensor(colmap.sensor_t(colmap.SensorType.CAMERA, camera))
        rigs[image.camera_id] = camera, file.write_rig(rig)
    camera, number_of_rig = rigs[image.camera_id]
    frame = colmap.Frame()
    frame.rig_id = number_of_rig
    number = file.write_image(colmap.Image(name=image.name, camera_id=camera))
    frame.add_data_id(file.read_image(number).data_id)
    file.write_frame(frame)
    return number
