"""Splines over a group's frames: partition of unity, reproduction of lines, turns within two frames."""

import pytest
import torch

from splatreel.recon.spline import Spline, basis


def value(spline, controls, frame):
    knot, weights = spline.at(frame)
    return torch.einsum("k,knd->nd", torch.from_numpy(weights), controls[knot : knot + 4])


def test_weights_sum_to_one_and_are_continuous():
    for u in (0.0, 0.3, 1.0, 4.999, 5.0):
        assert abs(basis(u, 5)[1].sum() - 1) < 1e-6
    left, right = basis(2 - 1e-6, 5), basis(2, 5)
    assert right[0] == left[0] + 1
    assert abs(left[1][1:] - right[1][:3]).max() < 1e-5


@pytest.mark.parametrize("frames", [1, 2, 3, 35])
def test_a_line_is_followed_exactly(frames):
    spline = Spline(frames)
    line = torch.arange(frames, dtype=torch.float32)[:, None, None] * torch.tensor([[0.1, -0.2, 0.0]])
    controls = spline.fit(line)
    assert controls.shape == (spline.knots, 1, 3)
    for frame in range(frames):
        torch.testing.assert_close(value(spline, controls, frame), line[frame], atol=2e-3, rtol=0)


def test_a_bounce_is_not_cut_off():
    frames = 31
    height = (torch.arange(frames, dtype=torch.float32) - 15).abs()[:, None, None] * torch.tensor([[0.0, 0.0, 1.0]])
    spline = Spline(frames)
    controls = spline.fit(height)
    errors = [float((value(spline, controls, f) - height[f]).abs().max()) for f in range(frames)]
    assert max(errors) < 1, "of a frame's way, where the ball turns"
    assert sum(errors) / frames < 0.1
