"""Training of keyframes of a tiny rendered scene."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.init.layout import Layout
from splatreel.method.train.cpu_program import CpuKeyframeProgram
from splatreel.method.train.keyframe_trainer import AVERAGE_EVERY, Average, KeyframeTrainer, starting_points, with_gain
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.terms.custom import Custom, Seen
from splatreel.method.train.terms.surfaces import spread
from splatreel.method.train.terms.term import Depths, Iteration, Term
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import Sphere
from tests.method.captures import blots
from tests.method.scenes import look_at, ring
from tests.method.small import plain

NEAR, UNIT = 0.1, 4.0
CAMERAS = ring(4, width=48, height=32)
UNSEEN = look_at([0.6, 0.0, -3.9], width=48, height=32)
WALL = blots(400, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
THING = blots(60, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], 0.12, 1)
SCENE = Gaussians.concatenate([WALL, THING])
CONFIG = plain({"keyframe.sh_degree": 1, "keyframe.densify_every": 40}).keyframe


def make_images(scene: Gaussians = SCENE) -> TrainingImages:
    images = np.stack([render_image(scene, camera, near=NEAR) for camera in CAMERAS]).clip(0, 1)
    views = [View.of(camera) for camera in CAMERAS]
    return TrainingImages((images * 255).round().astype(np.uint8)[None], views, NEAR, UNIT)


def psnr(points: Gaussians, camera: Camera, scene: Gaussians = SCENE) -> float:
    image, truth = (render_image(g, camera, near=NEAR).clip(0, 1) for g in (points, scene))
    return float(-10 * np.log10(np.square(image - truth).mean()))


def gains() -> CameraGains:
    return CameraGains(len(CAMERAS), enabled=False)


def rough_start() -> TrainablePoints:
    """Return gray points near the true ones."""
    places = SCENE.means + np.random.default_rng(0).normal(size=SCENE.means.shape) * 0.03
    return starting_points(places, np.full(places.shape, 0.5), CONFIG, UNIT)


def test_starting_points_have_neighbor_size_and_color() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(4) * 0.1] * 3), -1).reshape(-1, 3)
    colors = np.random.default_rng(0).uniform(0, 1, grid.shape)
    points = starting_points(grid, colors, CONFIG, 1.0).gaussians()
    np.testing.assert_allclose(points.scales, 0.07, atol=1e-6, err_msg="kept below 0.07 of the viewing distance")
    wide = starting_points(grid, colors, CONFIG, 10.0).gaussians()
    np.testing.assert_allclose(wide.scales, 0.1, rtol=1e-4)
    np.testing.assert_allclose(points.sh[:, 0] * C0 + 0.5, colors, atol=1e-6)
    np.testing.assert_allclose(points.opacities, 0.1, atol=1e-6)
    assert points.sh.shape == (64, 4, 3)


@pytest.mark.parametrize("count", [1, 2])
def test_starting_points_with_one_or_two_points(count: int) -> None:
    points = starting_points(np.eye(3)[:count], np.zeros((count, 3)), CONFIG, 1.0)
    assert len(points) == count
    assert np.isfinite(points.gaussians().scales).all()


def test_keyframe_generalizes_to_held_out_view() -> None:
    trainer = KeyframeTrainer(rough_start(), gains(), CONFIG, max_points=3000)
    start = psnr(trainer.points.gaussians(), CAMERAS[0])
    trainer.train(make_images(), 300, 300, Silent())
    points = trainer.points.gaussians()
    points.check_finite()
    assert start < 16
    assert psnr(points, CAMERAS[0]) > 26
    assert psnr(points, UNSEEN) > 22
    assert len(points) > len(SCENE), "points were cloned or split"


def test_keyframe_averages_last_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    points = TrainablePoints.from_gaussians(SCENE, default_rates(UNIT))
    trainer = KeyframeTrainer(points, gains(), replace(CONFIG, average_share=0.2), max_points=len(SCENE))
    follow, seen = CpuKeyframeProgram.follow, []

    def watched(program, draw, *arguments):
        taken = follow(program, draw, *arguments)
        if draw.iteration + 1 > 80 and (draw.iteration + 1) % AVERAGE_EVERY == 0:
            seen.append(trainer.points.gaussians().sh.copy())
        return taken

    monkeypatch.setattr(CpuKeyframeProgram, "follow", watched)
    trainer.train(make_images(), 100, 100, Silent())
    assert len(seen) == 20 // AVERAGE_EVERY
    assert np.ptp(seen, axis=0).max() > 1e-3, "they differ"
    np.testing.assert_allclose(trainer.points.gaussians().sh, np.mean(seen, axis=0), atol=1e-5)


def test_densification_stops_at_max_points() -> None:
    limit = len(SCENE) + 20
    trainer = KeyframeTrainer(rough_start(), gains(), CONFIG, max_points=limit)
    trainer.train(make_images(), 200, 200, Silent())
    assert len(SCENE) - 60 < len(trainer.points) <= limit


def test_static_points_stay_frozen() -> None:
    """The wall is frozen; the object in front of it is trained."""
    gray = Gaussians(THING.means, THING.quats, THING.scales, THING.opacities, np.zeros_like(THING.sh))
    points = TrainablePoints.from_gaussians(gray, default_rates(UNIT))
    trainer = KeyframeTrainer(points, gains(), plain({"keyframe.sh_degree": 0}).keyframe, static=WALL, max_points=200)
    before = psnr(Gaussians.concatenate([WALL, gray]), UNSEEN)
    trainer.train(make_images(), 150, 150, Silent())
    after = psnr(Gaussians.concatenate([WALL, trainer.points.gaussians()]), UNSEEN)
    assert after > before + 5


def test_prune_drops_faint_and_huge_points_but_never_all() -> None:
    opacities, scales = THING.opacities.copy(), THING.scales.copy()
    opacities[:10], scales[10:15] = 0.001, 0.6 * UNIT
    sick = Gaussians(THING.means, THING.quats, scales, opacities, THING.sh)
    trainer = KeyframeTrainer(
        TrainablePoints.from_gaussians(sick, default_rates(UNIT)), gains(), CONFIG, max_points=200
    )
    trainer.density.prune(UNIT, 0.9)
    np.testing.assert_allclose(trainer.points.gaussians().means, THING.means[15:])
    for _ in range(2):
        trainer.points.params["logit_opacities"][:] = -9
        trainer.density.prune(UNIT, 1.0)
        assert len(trainer.points) == len(THING) - 15


def test_unknown_pixels_do_not_affect_training() -> None:
    """A white person stands in the image of one camera only."""
    seen = make_images()
    images, unknown = seen.pixels.copy(), np.zeros(seen.pixels.shape[:4], bool)
    images[0, 1, 8:24, 12:36] = 255
    unknown[0, 1, 8:24, 12:36] = True
    found = {}
    for name, mask in (("masked", unknown), ("believed", None)):
        points = TrainablePoints.from_gaussians(SCENE, default_rates(UNIT, 4.0))
        trainer = KeyframeTrainer(points, gains(), replace(CONFIG, rate_scale=4.0), max_points=len(SCENE))
        trainer.train(replace(seen, pixels=images, unknown=mask), 100, 100, Silent())
        found[name] = psnr(trainer.points.gaussians(), CAMERAS[1])
    assert found["masked"] > found["believed"] + 2


def test_halved_marks_pixel_unknown_if_any_of_four_is() -> None:
    seen = make_images()
    unknown = np.zeros(seen.pixels.shape[:4], bool)
    unknown[0, 0, 5, 8] = True
    small = replace(seen, unknown=unknown).halved().unknown
    assert small is not None
    assert np.argwhere(small).tolist() == [[0, 0, 2, 4]]


def test_lambda_opacity_fades_hidden_points() -> None:
    """Points behind the wall are visible in no image."""
    hidden = np.random.default_rng(3).uniform([-1, -1, 1.5], [1, 1, 2.5], (40, 3))
    places = np.concatenate([rough_start().means, hidden])

    def left(price: float) -> Gaussians:
        config = replace(CONFIG, lambda_opacity=price, rate_scale=4.0)
        points = starting_points(places, np.full(places.shape, 0.5), config, UNIT)
        trainer = KeyframeTrainer(points, gains(), config, max_points=len(places))
        trainer.train(make_images(), 150, 150, Silent())
        return trainer.points.gaussians()

    free, priced = left(0.0), left(0.3)
    assert free.opacities[free.means[:, 2] > 1.2].sum() > 1.3 * priced.opacities[priced.means[:, 2] > 1.2].sum()
    assert psnr(priced, UNSEEN) > psnr(free, UNSEEN) - 1


def test_lambda_spread_removes_mist_in_front_of_plain_wall() -> None:
    """Thick mist in the color of a plain wall covers everything. Without it, the wall explains the images."""
    plain = replace(WALL, sh=np.zeros_like(WALL.sh))  # gray
    scene = Gaussians.concatenate([plain, THING])
    mist = np.random.default_rng(5).uniform([-2.2, -1.4, -2.4], [2.2, 1.4, -1.8], (300, 3)).astype(np.float32)
    thick = blots(len(mist), [0, 0, 0], [1, 1, 1], 0.3, 2)
    start = Gaussians.concatenate([scene, replace(thick, means=mist, sh=np.zeros_like(thick.sh))])
    points = TrainablePoints.from_gaussians(start, default_rates(UNIT, 1.0))
    points.params["logit_opacities"][len(scene) :] = 0.4  # each 60 %
    config = replace(CONFIG, lambda_spread=1.0, densify_every=1000)
    trainer = KeyframeTrainer(points, gains(), config, max_points=len(start))
    trainer.train(make_images(scene), 200, 200, Silent())
    assert psnr(trainer.points.gaussians(), UNSEEN, scene) > 28


def test_last_prune_keeps_large_points() -> None:
    wall = blots(4, [-1, -1, 2], [1, 1, 2], 0.9, 1)
    wall = replace(wall, scales=np.full_like(wall.scales, 0.7 * UNIT), opacities=np.full(4, 0.9, np.float32))
    points = TrainablePoints.from_gaussians(wall, default_rates(UNIT, 1.0))
    trainer = KeyframeTrainer(points, gains(), CONFIG, max_points=4)
    trainer.train(make_images(), 10, 10, Silent())
    assert len(trainer.points) == 4


def test_lambda_spread_reduces_depth_spread() -> None:
    """Faint points in the color of the wall lie in front of it. The images hardly depend on them."""
    before = np.random.default_rng(3).uniform([-0.6, -0.6, -1.5], [0.6, 0.6, -0.8], (30, 3))

    def trained(weight: float) -> TrainablePoints:
        config = replace(CONFIG, lambda_spread=weight, rate_scale=4.0)
        places = np.concatenate([rough_start().means, before])
        points = starting_points(places, np.full(places.shape, 0.5), config, UNIT)
        trainer = KeyframeTrainer(points, gains(), config, max_points=len(places))
        trainer.train(make_images(), 300, 300, Silent())
        return trainer.points

    view = View.of(UNSEEN)
    free, priced = (trained(weight) for weight in (0.0, 3.0))
    spreads = [spread(Depths.of(deformed(p.params, None, None, view, NEAR), view, NEAR)) for p in (free, priced)]
    assert spreads[1] < 0.7 * spreads[0]
    assert psnr(priced.gaussians(), UNSEEN) > psnr(free.gaussians(), UNSEEN) - 1.5


def test_far_points_take_larger_steps() -> None:
    places = np.array([[0, 0, 0], [0, 0, 3 * UNIT], [0, 0, 99 * UNIT]])
    points, shown = starting_points(places, np.ones((3, 3)), CONFIG, UNIT), make_images()
    trainer = KeyframeTrainer(points, gains(), replace(CONFIG, far_step_scale=8.0), max_points=3, losses=[Pull("pull")])
    trainer.density.restart(shown)
    near, far, farthest = trainer.density.distances.tolist()
    assert 1 <= near < far < farthest == 8
    before, distances = points.means.copy(), trainer.density.distances
    trainer.train(shown, 1, 1, Silent())
    moved = (points.means - before)[:, 0]
    np.testing.assert_allclose(moved / moved[0], distances / near, rtol=1e-3)


class Pull(Term[Iteration]):
    """A term that moves all points along x."""

    def value(self, seen: Iteration) -> float:
        return float(seen.points["means"][:, 0].mean())

    def add_to_points(self, seen: Iteration, weight: float) -> None:
        seen.gradients["means"][:, 0] += weight / len(seen.points["means"])


def test_training_continues_at_second_resolution() -> None:
    trainer = KeyframeTrainer(rough_start(), gains(), CONFIG, max_points=1000)
    trainer.train(make_images(), 10, 20, Silent())
    assert trainer.done == 10
    trainer.train(make_images(), 10, 20, Silent())
    assert trainer.done == 20


def test_average_is_mean_of_counted_iterations() -> None:
    average, mean = Average(0.5, 8 * AVERAGE_EVERY), 0.0
    for done in range(1, 8 * AVERAGE_EVERY + 1):
        assert average.has_begun(done) == (done > 4 * AVERAGE_EVERY)
        mean += average.next_weight(done) * (done - mean)
    array = np.zeros(3, np.float32)
    average.set_means([np.full(3, mean, np.float32)])
    average.write_to([array])
    np.testing.assert_allclose(array, (5 + 6 + 7 + 8) * AVERAGE_EVERY / 4)


def test_average_without_share_changes_nothing() -> None:
    average, array = Average(0.0, 100), np.ones(2, np.float32)
    assert not average.has_begun(100)
    average.set_means([np.zeros(2, np.float32)])
    average.write_to([array])
    np.testing.assert_array_equal(array, 1)


def test_average_restarts_when_rows_are_removed() -> None:
    average = Average(1.0, 100)
    weights = [average.next_weight(k * AVERAGE_EVERY) for k in (1, 2)]
    average.restart()
    assert [*weights, average.next_weight(3 * AVERAGE_EVERY)] == [1, 0.5, 1]
    average.set_means([np.zeros(3, np.float32)])
    kept, other = np.ones(3, np.float32), np.ones(5, np.float32)
    average.write_to([kept])
    average.write_to([other])
    assert (kept == 0).all()
    assert (other == 1).all(), "means of other rows are not written"


def test_color_gain_does_not_change_the_background_behind_masks() -> None:
    """The gain is learned from the points alone, whatever gain was known when the view was made."""
    colors, known = {CAMERAS[0].name: (1.0, 0.0, 1.0)}, np.array([0.8, 1.1, 1.25], np.float32)
    layout = Layout(NEAR, UNIT, [0.0, -1, 0], [[-1.0] * 3, [1.0] * 3], backgrounds=colors)
    view = View.of(CAMERAS[0], layout=layout, gain=known)
    gain = np.array([0.9, 1.0, 1.1], np.float32)
    points = TrainablePoints.from_gaussians(THING, default_rates(UNIT, 1.0))
    splats, factor = with_gain(deformed(points.params, None, None, view, NEAR), view, gain)
    shown = draw(splats, view)[0] * factor
    black, white = (render_image(THING, CAMERAS[0], near=NEAR, background=(v, v, v)) for v in (0.0, 1.0))
    expected = black * gain + (white - black) * np.array(colors[CAMERAS[0].name])
    np.testing.assert_allclose(shown, expected, atol=1e-5)

    def add_up(seen: Seen) -> tuple[float, dict[str, np.ndarray]]:
        np.testing.assert_allclose(seen.image, expected, atol=1e-5)
        return float(seen.image.sum()), {"image": np.ones_like(seen.image)}

    learned = CameraGains(len(CAMERAS))
    learned.load(np.stack([gain] * len(CAMERAS)))
    shown = replace(make_images(), views=[view] * len(CAMERAS))
    trainer = KeyframeTrainer(points, learned, CONFIG, max_points=99, losses=[Custom("sum", function=add_up)])
    trainer.train(shown, 1, 1, Silent())
    mean = learned.adam.mean[
        learned.adam.mean.any(1)
    ]  # a tenth of the gradient to the gain of the camera that was drawn
    np.testing.assert_allclose(10 * mean[0], black.sum((0, 1)), rtol=1e-4)


def test_points_outside_of_the_hull_are_removed() -> None:
    """Also where no image contradicts them: beyond the borders of all but one camera."""
    trainer = KeyframeTrainer(rough_start(), gains(), CONFIG, max_points=3000)
    means = trainer.points.gaussians().means
    middle, radius = np.median(means, 0), float(np.quantile(np.linalg.norm(means - np.median(means, 0), axis=1), 0.7))
    trainer.density.hull = Sphere(middle, radius)
    trainer.train(make_images(), 120, 120, Silent())
    found = trainer.points.gaussians().means
    assert len(found) > 10
    assert (np.linalg.norm(found - middle, axis=1) < 1.1 * radius).mean() > 0.98
