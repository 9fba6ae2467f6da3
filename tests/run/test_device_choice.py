"""The one choice of the device, with adapters and PyTorch that this test pretends are there."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base import threads, user_cache
from splatreel.base.errors import GpuError, MissingDependencyError, UsageError
from splatreel.gpu.adapters import LEAST, Adapter
from splatreel.run import device_choice, machine_speed
from splatreel.run.device_choice import cuda_renderer, pick_gpu

LIMITS = dict.fromkeys(LEAST, 1 << 30)
CARD = Adapter("Card", "Vulkan", "DiscreteGPU", LIMITS, True, None)
SOFTWARE = Adapter("llvmpipe", "Vulkan", "CPU", LIMITS, True, None)


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A machine with a GPU for wgpu, without torch and gsplat."""
    monkeypatch.setattr(device_choice, "adapters", lambda: (CARD, SOFTWARE))
    monkeypatch.setattr(device_choice, "may_have_gpu", lambda: True)
    monkeypatch.setattr(device_choice, "cuda_devices", lambda: ["Card"])
    monkeypatch.setattr(device_choice, "require_adapter", lambda: CARD)
    monkeypatch.setattr(user_cache, "folder", lambda: tmp_path)
    monkeypatch.setattr(machine_speed, "iteration_ms", lambda gpu, *_: 9.0 if gpu is None else 3.0)
    with_packages(monkeypatch)


def with_packages(monkeypatch: pytest.MonkeyPatch, *there: str, cuda: bool = False, hip: str | None = None) -> None:
    """Pretend that of torch and gsplat only these are installed."""
    find: Any = importlib.util.find_spec
    monkeypatch.setattr(
        device_choice.importlib.util,
        "find_spec",
        lambda name: (name in there or None) if name in ("torch", "gsplat") else find(name),
    )
    fake = SimpleNamespace(
        cuda=SimpleNamespace(is_available=lambda: cuda, get_device_name=lambda: "Card of PyTorch"),
        version=SimpleNamespace(hip=hip),
    )
    monkeypatch.setitem(sys.modules, "torch", fake if "torch" in there else None)
    opened = SimpleNamespace(shared_gpu=lambda: "with gsplat", draw="draws")
    monkeypatch.setitem(sys.modules, "splatreel.gsplat.device", opened if "gsplat" in there else None)


FASTER = "training runs on Card through Vulkan: an iteration takes 3.0 ms on the GPU and 9.0 ms on the CPU"


def name_of(name: str, points: int = 0) -> tuple[Any, str]:
    found, note = pick_gpu(name, points=points)
    return getattr(getattr(found, "adapter", None), "name", found), note


def test_without_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    assert name_of("cpu") == (None, "")
    assert name_of("auto") == ("Card", FASTER)
    assert name_of("gpu") == ("Card", "")
    for choose in (lambda: pick_gpu("cuda"), cuda_renderer):
        with pytest.raises(MissingDependencyError, match=r"gsplat is not installed.*splatreel\[cuda\]"):
            choose()
    monkeypatch.setattr(device_choice, "adapters", lambda: (SOFTWARE,))
    assert name_of("auto") == (None, "")


def test_torch_alone_is_not_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing it takes seconds."""
    with_packages(monkeypatch, "torch")
    monkeypatch.setitem(sys.modules, "torch", None)
    assert name_of("auto") == ("Card", FASTER)
    with pytest.raises(MissingDependencyError, match="--device cuda: gsplat is not installed"):
        pick_gpu("cuda")


def test_gsplat_is_first_where_there_is_a_cuda_device(monkeypatch: pytest.MonkeyPatch) -> None:
    with_packages(monkeypatch, "torch", "gsplat", cuda=True)
    assert name_of("auto") == name_of("cuda") == ("with gsplat", "")
    assert name_of("cpu") == (None, "")
    assert name_of("gpu") == ("Card", "")
    assert cuda_renderer() == "draws"


@pytest.mark.parametrize("hip", [None, "6.4"], ids=["none", "AMD's, which PyTorch for ROCm calls cuda"])
def test_gsplat_without_a_cuda_device(monkeypatch: pytest.MonkeyPatch, hip: str | None) -> None:
    with_packages(monkeypatch, "torch", "gsplat", cuda=hip is not None, hip=hip)
    assert name_of("auto") == ("Card", FASTER)
    with pytest.raises(UsageError, match="--device cuda: PyTorch finds no CUDA device"):
        pick_gpu("cuda")
    with pytest.raises(
        UsageError, match=r"--renderer cuda: PyTorch finds no CUDA device\. Use --renderer cpu or webgl"
    ):
        cuda_renderer()


def test_auto_loads_nothing_where_no_gpu_is_possible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading torch or wgpu takes seconds."""
    with_packages(monkeypatch, "torch", "gsplat", cuda=True)
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setattr(device_choice, "may_have_gpu", lambda: False)
    monkeypatch.setattr(device_choice, "adapters", lambda: pytest.fail("looked for adapters"))
    assert name_of("auto") == (None, "")
    monkeypatch.setattr(device_choice, "cuda_devices", list)
    with pytest.raises(UsageError, match="--device cuda: NVIDIA's driver finds no device"):
        pick_gpu("cuda")


def test_buffers_that_are_too_large() -> None:
    found, note = name_of("auto", 9_000_000)
    assert found is None
    assert "training runs on the CPU: Card allows buffers of 1,074 MB, training needs 2,124 MB" in note
    with pytest.raises(UsageError, match=r"--device gpu: Card allows.*Use --device cpu, or ask for a smaller --width"):
        pick_gpu("gpu", 9000, 9000)


def test_a_slower_gpu_is_not_used_and_times_are_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []

    def iteration_ms(gpu: Any, probe: machine_speed.Probe) -> float:
        measured.append((gpu and gpu.adapter.name, probe.width))
        return 9.0 if gpu is None else 30.0

    monkeypatch.setattr(machine_speed, "iteration_ms", iteration_ms)
    slower = "training runs on the CPU: an iteration takes 30.0 ms on the GPU and 9.0 ms on the CPU"
    assert name_of("auto") == name_of("auto") == (None, slower)
    assert measured == [(None, 320), ("Card", 320)]
    assert pick_gpu("auto", 1280, 720)[1] == slower
    assert measured[2:] == [(None, 1280), ("Card", 1280)]
    with threads.limited(1):
        pick_gpu("auto")
    assert len(measured) == (4 if threads.count() == 1 else 6)
    for file in (user_cache.folder() / "speed").iterdir():
        file.write_text('{"cpu": "fast"}')
    pick_gpu("auto")
    assert len(measured) > 4


def test_a_gpu_that_fails_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    def iteration_ms(gpu: Any, probe: machine_speed.Probe) -> float:
        raise GpuError("Card: a test of its sums failed.")

    monkeypatch.setattr(machine_speed, "iteration_ms", iteration_ms)
    assert name_of("auto") == (None, "training runs on the CPU: Card: a test of its sums failed")


def test_unknown_devices() -> None:
    with pytest.raises(UsageError, match="'tpu'"):
        pick_gpu("tpu")
