"""`splatreel devices` and `splatreel warmup`, verbs about this machine."""

from __future__ import annotations

from splatreel.base.display import console
from splatreel.base.threads import use as use_threads
from splatreel.cli.printing import counted, say


def devices(measure: bool = True) -> None:
    """List the processors and GPUs of this machine, and say what `--device auto` would use and why.

    Args:
        measure: Time training iterations again, about two seconds for each device. Software adapters are not timed.
    """
    from splatreel.base.errors import GpuError
    from splatreel.gpu import adapters as gpus
    from splatreel.gpu.shared_gpu import SharedGpu
    from splatreel.run import machine_speed
    from splatreel.run.device_choice import faster_device, uses_gsplat
    from splatreel.run.machine_speed import describe_processor

    say(f"CPU   {describe_processor()}")
    if measure:
        say(f"      {machine_speed.iteration_ms(None):.1f} ms for a training iteration")
    found = gpus.adapters()
    chosen, why = gpus.choose_adapter(found)
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
        elif measure and not adapter.is_software and adapter is not chosen:
            try:
                say(f"      {machine_speed.iteration_ms(SharedGpu(adapter)):.1f} ms for a training iteration")
            except GpuError as error:
                say(f"      training fails: {error}")
    if uses_gsplat():
        say("--device auto uses CUDA with gsplat.")
    elif chosen is None:
        say(f"--device auto uses the CPU. {why}")
    elif measure:
        say(f"--device auto: {faster_device(chosen, machine_speed.SMALL.megapixels, renew=True)[1]}.")
    else:
        say(f"--device auto uses {chosen.name} through {chosen.route}, if it trains faster than the CPU.")


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
