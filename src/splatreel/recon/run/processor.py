"""Name of this machine's processor, which measured times are stated with."""

from __future__ import annotations

import functools
import platform
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm

from splatreel import threads

CPUINFO = Path("/proc/cpuinfo")
WIDTHS = {"avx512f": "AVX-512", "avx2": "AVX2", "sve": "SVE", "neon": "NEON"}
"""Widest vector instructions that kernels are compiled for, by LLVM's name of the feature, the widest first."""


@functools.cache
def processor_name() -> str:
    """Return the model, such as `AMD EPYC 7763 64-Core Processor`, or the architecture where the system does not tell the model."""
    return " ".join((_model() or platform.processor() or platform.machine() or "unknown processor").split())


def describe_processor() -> str:
    """Return a description such as `AMD EPYC 7763 64-Core Processor with AVX2, 2 cores`."""
    features, cores = llvm.get_host_cpu_features(), threads.available()
    width = next((f" with {name}" for feature, name in WIDTHS.items() if features.get(feature)), "")
    return f"{processor_name()}{width}, {cores} core{'s'[: cores > 1]}"


def _model() -> str:
    """Return the model as the operating system tells it, or an empty text."""
    try:
        if sys.platform == "linux":
            lines = CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines()
            fields = dict(reversed([[part.strip() for part in line.split(":", 1)] for line in lines if ":" in line]))
            return fields.get("model name") or fields.get("Model") or ""
        if sys.platform == "darwin":
            command = ["sysctl", "-n", "machdep.cpu.brand_string"]
            return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
        if sys.platform == "win32":
            import winreg

            with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DESCRIPTION\System\CentralProcessor\0") as key:
                return str(winreg.QueryValueEx(key, "ProcessorNameString")[0])
    except (OSError, subprocess.SubprocessError):
        pass
    return ""
