"""New points of a keyframe at errors: in pixels that differ, at the rendered depth, with the color of the image."""

from dataclasses import replace

import numpy as np

from splatreel.base.progress import Silent
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train.error_points import OPACITY, SIZE, _choose, points_at_errors
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.trainable_points import TrainablePoints, default_rates, sigmoid
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0, Gaussians
from tests.method.captures import blots
from tests.method.scenes import ring
from tests.method.small import plain

NEAR, UNIT = 0.1, 4.0
CAMERAS = ring(4, width=48, height=32)
BACK = blots(1500, [-4, -3, 0.98], [4, 3, 1.0], 0.2, 0)
WALL = Gaussians(BACK.means, BACK.quats, BACK.scales, np.full_like(BACK.opacities, 0.99), np.zeros_like(BACK.sh))
DOT = replace(blots(1, [0, 0, 0.9], [0.01, 0.01, 0.9], 0.1, 1), sh=np.full((1, *BACK.sh.shape[1:]), 1.5, np.float32))
GAINS = np.array([[1.0, 1.0, 1.0], [0.9, 1.0, 1.1], [1.1, 1.0, 0.9], [1.0, 1.0, 1.0]], np.float32)


def make_images(scene: Gaussians) -> TrainingImages:
    images = np.stack([render_image(scene, camera, near=NEAR) for camera in CAMERAS]) * GAINS[:, None, None]
    views = [View.of(camera) for camera in CAMERAS]
    return TrainingImages((images.clip(0, 1) * 255).round().astype(np.uint8)[None], views, NEAR, UNIT)


def added(count: int, shown: TrainingImages) -> dict[str, np.ndarray]:
    """Return the points that are added to the plain wall."""
    points = TrainablePoints.from_gaussians(WALL, default_rates(UNIT, 1.0))

    def draw_camera(camera: int):
        splats = deformed(points.params, None, None, shown.views[camera], NEAR)
        return splats, draw(splats, shown.views[camera])[0] * GAINS[camera]

    return points_at_errors(draw_camera, shown, GAINS, 3, count, np.random.default_rng(0))


def test_points_lie_on_the_missing_dot_with_its_color() -> None:
    shown = make_images(Gaussians.concatenate([WALL, DOT]))
    found = added(40, shown)
    means = found["means"]
    assert 20 < len(means) <= 40
    near = np.linalg.norm(means[:, :2] - DOT.means[0, :2], axis=1) < 0.6
    assert near.mean() > 0.85, "errors are at the dot, and in the window of similarity around it"
    np.testing.assert_allclose(means[:, 2], 0.9, atol=0.3, err_msg="depth of the wall; a pixel is 0.1 wide")
    colors = C0 * found["sh_base"][:, 0] + 0.5
    assert colors.mean() > 0.6, "gray wall, bright dot"
    np.testing.assert_allclose(sigmoid(found["logit_opacities"]), np.full(len(means), OPACITY), rtol=1e-5)
    depth = float(np.linalg.norm(CAMERAS[0].center - np.array([0.0, 0, 1])))
    sizes = np.exp(found["log_scales"])[:, 0]
    assert ((sizes > 0.5 * SIZE * depth / CAMERAS[0].K[0, 0]) & (sizes < 2 * SIZE * depth / CAMERAS[0].K[0, 0])).all()
    assert found["sh_rest"].shape == (len(means), 3, 3)


def test_gain_of_the_camera_is_taken_from_the_color() -> None:
    """All cameras give a point the same color, though one shows it darker."""
    scene = Gaussians.concatenate([WALL, DOT])
    shown = make_images(scene)
    colors = (C0 * added(400, shown)["sh_base"][:, 0] + 0.5).max(0)
    assert np.abs(colors - colors.mean()).max() < 0.06


def test_unknown_pixels_and_small_budgets_add_nothing() -> None:
    shown = make_images(Gaussians.concatenate([WALL, DOT]))
    unknown = np.zeros(shown.pixels.shape[:4], bool)
    unknown[:, :2] = True
    known = TrainingImages(shown.pixels, shown.views, NEAR, UNIT, unknown)
    assert len(added(3, shown)["means"]) == 0, "fewer than one a camera"
    assert len(added(40, known)["means"]) <= len(added(40, shown)["means"])
    weights = np.zeros((4, 5))
    weights[1, 2] = weights[3, 4] = 0.5
    assert sorted(_choose(weights, 10, np.random.default_rng(0)).tolist()) == [7, 19]
    assert len(_choose(np.zeros((4, 5)), 10, np.random.default_rng(0))) == 0


def test_training_recovers_a_dot_that_it_misses_without_detail() -> None:
    """The dot covers four pixels of a plain wall that the initial points describe by larger splats."""
    scene = Gaussians.concatenate([WALL, DOT])
    truth, errors = [render_image(scene, camera, near=NEAR).clip(0, 1) for camera in CAMERAS], {}
    for detail in (False, True):
        settings = {"keyframe.sh_degree": 0, "keyframe.densify_every": 1000, "keyframe.detail": detail}
        points = TrainablePoints.from_gaussians(WALL, default_rates(UNIT, 1.0))
        gains = CameraGains(len(CAMERAS), enabled=False)
        trainer = KeyframeTrainer(points, gains, plain(settings).keyframe, max_points=3000, seed=0)
        views = [View.of(camera) for camera in CAMERAS]
        images = (np.stack(truth) * 255).round().astype(np.uint8)[None]
        trainer.train(TrainingImages(images, views, NEAR, UNIT), 80, 80, Silent())
        drawn = [render_image(trainer.points.gaussians(), camera, near=NEAR).clip(0, 1) for camera in CAMERAS]
        errors[detail] = float(np.mean([np.square(a - b).max() for a, b in zip(drawn, truth, strict=True)]))
    assert errors[True] < 0.7 * errors[False]
