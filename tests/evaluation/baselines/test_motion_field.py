import numpy as np
import torch
from baselines.motion_field import MotionField

BOX = np.array([[-1.0, -1, -1], [1, 1, 1]])


def test_field_starts_as_no_motion() -> None:
    means = torch.rand(50, 3) * 4 - 2
    dx, dq = MotionField(means, BOX, 3.0, 100, 0).offsets(means)
    assert (dx == 0).all()
    assert (dq == torch.tensor([1.0, 0, 0, 0])).all()


def test_field_learns_different_motions_at_different_places() -> None:
    means = torch.rand(200, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    wanted = torch.where(means[:, :1] > 0, torch.tensor([[0.1, 0, 0]]), torch.tensor([[0.0, -0.05, 0]]))
    field = MotionField(means, BOX, 3.0, 150, 0)
    for iteration in range(150):
        dx, _ = field.offsets(means)
        (dx - wanted).abs().sum(1).mean().backward()
        field.step(iteration / 150)
    field.check()
    assert (field.offsets(means)[0] - wanted).norm(dim=1).median() < 0.02
