"""`splatreel warmup`."""

from __future__ import annotations

from splatreel.cli.printing import counted, say
from splatreel.threads import use as use_threads


def warmup(threads: int | None = None) -> None:
    """Compile all CPU kernels now, so that the first reconstruction on this machine does not wait for them.

    Args:
        threads: Number of processes that compile; by default one per core.
    """
    use_threads(threads)
    from splatreel import threads as limit
    from splatreel.kernels.warmup import compile_kernels
    from splatreel.progress import console

    progress = console()
    try:
        compiled = compile_kernels(progress, limit.count())
    finally:
        progress.close()
    say(f"{counted(compiled, 'kernel')} compiled." if compiled else "All kernels were compiled before.")
