"""`splatreel warmup`."""

from __future__ import annotations

from splatreel.base.threads import use as use_threads
from splatreel.cli.printing import counted, say


def warmup(threads: int | None = None) -> None:
    """Compile all CPU kernels now, so that the first reconstruction on this machine does not wait for them.

    Args:
        threads: Number of processes that compile; by default one per core.
    """
    use_threads(threads)
    from splatreel.base import threads as limit
    from splatreel.base.display import console
    from splatreel.kernels.warmup import compile_kernels

    progress = console()
    try:
        compiled = compile_kernels(progress, limit.count())
    finally:
        progress.close()
    say(f"{counted(compiled, 'kernel')} compiled." if compiled else "All kernels were compiled before.")
