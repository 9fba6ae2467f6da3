from pathlib import Path

import numpy as np
import pytest

from baselines.part_by_part import Frames
from baselines.shared_start import SharedStart
from baselines.temporal_slices import SpaceTimePoints, TemporalSlices, train_slices
from splatreel.evaluation.metrics import psnr
from splatreel.kernels.image import render_image
from splatreel.method.train.trainable_points import default_rates
from splatreel.scene.gaussians import Gaussians
from tests.benchmarks.baselines.starts import write_start
from tests.evaluation import scenes

UNIT = 3.0


@pytest.fixture
def start(tmp_path: Path) -> SharedStart:
    return write_start(scenes.capture(tmp_path), tmp_path / "run")


def points() -> SpaceTimePoints:
    return SpaceTimePoints(scenes.truth(0), UNIT, default_rates(UNIT, 1.0))


def set_time(made: SpaceTimePoints, name: str, value: float | list[float] | np.ndarray) -> None:
    made.time[name].parameter[:] = value


def test_points_begin_where_they_are_and_rest() -> None:
    made, truth = points(), scenes.truth(0)
    for moment in (0.0, 0.5, 1.0):
        shown = made.at(moment)
        np.testing.assert_allclose(shown.means, truth.means, atol=1e-6)
        np.testing.assert_allclose(shown.opacities, truth.opacities * np.exp(-0.5 * (moment - 0.5) ** 2), rtol=1e-3)


def test_points_move_and_fade_about_their_moment() -> None:
    made, truth = points(), scenes.truth(0)
    set_time(made, "centers", 0.25)
    set_time(made, "log_durations", float(np.log(0.1)))
    set_time(made, "velocities", [1.0, 0.0, 0.0])
    shown = made.at(0.35)
    np.testing.assert_allclose(shown.means[:, 0] - truth.means[:, 0], UNIT * 0.1, atol=1e-5)
    np.testing.assert_allclose(shown.opacities, truth.opacities * np.exp(-0.5), rtol=1e-3)
    late = made.at(1.0)
    assert (late.opacities == 0).all()
    assert (late.means[:, 0] - truth.means[:, 0]).max() < UNIT * 0.1 * 2.5, "hidden points wait where they were visible"


def test_hidden_points_are_not_drawn() -> None:
    made = points()
    set_time(made, "log_durations", float(np.log(0.1)))
    assert len(made.slice(0.5)[1]) == len(made)
    assert len(made.slice(0.0)[1]) == 0


def test_children_share_the_path_and_the_life_of_their_parent() -> None:
    made = points()
    set_time(made, "velocities", [0.5, 0.0, 0.0])
    chosen = np.arange(len(made)) < 10
    made.space.params["log_scales"][:10] = -20.0  # small: children stay on the path
    before = made.at(0.5).means[:10]
    count = len(made)
    made.split(chosen, np.random.default_rng(0))
    assert len(made) == count + 10
    assert np.exp(made.time["log_durations"].parameter[-20:]) == pytest.approx(1 / 1.6)
    assert made.time["centers"].parameter[-20:].std() > 0.3
    away = 0.5 - made.time["centers"].parameter[-20:]
    own = made.space.means[-20:] + UNIT * np.array([0.5, 0, 0]) * away
    np.testing.assert_allclose(own, np.concatenate([before, before]), atol=1e-5)


def test_gradients_are_those_of_finite_differences() -> None:
    rng, made, moment = np.random.default_rng(0), points(), 0.4
    set_time(made, "centers", rng.uniform(0, 1, (len(made), 1)))
    set_time(made, "log_durations", rng.uniform(-2, 0, (len(made), 1)))
    set_time(made, "velocities", rng.normal(size=(len(made), 3)))
    shown, rows = made.slice(moment)
    assert 0 < len(rows) < len(made)
    weights = {name: rng.normal(size=value.shape).astype(np.float32) for name, value in shown.items()}

    def loss(point: int) -> float:
        """Return the weighted sum of the values of one visible point."""
        now = made.slice(moment)[0]
        return sum(float((weights[name][point] * now[name][point]).sum(dtype=np.float64)) for name in now)

    space, time = made.gradients(moment, rows, weights)
    arrays = [(one.parameter, {**space, **time}[name]) for name, one in {**made.space.adams, **made.time}.items()]
    for value, slope in arrays:
        assert value.shape == slope.shape
        for point in (0, len(rows) // 2, len(rows) - 1):
            row = value[rows[point] : rows[point] + 1]
            for place in range(min(row.size, 3)):
                before, ends = row.flat[place], []
                for sign in (1, -1):
                    row.flat[place] = before + sign * 2e-3
                    ends.append(loss(point))
                row.flat[place] = before
                wanted = slope[rows[point] : rows[point] + 1].flat[place]
                np.testing.assert_allclose((ends[0] - ends[1]) / 4e-3, wanted, rtol=2e-2, atol=5e-3)
    hidden = np.setdiff1d(np.arange(len(made)), rows)
    assert all((slope[hidden] == 0).all() for _, slope in arrays)


def test_parts_are_the_groups(start: SharedStart) -> None:
    assert TemporalSlices().parts(start) == [range(3), range(3, 5)]


@pytest.mark.slow
def test_training_follows_the_moving_points(start: SharedStart, tmp_path: Path) -> None:
    images = [start.training_images(frame) for frame in range(5)]
    trained = train_slices(start, start.keyframe, images, 300, 0)
    resting, followed = (
        [_error(points, start, frame) for frame, points in enumerate(each)]
        for each in ([start.keyframe] * 5, [trained.at(frame / 4) for frame in range(5)])
    )
    assert np.mean(followed) > np.mean(resting) + 1
    assert followed[4] > resting[4] + 2
    method, frames = TemporalSlices(), Frames(tmp_path / "frames", 5)
    for part in method.parts(start):
        for frame in part:
            frames.save(frame, trained.at(frame / 4))
    method.write(start, frames, tmp_path / "reel")


def _error(points: Gaussians, start: SharedStart, frame: int) -> float:
    """Return the PSNR in a training view."""
    view = start.capture.camera("cam02")
    truth = start.capture.read(frame, 1, ["cam02"])[0, 0].astype(np.float32) / 255
    return psnr(np.clip(render_image(points, view, near=start.layout.near), 0, 1), truth)
