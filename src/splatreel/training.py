"""Training from arrays, one iteration at a time, for programs that need no runs and reels. `examples/train_group.py` is an example.

`reconstruct_frame` trains the Gaussians of one frame. `group_trainer` trains how Gaussians move over several frames. Both take
images and cameras in memory, as `splatreel.capture_from_arrays` does.

Both also take losses of your own, which are added to those of the method. A loss is a function from `Seen` to its value and a dict of
gradients: to `image`, the drawing as the camera would take it, or to any of `Seen.points`. It is called once in every iteration. A
training with such a loss runs on the CPU. `examples/own_loss.py` and `examples/own_loss_torch.py` are examples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from splatreel.base.command_line import needing_packages
from splatreel.base.errors import GaussiansError, UsageError
from splatreel.base.progress import Progress
from splatreel.capture.array_capture import check_rig, image_array, point_arrays
from splatreel.config import Config, Quality, preset
from splatreel.scene.camera import Camera, project
from splatreel.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from splatreel.method.train.group_trainer import GroupTrainer
    from splatreel.method.train.terms.custom import LossFunction

__all__ = ["group_trainer", "reconstruct_frame"]


def reconstruct_frame(
    images: np.ndarray,
    cameras: Sequence[Camera],
    config: Config | Quality = "standard",
    *,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    losses: Sequence[LossFunction] = (),
    device: str = "auto",
    progress: Progress | None = None,
) -> Gaussians:
    """Reconstruct one frame as a static scene, like the first keyframe of a run.

    The Gaussians carry the near plane that training found in the scene (`Gaussians.near`). `splatreel.render` and `group_trainer`
    use it. Give it to other renderers, since nothing nearer to a camera was compared with images.

    Args:
        images: Images in sRGB, [C, H, W, 3], uint8 or floats 0..1, in the order of the cameras.
        cameras: Cameras of the size of the images.
        config: Settings, or the name of a preset: draft, standard or paper.
        points: Sparse points of the scene, [P, 3]; None triangulates them.
        point_colors: Their colors, [P, 3], 0..1.
        losses: Losses of your own, see above.
        device: auto, cpu, gpu or cuda.
        progress: Receives one step for each iteration. A progress that raises an error stops the training.

    Raises:
        CaptureError: Shapes or values of the images or points do not fit, or the cameras cannot be used.
        ReconstructionError: No initial points were found.
        GaussiansError: Training ended in NaN or infinity.
        UsageError: The device or the preset does not exist, or a loss returns gradients of a wrong name or shape.
        MissingDependencyError: A package of the extra `recon` is not installed.
    """
    with needing_packages():
        from splatreel.method.train.losses import KEYFRAME
        from splatreel.method.train.single_frame import reconstruct_single_frame
        from splatreel.method.train.terms.custom import with_functions
        from splatreel.run.device_choice import pick_gpu

        array = image_array(np.asarray(images)[None], cameras, "The frame")[0]
        points, point_colors = point_arrays(points, point_colors, "The frame")
        check_rig(cameras, points, "The frame")
        gaussians, layout = reconstruct_single_frame(
            *(list(cameras), array, preset(config) if isinstance(config, str) else config),
            points=points,
            point_colors=point_colors,
            gpu=pick_gpu(device, *array.shape[-2:-4:-1])[0],
            losses=with_functions(KEYFRAME, losses),
            progress=progress,
        )
    return replace(gaussians, near=layout.near)


def group_trainer(
    images: np.ndarray,
    cameras: Sequence[Camera],
    dynamic: Gaussians,
    static: Gaussians | None = None,
    config: Config | Quality = "standard",
    *,
    near: float | None = None,
    tracks: np.ndarray | None = None,
    losses: Sequence[LossFunction] = (),
    device: str = "auto",
    seed: int = 0,
) -> GroupTrainer:
    """Return a trainer of the motion of Gaussians over the frames of one group.

    `trainer.step(i)` runs iteration i of `trainer.iterations` on one image, and returns the photometric loss. `trainer.train(progress)`
    runs all iterations, with density control. Images are smaller at first (`group.coarse_share`). `trainer.result()` returns the
    Gaussians `dynamic` and their offsets at every frame, `dx` [T, N, 3] and `dq` [T, N, 4]. Colors are taken as they are.

    Args:
        images: Images in sRGB, [T, C, H, W, 3], uint8 or floats 0..1. The second axis has the order of the cameras.
        cameras: Cameras of the size of the images.
        dynamic: N Gaussians of the first frame that may move.
        static: Gaussians that rest; None if all may move.
        config: Settings, or the name of a preset: draft, standard or paper. `config.group` names the model of motion and the number of
            iterations.
        near: Near plane, world units. None: the farthest of the Gaussians, or one in front of nearly all of them.
        tracks: Positions of the dynamic Gaussians at every frame, [T, N, 3], from which training starts; None starts at rest.
        losses: Losses of your own, see above.
        device: auto, cpu, gpu or cuda.
        seed: Seed of all random choices.

    Raises:
        CaptureError: Shapes or values of the images do not fit, or the cameras cannot be used.
        GaussiansError: There are no dynamic Gaussians, all are behind the near plane, or values or the shape of the tracks are wrong.
        UsageError: The device or preset does not exist, `near` is not positive, or gradients of a loss have a wrong name or shape.
        MissingDependencyError: A package of the extra `recon` is not installed.
    """
    array = image_array(images, cameras, "The group")
    static = Gaussians.empty(dynamic.sh_degree) if static is None else static
    _check_points(dynamic, static, tracks, len(array))
    means = np.concatenate([dynamic.means, static.means])
    check_rig(cameras, means, "The group")
    if near is None:
        near = Gaussians.concatenate([dynamic, static]).near
    if near is not None and not 0 < near < np.inf:
        raise UsageError(f"The near plane is {near}. Give a positive distance in world units.")
    with needing_packages():
        from splatreel.method.cameras.color_gains import CameraGains
        from splatreel.method.init.initial_points import near_plane
        from splatreel.method.init.layout import viewing_distance
        from splatreel.method.tracking.tracking import GroupStart
        from splatreel.method.train.group_trainer import GroupTrainer
        from splatreel.method.train.losses import GROUP
        from splatreel.method.train.render import View
        from splatreel.method.train.terms.custom import with_functions
        from splatreel.method.train.training_images import TrainingImages
        from splatreel.run.device_choice import pick_gpu
        from splatreel.scene.gaussians import StaticPoints

        settings = (preset(config) if isinstance(config, str) else config).for_video(len(array))
        gpu, _ = pick_gpu(device, *array.shape[-2:-4:-1])
        unit = viewing_distance(list(cameras), means)
        near = near_plane(list(cameras), means) if near is None else near
        if (farthest := max(float(project(camera, means)[1].max()) for camera in cameras)) <= near:
            raise GaussiansError(
                f"All Gaussians are behind the near plane: it is at {near:g}, and the farthest Gaussian at depth {farthest:g}. Give a "
                f"smaller near plane, in world units."
            )
        views = [View.of(camera, settings.antialias) for camera in cameras]
        return GroupTrainer(
            TrainingImages(np.ascontiguousarray(array), views, near, unit),
            GroupStart(dynamic, None if tracks is None else np.asarray(tracks, np.float32)),
            StaticPoints(static, np.ones(len(static), bool)),
            settings,
            gains=CameraGains(len(cameras), enabled=False),
            seed=seed,
            gpu=gpu,
            losses=with_functions(GROUP, losses),
        )


def _check_points(dynamic: Gaussians, static: Gaussians, tracks: np.ndarray | None, frames: int) -> None:
    """Raise `GaussiansError` for Gaussians that are not finite, and for tracks of another shape or with such values."""
    if not len(dynamic):
        raise GaussiansError("There are no dynamic Gaussians, whose motion could be trained. Give one or more.")
    dynamic.check_finite("The dynamic Gaussians")
    static.check_finite("The static Gaussians")
    if tracks is None:
        return
    expected = frames, len(dynamic), 3
    if np.shape(tracks) != expected or not np.isfinite(tracks).all():
        raise GaussiansError(
            f"The tracks have shape {np.shape(tracks)}, expected finite positions {expected}: one for each of {frames} frames and "
            f"{len(dynamic)} Gaussians."
        )
