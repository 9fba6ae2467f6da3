import pytest
import torch

from splatreel import threads
from splatreel.recon.run import machine_speed
from splatreel.recon.run.machine_speed import measure_speed


def test_the_time_of_a_step_over_that_of_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    before = threads.count()
    found = measure_speed(torch.device("cpu"))
    assert found.training == found.other
    assert 0.05 < found.training < 50
    assert threads.count() == before
    monkeypatch.setattr(machine_speed, "_seconds", lambda device: {"cpu": 0.043, "cuda": 0.0043}[device.type])
    found = measure_speed(torch.device("cuda"))
    assert (found.training, found.other) == pytest.approx((0.2, 2.0))
