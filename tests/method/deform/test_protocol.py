"""Protocol of deformation models, for both models."""

import numpy as np
import pytest

from splatreel.kernels import adam
from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.trajectory import Trajectory, farthest_points, skin

MODELS = [Trajectory, HashGrid]
IDENTITY = np.array([1, 0, 0, 0], np.float32)


def cloud(count=200, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3)).astype(np.float32)


def true_motion(means, frame, frames):
    u = frame / (frames - 1)
    moved = [0.1 * u + 0.05 * means[:, 1] * u, np.full(len(means), -0.1 * u * u), np.zeros(len(means))]
    return np.stack(moved, 1).astype(np.float32)


def descend(model, means, frame, d_dx, d_dq, share):
    slopes = model.gradient(means, [(1.0, frame)], d_dx.astype(np.float32), d_dq.astype(np.float32))
    adam.adam(model.steps(slopes, share, 1.0))


def fit(model, means, frames, iterations):
    """Minimize the mean square error of dx plus a hundredth of that of dq."""
    rng = np.random.default_rng(1)
    for i in range(iterations):
        frontier = min(frames - 1, int(2 * frames * i / iterations))
        model.extend_to(frontier)
        frame = int(rng.integers(frontier + 1))
        dx, dq = model.offsets(means, frame)
        error = dx - true_motion(means, frame, frames)
        turned = np.where(IDENTITY > 0, 0, 0.02 * dq / (3 * len(dq)))
        descend(model, means, frame, 2 * error / error.size, turned, i / iterations)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "tolerance"), [(Trajectory, 0.01), (HashGrid, 0.025)])
def test_offsets_start_near_zero_and_learn_motion(model, tolerance):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0)
    dx, dq = net.offsets(means, 6)
    assert np.abs(dx).max() < 1e-2
    np.testing.assert_allclose(dq, np.tile(IDENTITY, (200, 1)), atol=1e-2)
    fit(net, means, frames, 800)
    errors = [np.abs(net.offsets(means, f)[0] - true_motion(means, f, frames)).mean() for f in range(frames)]
    assert max(errors) < tolerance
    assert np.abs(true_motion(means, frames - 1, frames)).mean() > 2.5 * tolerance, "standing still would not pass"
    between = np.abs(net.offsets(means, 5.5)[0] - true_motion(means, 5.5, frames)).mean()
    assert between < tolerance


def tracks_of(means, frames):
    return np.stack([means + true_motion(means, frame, frames) for frame in range(frames)])


def moved_model(model, means, frames=12, tracks=None):
    """Return a model whose parameters are far enough from zero that each of them counts."""
    net, rng = model(means, frames, 1.5, tracks=tracks), np.random.default_rng(2)
    ones = net.adams.values() if isinstance(net, HashGrid) else net.adams
    for one in ones:
        one.parameter += rng.normal(0, 0.1, one.parameter.shape).astype(np.float32)
    net.extend_to(frames - 1)
    return net


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("moments", [[(1.0, 3.3)], [(0.4, 2.0), (0.6, 4.0), (-0.7, 3.2)]])
def test_gradient_is_that_of_finite_differences(model, moments):
    """The gradient along a direction of each parameter equals the central difference of the loss, up to bends and rounding."""
    means, rng = cloud(120), np.random.default_rng(3)
    net = moved_model(model, means, tracks=tracks_of(means, 12))
    weights = rng.standard_normal((120, 3), np.float32), rng.standard_normal((120, 4), np.float32)
    steps = net.steps(net.gradient(means, moments, *weights), 0.0, 1.0)

    def loss() -> float:
        total = 0.0
        for factor, time in moments:
            offsets = zip(net.offsets(means, time), weights, strict=True)
            total += factor * sum(float((one * weight).sum(dtype=np.float64)) for one, weight in offsets)
        return total

    for number, step in enumerate(steps):
        slope = np.zeros_like(step.trained.parameter)
        for k, factor in enumerate(step.factors):
            rows = slice(step.start + k * len(step.gradient), step.start + (k + 1) * len(step.gradient))
            slope[rows] += factor * step.gradient
        # Along the gradient itself the difference is largest relative to rounding; a random part finds gradients that are missing.
        noise = rng.standard_normal(slope.shape, np.float32)
        along = slope / np.linalg.norm(slope) + noise / np.linalg.norm(noise)
        expected, values = float((slope * along).sum(dtype=np.float64)), step.trained.parameter.copy()
        found = []
        for sign in (1, -1):
            step.trained.parameter[:] = values + sign * np.float32(2e-3) * along
            found.append(loss())
        step.trained.parameter[:] = values
        assert (found[0] - found[1]) / 4e-3 == pytest.approx(expected, rel=0.06), f"parameter {number}"


@pytest.mark.parametrize("model", MODELS)
def test_steps_follow_the_gradient_downhill(model):
    means = cloud(120)
    net = moved_model(model, means)
    wanted, before = true_motion(means, 5, 12), []
    for i in range(30):
        dx, dq = net.offsets(means, 5)
        before.append(float(np.square(dx - wanted).mean()))
        descend(net, means, 5, 2 * (dx - wanted) / dx.size, np.zeros_like(dq), i / 30)
    assert before[-1] < 0.98 * before[0]


@pytest.mark.parametrize("model", MODELS)
def test_snapshot_restores_parameters_and_rows(model):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0, tracks=tracks_of(means, frames))
    fit(net, means, frames, 10)
    restore, expected = net.snapshot(), net.offsets(means, 4.5)[0]
    ends = []
    for _ in range(2):
        net.keep(np.arange(150))
        net.append(means[:5], None)
        restore()
        np.testing.assert_array_equal(net.offsets(means, 4.5)[0], expected)
        fit(net, means, frames, 10)
        ends.append(net.offsets(means, 4.5)[0])
        restore()
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("model", MODELS)
def test_offsets_are_float32(model):
    means = cloud(90)
    for one in model(means, 12, 1.0, tracks=tracks_of(means, 12)).offsets(means, 4.5):
        assert one.dtype == np.float32
        assert one.flags.c_contiguous


@pytest.mark.parametrize(("model", "tolerance"), [(Trajectory, 2e-3), (HashGrid, 0.02)])
def test_model_follows_smooth_tracks(model, tolerance):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0, tracks=tracks_of(means, frames))
    for frame in range(frames):
        dx, dq = net.offsets(means, frame)
        assert np.abs(dx - true_motion(means, frame, frames)).mean() < tolerance
        np.testing.assert_allclose(dq, np.tile(IDENTITY, (200, 1)), atol=0.02)
    assert np.abs(net.offsets(means, frames - 1)[0]).mean() > 2.5 * tolerance, "the tracks do move"


def test_trajectory_smooths_jitter_of_tracks():
    means, frames = cloud(), 12
    jitter = np.random.default_rng(2).normal(0, 0.02, (frames, len(means), 3)).astype(np.float32)
    net = Trajectory(means, frames, 1.0, tracks=tracks_of(means, frames) + jitter)
    errors = [np.abs(net.offsets(means, f)[0] - true_motion(means, f, frames)).mean() for f in range(frames)]
    assert np.mean(errors) < 0.8 * np.abs(jitter).mean()


def test_extend_to_keeps_knots_of_tracks():
    """With tracks all knots are in use, so that later frames are not extrapolated again."""
    means, frames = cloud(), 12
    net = Trajectory(means, frames, 1.0, tracks=tracks_of(means, frames))
    before = net.offsets(means, 11)[0]
    net.extend_to(3)
    net.extend_to(11)
    dx, dq = net.offsets(means, 2)
    descend(net, means, 2, 2 * dx, np.zeros_like(dq), 1.0)
    np.testing.assert_allclose(net.offsets(means, 11)[0], before, atol=1e-3)


def test_extend_to_continues_the_motion():
    means, frames = cloud(20), 12
    net = Trajectory(means, frames, 1.0)
    net.adams[1].parameter[:4] = np.arange(4)[:, None, None]
    net.extend_to(11)
    control = net.controls[1][:, 0, 0]
    np.testing.assert_allclose(control[4:6], [3 + 0.8, 3 + 0.8 + 0.64], rtol=1e-6)
    assert net.reached == net.spline.at(11)[0] + 3


@pytest.mark.parametrize("model", MODELS)
def test_appended_points_rest_or_copy_parent_tracks(model):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0, tracks=tracks_of(means, frames))
    net.append(means[:3], np.array([0, 1, 2]))
    dx = net.offsets(np.concatenate([means, means[:3]]), 8)[0]
    np.testing.assert_allclose(dx[200:], dx[:3], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("model", MODELS)
def test_keep_and_append_change_rows(model):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0)
    fit(net, means, frames, 100)
    before = net.offsets(means, 7)[0]
    kept = np.arange(0, 200, 2)
    net.keep(kept)
    np.testing.assert_allclose(net.offsets(means[kept], 7)[0], before[kept], rtol=1e-4, atol=1e-6)
    net.append(means[kept][:3], np.array([0, 1, 2]))
    grown = np.concatenate([means[kept], means[kept][:3]])
    after, dq = net.offsets(grown, 7)
    np.testing.assert_allclose(after[:100], before[kept], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(after[100:], before[kept][:3], rtol=1e-4, atol=1e-6)
    descend(net, grown, 7, np.ones_like(after), np.zeros_like(dq), 0.5)
    assert (net.offsets(grown, 7)[0] < after).mean() > 0.9


def test_trajectory_appends_points_at_rest():
    means, frames = cloud(), 12
    net = Trajectory(means, frames, 1.0)
    fit(net, means, frames, 200)
    added = cloud(5, seed=3)
    net.append(added, None)
    dx, dq = net.offsets(np.concatenate([means, added]), 8.3)
    assert np.abs(dx[200:]).max() < 1e-5
    np.testing.assert_allclose(dq[200:], np.tile(IDENTITY, (5, 1)), atol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 3, 70])
def test_models_with_few_points(count):
    means = cloud(max(count, 1))[:count]
    net = Trajectory(means, 5, 1.0)
    dx, dq = net.offsets(means, 2)
    assert dx.shape == (count, 3)
    assert dq.shape == (count, 4)


def test_trajectory_nodes_are_spread_and_weights_local():
    means = cloud(500)
    nodes = means[farthest_points(means, 50, 0)]
    assert len(np.unique(nodes, axis=0)) == 50
    index, weights = skin(means, nodes)
    np.testing.assert_allclose(weights.sum(1), np.ones(500), rtol=1e-6)
    nearest = np.linalg.norm(means[:, None] - nodes, axis=2).argmin(1)
    assert (index[:, 0] == nearest).all()


@pytest.mark.parametrize("model", MODELS)
def test_fixed_points_never_move(model):
    means, frames = cloud(), 12
    fixed = np.arange(len(means)) % 3 == 0
    still = np.where(fixed[:, None], means, tracks_of(means, frames))
    net = model(means, frames, 1.0, tracks=still, fixed=fixed)
    fit(net, means, frames, 60)
    net.append(means[:4] + np.float32(0.01), np.arange(4))
    net.keep(np.arange(1, len(means) + 4))
    fixed = np.concatenate([fixed, fixed[:4]])[1:]
    dx, dq = net.offsets(np.concatenate([means, means[:4] + np.float32(0.01)])[1:], 7.0)
    assert not dx[fixed].any()
    assert (dq[fixed] == IDENTITY).all()
    assert (np.linalg.norm(dx[~fixed], axis=1) > 0.01).mean() > 0.9


def test_trajectory_nodes_are_moving_points():
    means = cloud()
    net = Trajectory(means, 12, 1.0, fixed=means[:, 0] > 0)
    assert (net.nodes[:, 0] <= 0).all()
