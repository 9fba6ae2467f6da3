import importlib.util
from typing import Any

import pytest
import torch

from splatreel.base.errors import MissingDependencyError, ReconstructionError, UsageError
from splatreel.run.device_choice import check_room, pick_device


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.version, "hip", None)


def with_gsplat(monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    find: Any = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: there or None if name == "gsplat" else find(name))


def test_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert pick_device("auto").type == pick_device("cpu").type == "cpu"
    with pytest.raises(UsageError, match="--device cuda: PyTorch finds no CUDA device"):
        pick_device("cuda")


@pytest.mark.usefixtures("gpu")
def test_gpu_needs_gsplat(monkeypatch: pytest.MonkeyPatch) -> None:
    with_gsplat(monkeypatch, True)
    assert pick_device("auto").type == pick_device("cuda").type == "cuda"
    assert pick_device("cpu").type == "cpu"
    with_gsplat(monkeypatch, False)
    assert pick_device("auto").type == "cpu"
    with pytest.raises(MissingDependencyError, match=r"--device cuda: gsplat is not installed.*splatreel\[cuda\]"):
        pick_device("cuda")


@pytest.mark.usefixtures("gpu")
def test_amd_gpus_are_not_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyTorch for ROCm calls its devices cuda."""
    with_gsplat(monkeypatch, True)
    monkeypatch.setattr(torch.version, "hip", "6.4")
    assert pick_device("auto").type == "cpu"
    with pytest.raises(UsageError, match="--device cuda: PyTorch finds no CUDA device"):
        pick_device("cuda")


def test_unknown_devices() -> None:
    with pytest.raises(UsageError, match="'tpu'"):
        pick_device("tpu")


def test_too_large_images_are_refused_with_a_width_that_fits() -> None:
    gigabyte = 10**9
    check_room(4 * gigabyte, 8 * gigabyte, 1352)
    with pytest.raises(ReconstructionError) as found:
        check_room(16 * gigabyte, 8 * gigabyte, 1000)
    assert "1000 pixels wide, take 16.0 GB; the GPU has 8.0 GB free" in str(found.value)
    assert "--width 546, or use --device cpu" in str(found.value)
    check_room(round(16 * gigabyte * 0.546**2), 8 * gigabyte, 546)
