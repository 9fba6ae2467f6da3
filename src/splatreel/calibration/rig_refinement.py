"""Refinement of the poses and lenses of a rig by the points of several moments."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from splatreel.calibration.calibration_agreement import placed_images

SURE_MIDDLE = 0.02
"""Maximum difference of the principal points that either half of the points gives, root mean square, as a share of the
longer side. The error with all points is about half of it. Lenses are off by about 1 %."""


def refine_by_moments(colmap: ModuleType, model: Any, models: list[Any], folder: Path) -> Any:
    """Return a model with the same cameras, whose poses and lenses fit the points of the models of all moments.

    The cameras stand still, so that points of several moments are points of one image per camera.

    Args:
        colmap: Module pycolmap.
        model: Model of the best moment, a pycolmap.Reconstruction.
        models: Models of all moments.
        folder: Folder for temporary files, with a folder `images`.
    """
    names = sorted(Path(image.name).stem for image in placed_images(model))
    tracks = _merge_tracks([_tracks(moment) for moment in models], names)
    found = _triangulate(colmap, model, tracks, folder / "moments.db")
    refine_lenses(colmap, found)
    return found if _keeps_points(model, found) else model


def _keeps_points(before: Any, after: Any) -> bool:
    """Return whether every camera still sees half of its points or more."""
    counts = {image.name: image.num_points3D for image in placed_images(after)}
    return all(2 * counts[image.name] >= image.num_points3D for image in placed_images(before))


def refine_lenses(colmap: ModuleType, model: Any) -> None:
    """Refine poses, points and lenses, with the principal points if the points determine these.

    COLMAP's mapper keeps principal points in the middle of the image. One that is off by 1 % of the width looks like a
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


@dataclass(frozen=True)
class _Tracks:
    """Points of a model in its images.

    Attributes:
        matches: Rows of these that show the same point, by pair of cameras, [M, 2].
    """

    points: dict[str, np.ndarray]
    matches: dict[tuple[str, str], np.ndarray]


def _tracks(model: Any) -> _Tracks:
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


def _triangulate(colmap: ModuleType, model: Any, tracks: _Tracks, database: Path) -> Any:
    """Return a model with the cameras of another, and the points of tracks."""
    numbers = _write_database(colmap, model, tracks, database)
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


def _write_database(colmap: ModuleType, model: Any, tracks: _Tracks, database: Path) -> dict[str, int]:
    numbers, rigs = {}, dict[int, tuple[int, int]]()
    with colmap.Database.open(database) as file:
        for image in placed_images(model):
            name = Path(image.name).stem
            numbers[name] = _write_image(colmap, file, image, rigs)
            file.write_keypoints(numbers[name], tracks.points[name].astype(np.float32))
        for (one, other), rows in sorted(tracks.matches.items()):
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
