"""The time of a training iteration, on the CPU and through wgpu."""

from __future__ import annotations

import platform
import re
from dataclasses import replace
from pathlib import Path

import pytest

from splatreel.base import threads
from splatreel.base.errors import GpuError
from splatreel.run import machine_speed
from splatreel.run.machine_speed import (
    LARGE,
    SMALL,
    MachineSpeed,
    Probe,
    describe_processor,
    iteration_ms,
    measure_run_speed,
    measure_speed,
    processor_name,
)
from tests.gpu.devices import OpenedGpu


def test_steps_of_both_sizes_over_those_of_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a slow and busy machine, too: only the order of magnitude is asked for."""
    before = threads.count()
    monkeypatch.setattr(machine_speed, "LARGE", replace(LARGE, repeats=1))
    found = measure_speed()
    assert found.other == pytest.approx(found.small / machine_speed.KERNEL_GAIN)
    assert all(0.02 < pace < 200 for pace in (found.small, found.large))
    assert 0.1 < found.large / found.small < 10
    assert threads.count() == before
    assert 10 * SMALL.megapixels < LARGE.megapixels < 1.5


def test_training_factor_depends_on_image_size() -> None:
    speed = MachineSpeed(small=1.0, large=4.0)
    between = (SMALL.megapixels * LARGE.megapixels) ** 0.5
    sizes = (0.0, 0.01, SMALL.megapixels, between, LARGE.megapixels, 5.0)
    assert [speed.training(size) for size in sizes] == pytest.approx([1, 1, 1, 2, 4, 4])


@pytest.fixture(autouse=True)
def forgotten() -> None:
    processor_name.cache_clear()


def test_this_machine_has_a_name_and_cores() -> None:
    assert processor_name()
    assert re.fullmatch(rf"{re.escape(processor_name())}( with [A-Z]\S+)?, \d+ cores?", describe_processor())


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("processor\t: 0\nmodel name\t: AMD EPYC  7763 \nprocessor\t: 1\nmodel name\t: other\n", "AMD EPYC 7763"),
        ("processor\t: 0\nBogoMIPS\t: 108.00\n\nModel\t\t: Raspberry Pi 5\n", "Raspberry Pi 5"),
        ("processor : 0\nCPU part : 0xd40\n", "aarch64"),
        (None, "aarch64"),
    ],
)
def test_name_on_linux(text: str | None, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(machine_speed.sys, "platform", "linux")
    monkeypatch.setattr(platform, "processor", lambda: "")
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(machine_speed, "CPUINFO", tmp_path / "cpuinfo")
    if text is not None:
        machine_speed.CPUINFO.write_text(text)
    assert processor_name() == name
    processor_name.cache_clear()


def test_processor_name_on_other_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_speed.sys, "platform", "darwin")
    answer = type("Answer", (), {"stdout": "Apple M2\n"})
    monkeypatch.setattr(machine_speed.subprocess, "run", lambda *_, **__: answer)
    assert processor_name() == "Apple M2"
    processor_name.cache_clear()


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
    monkeypatch.setattr(machine_speed, "measure_speed", lambda: MachineSpeed(1.0, 1.0, 1.5))
    monkeypatch.setattr(machine_speed, "iteration_ms", lambda gpu, probe, seconds: 100 * probe.seconds)
    assert measure_run_speed(None) == MachineSpeed(1.0, 1.0, 1.5)
    found = measure_run_speed(OpenedGpu())
    assert (found.small, found.large, found.other) == (pytest.approx(0.1), pytest.approx(0.1), 1.5)
