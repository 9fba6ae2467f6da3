"""Memory of this process."""

from __future__ import annotations

import sys


def peak_memory_bytes() -> int | None:
    """Most memory this process ever held resident, in bytes; None where the system does not tell (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
