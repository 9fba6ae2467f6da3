from dataclasses import replace

import pytest
import torch

from splatreel import threads
from splatreel.recon.run import machine_speed
from splatreel.recon.run.machine_speed import LARGE, SMALL, MachineSpeed, Probe, measure_speed


def test_steps_of_both_sizes_over_those_of_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a slow and busy machine, too: only the order of magnitude is asked for."""
    before = threads.count()
    monkeypatch.setattr(machine_speed, "LARGE", replace(LARGE, repeats=1))
    found = measure_speed(torch.device("cpu"))
    assert found.other == pytest.approx(found.small / machine_speed.KERNEL_GAIN)
    assert all(0.02 < pace < 200 for pace in (found.small, found.large))
    assert 0.1 < found.large / found.small < 10
    assert threads.count() == before
    assert 10 * SMALL.megapixels < LARGE.megapixels < 1.5


def test_a_gpu_trains_and_the_processor_does_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    def seconds(probe: Probe, device: torch.device) -> float:
        return probe.seconds * {"cpu": 2.0, "cuda": 0.2 if probe is SMALL else 0.1}[device.type]

    monkeypatch.setattr(machine_speed, "_seconds", seconds)
    found = measure_speed(torch.device("cuda"))
    assert (found.small, found.large, found.other) == pytest.approx((0.2, 0.1, 2.0 / machine_speed.KERNEL_GAIN))


def test_the_pace_of_training_depends_on_the_size_of_pictures() -> None:
    speed = MachineSpeed(small=1.0, large=4.0)
    between = (SMALL.megapixels * LARGE.megapixels) ** 0.5
    sizes = (0.0, 0.01, SMALL.megapixels, between, LARGE.megapixels, 5.0)
    assert [speed.training(size) for size in sizes] == pytest.approx([1, 1, 1, 2, 4, 4])
