"""`splatreel devices`: what there is, what training would use, and why."""

from pathlib import Path
from typing import Any

import pytest

from splatreel.base import user_cache
from splatreel.cli.main import main
from splatreel.gpu import adapters as module
from splatreel.gpu.adapters import LEAST, Adapter
from splatreel.gpu.cuda_libraries import CudaDevice
from splatreel.run import machine_speed


def adapter(name: str, kind: str = "DiscreteGPU", interface: str = "Vulkan", **limits: int) -> Adapter:
    names = {limit.replace("_", "-"): value for limit, value in limits.items()}
    return Adapter(name, interface, kind, LEAST | names, True, None)


def headless(name: str, missing: str | None) -> Adapter:
    """Return an adapter of NVIDIA's driver, without Vulkan."""
    driver: Any = None
    return Adapter(
        name, "CUDA", "DiscreteGPU", LEAST, True, CudaDevice(name, 0, 90, False, LEAST, driver, None, missing)
    )


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ([], "uses the CPU. No driver was found (Vulkan, Metal or NVIDIA's)."),
        ([adapter("H100", interface="CUDA")], "uses H100 through CUDA and NVRTC, if it trains faster than the CPU."),
        ([headless("H100", "NVRTC is not installed")], "uses the CPU. H100 cannot be used: NVRTC is not installed."),
        ([adapter("llvmpipe", "CPU")], "uses the CPU. llvmpipe is a software adapter"),
        ([adapter("Radeon")], "uses Radeon through Vulkan, if it trains faster than the CPU."),
        ([adapter("Radeon"), adapter("llvmpipe", "CPU")], "uses Radeon through Vulkan, if"),
        ([adapter("Old", interface="OpenGL")], "uses the CPU. Old cannot be used: OpenGL lacks"),
        ([adapter("Tiny", max_compute_workgroup_storage_size=8192)], "training needs 16,384"),
    ],
)
def test_auto_takes_a_real_gpu_that_is_large_enough(
    found: list[Adapter],
    expected: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(module, "adapters", lambda: found)
    monkeypatch.setattr(module, "is_installed", lambda: True)
    assert main(["devices", "--no-measure"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert expected in text
    assert text.startswith("CPU ")
    assert all(each.name in text for each in found)


@pytest.mark.parametrize(("milliseconds", "device"), [(2.25, "Arc through Vulkan"), (30.0, "the CPU")])
def test_devices_are_timed_and_the_faster_one_trains(
    milliseconds: float,
    device: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(user_cache, "folder", lambda: tmp_path)
    monkeypatch.setattr(module, "adapters", lambda: [adapter("Arc", "IntegratedGPU"), adapter("Old card")])
    times = {None: 12.5, "Arc": milliseconds, "Old card": 44.0}
    monkeypatch.setattr(machine_speed, "iteration_ms", lambda gpu, *_: times[gpu and gpu.adapter.name])
    assert main(["devices"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "12.5 ms for a training iteration" in text
    assert "44.0 ms for a training iteration" in text
    told = f"training runs on {device}: an iteration takes {milliseconds:.1f} ms on the GPU and 12.5 ms on the CPU."
    assert f"--device auto: {told}" in text


def test_without_the_package_the_cpu_is_used(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "is_installed", lambda: False)
    monkeypatch.setattr(module, "adapters", list)
    assert main(["devices", "--no-measure"]) == 0
    assert (
        "uses the CPU. The package wgpu is not installed, and NVIDIA's driver was not found." in capsys.readouterr().out
    )
