"""Protocol of deformation models, for both models."""

import pytest
import torch

from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.trajectory import Trajectory, farthest_points, skin

MODELS = [Trajectory, HashGrid]


def cloud(count=200, seed=0):
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def true_motion(means, frame, frames):
    u = frame / (frames - 1)
    return torch.stack([0.1 * u + 0.05 * means[:, 1] * u, -0.1 * u * u + 0 * means[:, 0], 0 * means[:, 2]], 1)


def fit(model, means, frames, iterations):
    generator = torch.Generator().manual_seed(1)
    for i in range(iterations):
        frontier = min(frames - 1, int(2 * frames * i / iterations))
        model.extend_to(frontier)
        frame = int(torch.randint(frontier + 1, (1,), generator=generator))
        dx, dq = model.offsets(means, frame)
        loss = (dx - true_motion(means, frame, frames)).square().mean() + 0.01 * dq[:, 1:].square().mean()
        loss.backward()
        model.step(i / iterations)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "tolerance"), [(Trajectory, 0.01), (HashGrid, 0.025)])
def test_offsets_start_near_zero_and_learn_motion(model, tolerance):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0)
    dx, dq = net.offsets(means, 6)
    assert dx.abs().max() < 1e-2
    torch.testing.assert_close(dq, torch.tensor([1.0, 0, 0, 0]).expand_as(dq), atol=1e-2, rtol=0)
    fit(net, means, frames, 800)
    errors = [(net.offsets(means, f)[0] - true_motion(means, f, frames)).abs().mean().item() for f in range(frames)]
    assert max(errors) < tolerance
    assert true_motion(means, frames - 1, frames).abs().mean() > 2.5 * tolerance, "standing still would not pass"
    between = (net.offsets(means, 5.5)[0] - true_motion(means, 5.5, frames)).abs().mean().item()
    assert between < tolerance


def tracks_of(means, frames):
    return torch.stack([means + true_motion(means, frame, frames) for frame in range(frames)])


@pytest.mark.parametrize(("model", "tolerance"), [(Trajectory, 2e-3), (HashGrid, 0.02)])
def test_model_follows_smooth_tracks(model, tolerance):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0, tracks=tracks_of(means, frames))
    for frame in range(frames):
        dx, dq = net.offsets(means, frame)
        assert (dx - true_motion(means, frame, frames)).abs().mean() < tolerance
        torch.testing.assert_close(dq, torch.tensor([1.0, 0, 0, 0]).expand_as(dq), atol=0.02, rtol=0)
    assert net.offsets(means, frames - 1)[0].abs().mean() > 2.5 * tolerance, "the tracks do move"


def test_trajectory_smooths_jitter_of_tracks():
    means, frames = cloud(), 12
    jitter = 0.02 * torch.randn(frames, len(means), 3, generator=torch.Generator().manual_seed(2))
    net = Trajectory(means, frames, 1.0, tracks=tracks_of(means, frames) + jitter)
    errors = [(net.offsets(means, f)[0] - true_motion(means, f, frames)).abs().mean().item() for f in range(frames)]
    assert sum(errors) / frames < 0.8 * jitter.abs().mean()


def test_extend_to_keeps_knots_of_tracks():
    """With tracks all knots are in use, so that later frames are not extrapolated again."""
    means, frames = cloud(), 12
    net = Trajectory(means, frames, 1.0, tracks=tracks_of(means, frames))
    before = net.offsets(means, 11)[0].detach()
    net.extend_to(3)
    net.extend_to(11)
    net.offsets(means, 2)[0].square().sum().backward()
    net.step(1.0)
    torch.testing.assert_close(net.offsets(means, 11)[0], before, atol=1e-3, rtol=0)


@pytest.mark.parametrize("model", MODELS)
def test_appended_points_rest_or_copy_parent_tracks(model):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0, tracks=tracks_of(means, frames))
    net.append(means[:3], torch.tensor([0, 1, 2]))
    dx = net.offsets(torch.cat([means, means[:3]]), 8)[0]
    torch.testing.assert_close(dx[200:], dx[:3])


@pytest.mark.parametrize("model", MODELS)
def test_keep_and_append_change_rows(model):
    means, frames = cloud(), 12
    net = model(means, frames, 1.0)
    fit(net, means, frames, 200)
    before = net.offsets(means, 7)[0].detach()
    kept = torch.arange(0, 200, 2)
    net.keep(kept)
    torch.testing.assert_close(net.offsets(means[kept], 7)[0], before[kept])
    net.append(means[kept][:3], torch.tensor([0, 1, 2]))
    grown = torch.cat([means[kept], means[kept][:3]])
    after = net.offsets(grown, 7)[0]
    torch.testing.assert_close(after[:100], before[kept])
    torch.testing.assert_close(after[100:], before[kept][:3])
    after.sum().backward()
    net.step(0.5)


def test_trajectory_appends_points_at_rest():
    means, frames = cloud(), 12
    net = Trajectory(means, frames, 1.0)
    fit(net, means, frames, 200)
    added = cloud(5, seed=3)
    net.append(added, None)
    dx, dq = net.offsets(torch.cat([means, added]), 8.3)
    assert dx[200:].abs().max() < 1e-5
    torch.testing.assert_close(dq[200:], torch.tensor([1.0, 0, 0, 0]).expand(5, 4), atol=1e-5, rtol=0)


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
    assert len(torch.unique(nodes, dim=0)) == 50
    index, weights = skin(means, nodes)
    torch.testing.assert_close(weights.sum(1), torch.ones(500))
    nearest = torch.cdist(means, nodes).argmin(1)
    assert (index[:, 0] == nearest).all()


@pytest.mark.parametrize("model", [Trajectory, HashGrid])
def test_fixed_points_never_move(model):
    means, frames = cloud(), 12
    fixed = torch.arange(len(means)) % 3 == 0
    still = torch.where(fixed[:, None], means, tracks_of(means, frames))
    net = model(means, frames, 1.0, tracks=still, fixed=fixed)
    fit(net, means, frames, 60)
    net.append(means[:4] + 0.01, torch.arange(4))
    net.keep(torch.arange(1, len(means) + 4))
    fixed = torch.cat([fixed, fixed[:4]])[1:]
    dx, dq = net.offsets(torch.cat([means, means[:4] + 0.01])[1:], 7.0)
    assert not dx[fixed].any()
    assert (dq[fixed] == torch.tensor([1.0, 0, 0, 0])).all()
    assert (dx[~fixed].norm(dim=1) > 0.01).float().mean() > 0.9


def test_trajectory_nodes_are_moving_points():
    means = cloud()
    fixed = means[:, 0] > 0
    net = Trajectory(means, 12, 1.0, fixed=fixed)
    assert (net.nodes[:, 0] <= 0).all()
