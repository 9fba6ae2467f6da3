"""Common parts of density control."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.kernels import adam
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train import density
from splatreel.method.train.density import (
    OPACITY,
    RESET_OPACITY,
    SIZE,
    GradientMeter,
    KeyframeDensity,
    OpacityResets,
    RayDepths,
    _choose,
    points_at_errors,
    reset_opacities,
    select_growth,
)
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.trainable_points import (
    TrainablePoints,
    children,
    default_rates,
    halves,
    rotate,
    sigmoid,
    to_params,
)
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from tests.method.captures import blots
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain


def floats(values: list) -> np.ndarray:
    return np.array(values, np.float32)


def twice(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, values])


def test_gradient_meter_averages_over_views_that_see_a_point():
    meter = GradientMeter(3)
    meter.add(floats([[0.03, 0.04], [0.0, 0.0], [1.0, 0.0]]), 2, 2)
    meter.add(floats([[0.06, 0.08], [0.0, 0.0]]), 2, 2, index=np.array([0, 1]))
    np.testing.assert_allclose(meter.mean(), [0.075, 0.0, 1.0], rtol=1e-6)
    assert meter.mean().dtype == np.float32


def test_gradient_meter_uses_normalized_device_units():
    meter = GradientMeter(1)
    meter.add(floats([[1e-3, 0.0]]), 320, 180)
    np.testing.assert_allclose(meter.mean(), [0.16], rtol=1e-6)


def test_select_growth_takes_largest_gradients_within_budget():
    meter = GradientMeter(4)
    meter.add(floats([[0.1, 0], [0.4, 0], [0.2, 0], [0.3, 0]]), 2, 2)
    assert select_growth(meter, 0.15, 10).tolist() == [False, True, True, True]
    assert select_growth(meter, 0.15, 2).tolist() == [False, True, False, True]
    assert not select_growth(meter, 0.15, 0).any()


def test_children_are_near_parent_and_smaller():
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    split = np.zeros(50, bool)
    split[:10] = True
    rows = children(points, split, np.random.default_rng(0))
    assert len(rows["means"]) == 20
    parent = points.rows(split)
    np.testing.assert_allclose(np.exp(rows["log_scales"][:10]) * 1.6, np.exp(parent["log_scales"]), rtol=1e-5)
    reach = np.exp(parent["log_scales"]).max(1)
    assert (np.linalg.norm(rows["means"][:10] - parent["means"], axis=1) < 5 * reach).all()


def test_children_follow_parent_gaussian():
    """Samples use the parent's axes and scales: the children of a needle lie along it."""
    gaussians = random_gaussians(400)
    gaussians.scales[:] = 0.5, 0.05, 0.005
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    rows = children(points, np.ones(400, bool), np.random.default_rng(0))
    turned_back = twice(points.quats) * floats([1, -1, -1, -1])
    offsets = rotate(turned_back, rows["means"] - twice(points.means))
    np.testing.assert_allclose(offsets.std(0), [0.5, 0.05, 0.005], rtol=0.1)
    for name in ("quats", "logit_opacities", "sh_base", "sh_rest"):
        np.testing.assert_array_equal(rows[name], twice(points.params[name]))


def test_halves_are_side_by_side_on_the_longest_axis():
    gaussians = random_gaussians(200)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    every = np.ones(200, bool)
    rows, scales = halves(points, every), points.scales
    np.testing.assert_allclose((rows["means"][:200] + rows["means"][200:]) / 2, points.means, rtol=1e-4, atol=1e-6)
    turned_back = points.quats * floats([1, -1, -1, -1])
    longest = np.eye(3, dtype=np.float32)[scales.argmax(1)] * scales
    offsets = rotate(turned_back, rows["means"][:200] - points.means)
    np.testing.assert_allclose(offsets, 0.5 * longest, rtol=1e-4, atol=1e-6)
    shrunk = np.where(longest > 0, 0.5, 0.85)
    np.testing.assert_allclose(np.exp(rows["log_scales"]), twice(scales * shrunk), rtol=1e-5)
    np.testing.assert_allclose(sigmoid(rows["logit_opacities"]), 0.6 * twice(points.opacities), rtol=1e-5)
    for name in ("quats", "sh_base", "sh_rest"):
        np.testing.assert_array_equal(rows[name], twice(points.params[name]))


def test_halves_draw_nearly_what_the_point_draws():
    """The image of a large point changes less by its split into halves than by a split into random children."""
    camera = ring(1, width=64, height=48)[0]
    gaussians = random_gaussians(1)
    gaussians.means[:], gaussians.scales[:], gaussians.opacities[:] = 0, (0.6, 0.2, 0.2), 0.8
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    every, before = np.ones(1, bool), render_image(gaussians, camera)

    def change(rows: dict[str, np.ndarray]) -> float:
        after = TrainablePoints(rows, default_rates(1.0)).gaussians()
        return float(np.abs(render_image(after, camera) - before).mean())

    random = [change(children(points, every, np.random.default_rng(seed))) for seed in range(5)]
    assert change(halves(points, every)) < 0.8 * min(random)


def test_rotate_turns_x_to_y_about_z():
    quarter = floats([[0.5**0.5, 0, 0, 0.5**0.5]])
    np.testing.assert_allclose(rotate(quarter, floats([[1, 0, 0]])), [[0, 1, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("width", "absolute", "grown"), [(160, True, 0), (320, True, 0), (720, True, 5), (720, False, 20)]
)
def test_large_images_are_densified_at_smaller_absolute_gradients(width: int, absolute: bool, grown: int) -> None:
    """Five of twenty points have a gradient below the threshold of a small image, but above that of a large one."""
    points = TrainablePoints.from_gaussians(random_gaussians(20), default_rates(1.0))
    view = View.of(ring(1, width=width, height=width // 2)[0])
    images = TrainingImages(np.zeros((1, 1, width // 2, width, 3), np.uint8), [view], 0.1, 4.0)
    density = KeyframeDensity(points, plain({}).keyframe, 1000, seed=0)
    density.restart(images)
    density.meter.sum[:], density.meter.seen[:] = 2.5e-4, 1
    density.meter.sum[:5] = 3.5e-4
    density.densify(images, 0.1, absolute)
    assert len(points) == 20 + grown


NEAR, UNIT = 0.1, 4.0
WALL = blots(400, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
BEHIND = blots(100, [-1, -1, 1.8], [1, 1, 2.2], 0.1, 1)
CAMERAS = ring(4, width=48, height=32)


@pytest.mark.parametrize(
    ("total", "views", "resets", "prunings"),
    [(1000, 24, [250, 450], [290, 490]), (1000, 40, [250, 450], [310, 510]), (1000, 80, [], []), (300, 8, [], [])],
)
def test_every_view_is_drawn_before_points_are_pruned(
    total: int, views: int, resets: list[int], prunings: list[int]
) -> None:
    times = OpacityResets(total, views)
    assert (times.resets, times.prunings) == (resets, prunings)
    assert [done for done in range(total) if times.is_due(done)] == sorted(resets + prunings)


def test_reset_lowers_high_opacities_and_forgets_their_momentum() -> None:
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    points.params["logit_opacities"][:2] = -6
    adam.adam(points.follow([np.ones_like(value) for value in points.params.values()]))
    before = points.opacities
    reset_opacities(points)
    np.testing.assert_allclose(points.opacities, np.minimum(before, RESET_OPACITY), rtol=1e-5)
    assert not points.adams["logit_opacities"].mean.any()
    assert not points.adams["logit_opacities"].square.any()


def test_update_prunes_the_faintest_fifth() -> None:
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    opacities = points.opacities
    times = OpacityResets(1000, 4)
    assert not times.update(100, points)
    assert len(points) == 50
    assert times.update(290, points)
    np.testing.assert_array_equal(np.sort(points.opacities), np.sort(opacities)[10:])


def test_training_prunes_opaque_points_that_no_image_shows() -> None:
    """Points behind a wall keep their opacity without a reset."""
    truth = np.stack([render_image(WALL, camera, near=NEAR).clip(0, 1) for camera in CAMERAS])
    pixels = (truth * 255).round().astype(np.uint8)[None]
    images = TrainingImages(pixels, [View.of(camera) for camera in CAMERAS], NEAR, UNIT)
    left = {}
    for detail in (False, True):
        settings = {"keyframe.sh_degree": 0, "keyframe.densify_every": 1000, "keyframe.detail": detail}
        points = TrainablePoints.from_gaussians(Gaussians.concatenate([WALL, BEHIND]), default_rates(UNIT))
        gains = CameraGains(len(CAMERAS), enabled=False)
        trainer = KeyframeTrainer(points, gains, plain(settings).keyframe, max_points=600, seed=0)
        trainer.train(images, 250, 400, Silent())
        left[detail] = int((trainer.points.means[:, 2] > 1.5).sum())
    assert left[True] < 0.6 * left[False]


NEAR, UNIT = 0.1, 4.0
BACK = blots(1500, [-4, -3, 0.98], [4, 3, 1.0], 0.2, 0)
PLAIN_WALL = Gaussians(BACK.means, BACK.quats, BACK.scales, np.full_like(BACK.opacities, 0.99), np.zeros_like(BACK.sh))
DOT = replace(blots(1, [0, 0, 0.9], [0.01, 0.01, 0.9], 0.1, 1), sh=np.full((1, *BACK.sh.shape[1:]), 1.5, np.float32))
GAINS = np.array([[1.0, 1.0, 1.0], [0.9, 1.0, 1.1], [1.1, 1.0, 0.9], [1.0, 1.0, 1.0]], np.float32)


def make_images(scene: Gaussians) -> TrainingImages:
    images = np.stack([render_image(scene, camera, near=NEAR) for camera in CAMERAS]) * GAINS[:, None, None]
    views = [View.of(camera) for camera in CAMERAS]
    return TrainingImages((images.clip(0, 1) * 255).round().astype(np.uint8)[None], views, NEAR, UNIT)


def added(count: int, shown: TrainingImages) -> dict[str, np.ndarray]:
    """Return the points that are added to the plain wall."""
    points = TrainablePoints.from_gaussians(PLAIN_WALL, default_rates(UNIT, 1.0))

    def draw_camera(camera: int):
        splats = deformed(points.params, None, None, shown.views[camera], NEAR)
        return splats, draw(splats, shown.views[camera])[0] * GAINS[camera]

    return points_at_errors(draw_camera, shown, GAINS, 3, count, np.random.default_rng(0))


def test_points_lie_on_the_missing_dot_with_its_color() -> None:
    shown = make_images(Gaussians.concatenate([PLAIN_WALL, DOT]))
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
    scene = Gaussians.concatenate([PLAIN_WALL, DOT])
    shown = make_images(scene)
    colors = (C0 * added(400, shown)["sh_base"][:, 0] + 0.5).max(0)
    assert np.abs(colors - colors.mean()).max() < 0.06


def test_unknown_pixels_and_small_budgets_add_nothing() -> None:
    shown = make_images(Gaussians.concatenate([PLAIN_WALL, DOT]))
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
    scene = Gaussians.concatenate([PLAIN_WALL, DOT])
    truth, errors = [render_image(scene, camera, near=NEAR).clip(0, 1) for camera in CAMERAS], {}
    for detail in (False, True):
        settings = {"keyframe.sh_degree": 0, "keyframe.densify_every": 1000, "keyframe.detail": detail}
        points = TrainablePoints.from_gaussians(PLAIN_WALL, default_rates(UNIT, 1.0))
        gains = CameraGains(len(CAMERAS), enabled=False)
        trainer = KeyframeTrainer(points, gains, plain(settings).keyframe, max_points=3000, seed=0)
        views = [View.of(camera) for camera in CAMERAS]
        images = (np.stack(truth) * 255).round().astype(np.uint8)[None]
        trainer.train(TrainingImages(images, views, NEAR, UNIT), 80, 80, Silent())
        drawn = [render_image(trainer.points.gaussians(), camera, near=NEAR).clip(0, 1) for camera in CAMERAS]
        errors[detail] = float(np.mean([np.square(a - b).max() for a, b in zip(drawn, truth, strict=True)]))
    assert errors[True] < 0.7 * errors[False]


WIDTH, HEIGHT = 96, 64
RAY_CAMERAS = ring(4, width=WIDTH, height=HEIGHT)
NOISE = cv2.GaussianBlur(np.random.default_rng(0).random((400, 400)).astype(np.float32), (0, 0), 4.0)
TEXTURE = 255 * (NOISE - NOISE.min()) / (NOISE.max() - NOISE.min())
PIXELS = np.array([row * WIDTH + column for row in range(16, 48, 6) for column in range(24, 72, 6)])
KNOWN = np.ones((HEIGHT, WIDTH), bool)


def wall(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the image [H, W, 3] uint8 and the depth [H, W] of the textured wall z = 1."""
    row, column = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = [(column - camera.K[0, 2]) / camera.K[0, 0], (row - camera.K[1, 2]) / camera.K[1, 1], np.ones_like(row)]
    world = np.stack(rays, -1) @ camera.viewmat[:3, :3]
    depth = (1 - camera.center[2]) / world[..., 2]
    places = (camera.center + world * depth[..., None] + 4) * 50
    x, y = (places[..., axis].astype(np.float32) for axis in (0, 1))
    image = cv2.remap(TEXTURE, x, y, cv2.INTER_LINEAR)
    return np.repeat(image.round().astype(np.uint8)[..., None], 3, -1), depth


IMAGES, DEPTHS = (np.stack(parts) for parts in zip(*map(wall, RAY_CAMERAS), strict=True))


RAY_WALL = blots(1500, [-4, -3, 0.6], [4, 3, 0.6], 0.1, 0)


def search(
    cameras: int = len(RAY_CAMERAS), images: np.ndarray = IMAGES, unknown: np.ndarray | None = None
) -> RayDepths:
    views = [View.of(camera) for camera in RAY_CAMERAS[:cameras]]
    mask = None if unknown is None else unknown[None]
    return RayDepths(TrainingImages(images[:cameras][None], views, 0.1, 4.0, mask))


def errors(found: np.ndarray, camera: int) -> np.ndarray:
    return np.abs(found / DEPTHS[camera].ravel()[PIXELS] - 1)


@pytest.mark.parametrize("factor", [0.93, 1.07])
def test_wrong_depths_are_corrected(factor: float) -> None:
    tried = search()
    for camera in range(len(RAY_CAMERAS)):
        found = tried.agreed(camera, PIXELS, DEPTHS[camera] * factor, KNOWN)
        assert np.median(errors(found, camera)) < 0.02, "of 0.07"


def test_pixels_are_searched_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = search().agreed(1, PIXELS, DEPTHS[1] * 1.07, KNOWN)
    monkeypatch.setattr(density, "BATCH", 7)
    np.testing.assert_array_equal(search().agreed(1, PIXELS, DEPTHS[1] * 1.07, KNOWN), whole)


def test_correct_depths_are_kept() -> None:
    np.testing.assert_allclose(search().agreed(1, PIXELS, DEPTHS[1], KNOWN), DEPTHS[1].ravel()[PIXELS])


def test_pixels_without_a_depth_do_not_bend_the_surface() -> None:
    """Pixels that show nothing are rendered at the near plane."""
    known, depth = KNOWN.copy(), DEPTHS[1] * 1.07
    known[::3, ::3] = False
    depth[~known] = 0.1
    pixels = PIXELS[known.ravel()[PIXELS]]
    found = search().agreed(1, pixels, depth, known)
    assert np.median(np.abs(found / DEPTHS[1].ravel()[pixels] - 1)) < 0.02


def test_rendered_depths_are_kept_where_nothing_can_be_compared() -> None:
    rendered = 0.93 * DEPTHS[1].ravel()[PIXELS]
    plain, unknown = np.full_like(IMAGES, 120), np.ones(IMAGES.shape[:3], bool)
    unknown[1] = False
    for tried in (search(images=plain), search(unknown=unknown), search(cameras=2)):
        np.testing.assert_allclose(tried.agreed(1, PIXELS, DEPTHS[1] * 0.93, KNOWN), rendered)
    assert len(search().agreed(1, PIXELS[:0], DEPTHS[1], KNOWN)) == 0


def test_points_at_errors_take_the_depth_that_views_agree_on() -> None:
    """The points so far are a plain wall, 0.4 in front of the textured one."""
    params = to_params(replace(RAY_WALL, sh=np.zeros_like(RAY_WALL.sh)))
    views = [View.of(camera) for camera in RAY_CAMERAS]
    images = TrainingImages(IMAGES[None], views, 0.1, 4.0)

    def draw_camera(camera: int):
        splats = deformed(params, None, None, views[camera], 0.1)
        return splats, draw(splats, views[camera])[0]

    rng, gains = np.random.default_rng(0), np.ones((len(RAY_CAMERAS), 3), np.float32)
    means = points_at_errors(draw_camera, images, gains, 3, 200, rng)["means"]
    central = means[np.abs(means[:, :2]).max(1) < 1.5]
    assert len(central) > 40
    assert np.mean(np.abs(central[:, 2] - 1) < 0.2) > 0.5, "rendered depths are 0.4 away"
