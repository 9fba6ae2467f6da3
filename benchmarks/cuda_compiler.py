"""Checks and settings for gsplat, which compiles its kernels when they are first used."""

import os
from importlib.util import find_spec

from splatreel.run.requirements import free_memory

COMPILER_BYTES = 3e9
"""Memory that one process of CUDA's compiler is given."""


def missing() -> str | None:
    """Return what this machine lacks and how to fix it; None if it lacks nothing."""
    if find_spec("torch") is None or find_spec("gsplat") is None:
        return "gsplat or PyTorch is not installed. Run `pip install '.[cuda]'`."
    import torch

    if not torch.cuda.is_available():
        return (
            "PyTorch finds no CUDA device. Is there an NVIDIA GPU, and its driver? `nvidia-smi` tells. Without a GPU, `--standin "
            "--results FILE` tries this script."
        )
    from torch.utils.cpp_extension import CUDA_HOME

    if CUDA_HOME is None and find_spec("gsplat.csrc") is None and torch.version.cuda is not None:
        return (
            f"gsplat compiles its kernels when it is first used, and CUDA's compiler is not there. Install the CUDA toolkit "
            f"{torch.version.cuda}, or set CUDA_HOME to where it is."
        )
    return None


def prepare_compiler() -> None:
    """Compile gsplat for this GPU only, with as many processes as cores and memory allow, unless the user chose otherwise."""
    import torch

    major, minor = torch.cuda.get_device_capability()
    os.environ.setdefault("TORCH_CUDA_ARCH_LIST", f"{major}.{minor}")
    jobs = min(os.cpu_count() or 1, int((free_memory() or COMPILER_BYTES) / COMPILER_BYTES))
    os.environ.setdefault("MAX_JOBS", str(max(jobs, 1)))
