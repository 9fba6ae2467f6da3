"""The time of a training iteration, on the CPU and through wgpu."""

import pytest

from splatreel.base.errors import GpuError
from splatreel.run import gpu_speed
from splatreel.run.gpu_speed import iteration_ms, measure_run_speed
from splatreel.run.machine_speed import MachineSpeed, Probe
from tests.gpu.devices import OpenedGpu

TINY = Probe(50, 32, 16, -2.0, 1.0, 1)


def test_an_iteration_is_timed_on_both_devices() -> None:
    assert iteration_ms(None, TINY, 0.01) > 0
    assert iteration_ms(OpenedGpu(), TINY, 0.01) > 0


def test_a_failed_gpu_is_not_timed_as_the_cpu() -> None:
    gpu = OpenedGpu()
    gpu.fail(GpuError("lost"))
    with pytest.raises(GpuError, match="lost"):
        iteration_ms(gpu, TINY, 0.01)


def test_the_estimate_of_a_run_knows_its_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu_speed, "measure_speed", lambda: MachineSpeed(1.0, 1.0, 1.5))
    monkeypatch.setattr(gpu_speed, "iteration_ms", lambda gpu, probe, seconds: 100 * probe.seconds)
    assert measure_run_speed(None) == MachineSpeed(1.0, 1.0, 1.5)
    found = measure_run_speed(OpenedGpu())
    assert (found.small, found.large, found.other) == (pytest.approx(0.1), pytest.approx(0.1), 1.5)
