"""Checks and settings for gsplat, which compiles its kernels when they are first used."""

import os
from importlib.util import find_spec

import torch

from splatreel.run.memory import free_memory

COMPILER_BYTES = 3e9
"""Memory that one process of CUDA's compiler is given."""


def missing() -> str | None:
    """Return what this machine lacks and how to fix it; None if it lacks nothing."""
    if not torch.cuda.is_available():
        if torch.version.cuda is None:
            return (
                "PyTorch was installed without CUDA here. On a machine with an NVIDIA GPU, let pip find the build with CUDA (unset "
                "PIP_EXTRA_INDEX_URL and PIP_FIND_LINKS), remove .venv and run `make gpu` again. Without a GPU, `--standin "
                "--results FILE` tries this script."
            )
        return "PyTorch finds no CUDA device. Is there an NVIDIA GPU, and its driver? `nvidia-smi` tells."
    if find_spec("gsplat") is None:
        return "gsplat is not installed. Run `pip install '.[cuda]'`."
    from torch.utils.cpp_extension import CUDA_HOME

    if CUDA_HOME is None and find_spec("gsplat.csrc") is None and torch.version.cuda is not None:
        return (
            f"gsplat compiles its kernels when it is first used, and CUDA's compiler is not there. Install the CUDA toolkit "
            f"{torch.version.cuda}, or set CUDA_HOME to where it is."
        )
    return None


def prepare_compiler() -> None:
    """Compile gsplat for this GPU only, with as many processes as cores and memory allow, unless the user chose otherwise."""
    major, minor = torch.cuda.get_device_capability()
    os.environ.setdefault("TORCH_CUDA_ARCH_LIST", f"{major}.{minor}")
    jobs = min(os.cpu_count() or 1, int((free_memory() or COMPILER_BYTES) / COMPILER_BYTES))
    os.environ.setdefault("MAX_JOBS", str(max(jobs, 1)))
