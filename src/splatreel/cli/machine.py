"""`splatreel devices` and `splatreel warmup`, verbs about this machine."""

from __future__ import annotations

from splatreel.base.display import console
from splatreel.base.threads import use as use_threads
from splatreel.cli.printing import counted, say


def devices(measure: bool = True) -> None:
    """List the processors and GPUs of this machine, and say what `--device auto` would use and why.

    Args:
        measure: Time training iterations, about two seconds for each device. Software adapters are not timed.
    """
    from splatreel.base.errors import GpuError
    from splatreel.gpu import adapters as gpus
    from splatreel.gpu.shared_gpu import SharedGpu
    from splatreel.run import machine_speed
    from splatreel.run.device_choice import pick_gpu
    from splatreel.run.machine_speed import describe_processor

    say(f"CPU   {describe_processor()}")
    if measure:
        say(f"      {machine_speed.iteration_ms(None):.1f} ms for a training iteration")
    found = gpus.adapters()
    for adapter in found:
        kind = "software" if adapter.is_software else adapter.kind
        buffer, shared = (
            adapter.limits[name] for name in ("max-storage-buffer-binding-size", "max-compute-workgroup-storage-size")
        )
        operations = "with" if adapter.subgroups else "without"
        say(f"GPU   {adapter.name} ({kind}) through {adapter.route}")
        say(f"      buffers up to {buffer / 1e6:,.0f} MB, {shared / 1024:.0f} KB a workgroup, {operations} subgroups")
        if adapter.missing is not None:
            say(f"      cannot train: {adapter.missing}")
        elif measure and not adapter.is_software:
            try:
                say(f"      {machine_speed.iteration_ms(SharedGpu(adapter)):.1f} ms for a training iteration")
            except GpuError as error:
                say(f"      training fails: {error}")
    chosen, why = gpus.choose_adapter(found)
    training = pick_gpu("auto")[0]
    if training is not None and training.kind == "cuda":
        say("--device auto uses CUDA with gsplat.")
    elif chosen is not None:
        say(f"--device auto uses {why}")
    else:
        say(f"--device auto uses the CPU. {why}")


def warmup(threads: int | None = None) -> None:
    """Compile all CPU kernels now, so that the first reconstruction on this machine does not wait for them.

    Args:
        threads: Number of processes that compile; by default one per core.
    """
    use_threads(threads)
    from splatreel.base import threads as limit
    from splatreel.kernels.warmup import compile_kernels

    with console() as progress:
        compiled = compile_kernels(progress, limit.count())
    say(f"{counted(compiled, 'kernel')} compiled." if compiled else "All kernels were compiled before.")
