"""Contexts in which torch reports a simulated CUDA device, with or without gsplat."""

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch

from splatreel.run import device_choice
from tests.standin import gsplat
from tests.standin.device import WAITS, Asked


@contextmanager
def without_gsplat() -> Iterator[None]:
    """Simulate a machine with CUDA but without gsplat, on which training is impossible."""
    find = importlib.util.find_spec
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "gsplat" else find(name, *rest))
        patch.setitem(sys.modules, "gsplat", None)  # makes the import fail
        patch.setitem(sys.modules, "gsplat.cuda._wrapper", None)
        patch.setattr(device_choice, "cuda_devices", lambda: ["stand-in"])
        patch.setattr(device_choice, "may_have_gpu", lambda: True)
        patch.setattr(torch.cuda, "is_available", lambda: True)
        with Asked():
            yield


@contextmanager
def gpu() -> Iterator[None]:
    """Simulate a machine with CUDA and gsplat. The kernels of gsplat are replaced by kernels for the CPU."""
    find, overwrite = importlib.util.find_spec, torch.__future__.get_overwrite_module_params_on_conversion()
    with pytest.MonkeyPatch.context() as patch:
        gsplat.install(patch)
        patch.setattr(importlib.util, "find_spec", lambda name, *rest: name == "gsplat" or find(name, *rest))
        patch.setattr(device_choice, "cuda_devices", lambda: ["stand-in"])
        patch.setattr(device_choice, "may_have_gpu", lambda: True)
        patch.setattr(torch.cuda, "is_available", lambda: True)
        patch.setattr(torch.cuda, "mem_get_info", lambda device=None: (40 << 30, 80 << 30))
        patch.setattr(torch.cuda, "max_memory_allocated", lambda device=None: 1 << 30)
        patch.setattr(torch.cuda, "get_device_name", lambda device=None: "stand-in")
        patch.setattr(torch.cuda, "device_count", lambda: 1)
        patch.setattr(torch.cuda, "get_device_capability", lambda device=None: (9, 0))
        for nothing in ("synchronize", "reset_peak_memory_stats", "empty_cache"):
            patch.setattr(torch.cuda, nothing, lambda device=None: None)
        # Because the data of a wrapper cannot be swapped.
        torch.__future__.set_overwrite_module_params_on_conversion(True)
        WAITS.clear()
        try:
            with Asked():
                yield
        finally:
            torch.__future__.set_overwrite_module_params_on_conversion(overwrite)
