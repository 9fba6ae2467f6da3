"""Test and measure Splatreel on a machine with a GPU, within a time limit: through gsplat, wgpu and NVRTC, side by side.

python benchmarks/gpu.py --minutes 8 --basketball FOLDER

What matters most comes first, and each step is recorded when it is done: a line of results.jsonl, with what failed if it did.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import tyro

import kitchen
from cuda_compiler import missing, prepare_compiler
from curve import reconstruct_until
from parity import differences, drawing
from record import RESULTS, ROOT, record
from splatreel.base.display import console
from splatreel.base.errors import GpuError
from splatreel.base.process import keep_freed_memory
from splatreel.capture.opening import open_capture
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.gpu.adapters import CUDA, Adapter, adapters, choose_adapter
from splatreel.gpu.cuda_libraries import find_compilers
from splatreel.gpu.shared_gpu import SharedGpu, open_gpu
from splatreel.run.device_choice import pick_gpu
from splatreel.run.machine_speed import LARGE, SMALL, Probe, iteration_ms

FAR_OFF = 0.02
"""Relative difference between the devices above which an iteration is wrong, and not only rounded otherwise."""
NO_GPU = "not run: there is no GPU for wgpu or NVRTC"
Found = dict[str, Any]


@dataclass(frozen=True)
class Sizes:
    """Sizes of the measurements. settings: those that differ from the quality's."""

    points: int = 100_000
    drawn: tuple[tuple[int, int], ...] = ((640, 360), (1920, 1080))
    repeats: int = 7
    probes: tuple[Probe, ...] = (SMALL, LARGE)
    basketball: int = 640
    kitchen: int = 1352
    frames: int = 30
    settings: dict[str, Any] = field(default_factory=lambda: {"check_coverage": False})


TINY_SETTINGS = {"keyframe.first_iterations": 12, "group.iterations_per_frame": 2, "check_coverage": False}
TINY_PROBES = (Probe(60, 32, 24, -2.0, 1.0, 1),)
TINY = Sizes(60, ((32, 18),), 1, TINY_PROBES, 32, 32, 3, TINY_SETTINGS)
"""For the stand-in."""


@dataclass(frozen=True)
class Bench:
    """State that all steps share. ends: end of the available time on the monotonic clock, seconds. device: the GPU's name."""

    ends: float
    basketball: Path | None
    out: Path
    results: Path
    note: str
    sizes: Sizes
    device: str
    standin: bool

    def left(self) -> float:
        """Return the remaining seconds."""
        return max(self.ends - time.monotonic(), 0.0)

    def record(self, name: str, found: Found) -> None:
        """Append a record. A step with numbers that are not finite, which JSON cannot hold, is recorded as failed."""
        label: Found = {"device": self.device}
        label |= {name: version(name) for name in ("torch", "gsplat", "wgpu") if find_spec(name) is not None}
        if found_compilers := find_compilers():
            label["nvrtc"] = found_compilers[0].name
        try:
            record(f"gpu {name}", label | found, self.note, self.results)
        except ValueError as error:
            record(f"gpu {name}", label | {"failed": f"{error}: {found}"[:2000]}, self.note, self.results)


def main(
    minutes: float = 8.0,
    basketball: Path | None = None,
    steps: str = "",
    out: Path = Path("out/gpu"),
    results: Path | None = None,
    standin: bool = False,
    note: str = "",
) -> None:
    """Run the steps in their order and record each; ends with 1 if one failed, or where there is no GPU.

    minutes: for all of it. Trainings share what is left, and are stopped when theirs is over.
    basketball: folder of the Panoptic capture; without it, that is left out.
    steps: some of them, with commas: adapters, compile, tests, parity, wgpu-tests, iterations, drawing, basketball-standard,
    basketball-wgpu-standard, basketball-paper, film (which needs no GPU), kitchen-standard, kitchen-paper; all by default, and those of
    wgpu, which use NVRTC where there is no Vulkan, where CUDA or gsplat is missing.
    standin: try the script without a GPU, on tiny sizes; it needs --results, a file other than that of real measurements.
    """
    names = steps.split(",") if steps else list(STEPS)
    if unknown := [name for name in names if name not in STEPS]:
        fail(2, f"--steps: there is no step {unknown[0]!r}. Choose among {', '.join(STEPS)}.")
    if standin and (results is None or results.resolve() == RESULTS):
        fail(2, "--standin measures nothing: name a file of its own, --results FILE.")
    sizes = TINY if standin else Sizes()
    bench = Bench(time.monotonic() + 60 * minutes, basketball, out, results or RESULTS, note, sizes, "none", standin)
    with machine(standin):
        why = missing() if set(names) - set(WITHOUT_CUDA) else None
        if why is not None:
            adapter, reason = choose_adapter(adapters())
            if steps or adapter is None:
                fail(1, f"{why}\nThrough wgpu or NVRTC: {reason}")
            print(f"{why}\nOnly the steps of wgpu and NVRTC run: {reason}")
            names = [name for name in names if name in WITHOUT_CUDA and name != "film"]
            bench = replace(bench, device=adapter.name)
        elif set(names) - set(WITHOUT_CUDA):
            prepare_compiler()
            bench = replace(bench, device="stand-in" if standin else cuda().adapter.name)
        if basketball is None and any(name.startswith("basketball") for name in names):
            print("Basketball is left out: --basketball FOLDER would say where the Panoptic capture is.")
            names = [name for name in names if not name.startswith("basketball")]
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that a step that is ended records what it has
        keep_freed_memory()  # as the command line does
        failed = run_steps(bench, names)
    sys.exit(1 if failed else 0)


def fail(code: int, text: str) -> NoReturn:
    print(text, file=sys.stderr)
    sys.exit(code)


def machine(standin: bool) -> contextlib.AbstractContextManager[None]:
    """Return this machine, or the one with the stand-in of the tests."""
    if not standin:
        return contextlib.nullcontext()
    sys.path.insert(0, str(ROOT))
    from tests.standin.gpu import gpu

    return gpu()


def cuda() -> SharedGpu:
    """Return the GPU that gsplat uses."""
    gpu, _ = pick_gpu("cuda")
    assert gpu is not None
    return gpu


def run_steps(bench: Bench, names: list[str]) -> bool:
    """Run the steps, and return True if any failed."""
    failed = False
    for place, name in enumerate(names):
        if bench.left() == 0:
            print(f"no time is left for {', '.join(names[place:])}", flush=True)
            break
        trainings = sum(name.endswith(QUALITIES) for name in names[place:])
        if run_step(bench, name, bench.left() / max(trainings, 1)):
            continue
        failed = True
        if name == "compile":
            print("without gsplat's kernels nothing else can run", flush=True)
            break
        if not usable():
            print(f"{name} left CUDA unusable for this process: the rest runs in another one", flush=True)
            in_new_process(bench, names[place + 1 :])
            break
    return failed


def run_step(bench: Bench, name: str, share: float) -> bool:
    """Run and record a step, and return True if it succeeded.

    Args:
        share: Seconds for the step, if it is a training.
    """
    found: Found = {}
    print(f"{name} ...", flush=True)
    started = time.monotonic()
    try:
        STEPS[name](bench, found, share)
    except BaseException as error:
        found["failed"] = f"{type(error).__name__}: {str(error)[-2000:]}"
        if not isinstance(error, Exception):  # somebody ends it: what it found is recorded nevertheless
            raise
    finally:
        found.setdefault("seconds", round(time.monotonic() - started, 2))
        if len(found) > 1:  # filming finds nothing
            bench.record(name.replace("-", " "), found)
    print(f"{name}: {found.get('failed', 'done')}, {found['seconds']:.1f} s", flush=True)
    return "failed" not in found


def usable() -> bool:
    """Return True if CUDA still works. After some errors, no call of the process succeeds."""
    if "torch" in sys.modules:
        import torch

        try:
            torch.cuda.empty_cache()
            torch.cuda.synchronize()
        except RuntimeError:
            return False
    return True


def in_new_process(bench: Bench, names: list[str]) -> None:
    """Run the remaining steps in the remaining time."""
    if not names or bench.left() == 0:
        return
    command = [sys.executable, __file__, "--minutes", str(bench.left() / 60), "--steps", ",".join(names)]
    command += ["--out", str(bench.out), "--results", str(bench.results), "--note", bench.note]
    command += ["--basketball", str(bench.basketball)] if bench.basketball else []
    subprocess.call([*command, "--standin"] if bench.standin else command)


def compile_kernels(bench: Bench, found: Found, share: float) -> None:
    """Compile the kernels of gsplat by one iteration."""
    differences(TINY_PROBES[0], cuda())
    found |= {"arch": os.environ["TORCH_CUDA_ARCH_LIST"], "jobs": os.environ["MAX_JOBS"]}


def cuda_tests(bench: Bench, found: Found, share: float) -> None:
    """Run the tests of the programs of gsplat in a process of their own. They use a real GPU if there is one."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-m", "", "-q", "tests/gsplat"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=bench.left())
    lines = ran.stdout.strip().splitlines() or ["nothing was printed"]
    found["tests"] = lines[-1].strip("= ")
    if ran.returncode != 0 or "skipped" in found["tests"]:
        raise RuntimeError("\n".join([*lines[-20:], ran.stderr[-1000:]]))


def parity(bench: Bench, found: Found, share: float) -> None:
    """Compare one iteration on both devices."""
    probe = bench.sizes.probes[0]
    found |= {"points": probe.points, "width": probe.width, "height": probe.height}
    found["largest_relative_difference"] = differences(probe, cuda())
    worst = max(found["largest_relative_difference"].values())
    if not worst < FAR_OFF:
        raise RuntimeError(f"the GPU differs from the CPU by {worst:.2g} of the largest value")


def list_adapters(bench: Bench, found: Found, share: float) -> None:
    """List the adapters of wgpu and NVRTC and which one training would use, and test each."""
    every = adapters()
    found["adapters"] = [
        {"name": each.name, "interface": each.interface, "kind": each.kind, "missing": each.missing} for each in every
    ]
    found["auto"] = choose_adapter(every)[1]
    found["self_test"] = {f"{each.name} {each.interface}": self_test(each) for each in every if each.missing is None}


def self_test(adapter: Adapter) -> str:
    """Open an adapter, which draws a scene there and on the CPU. Return what failed, or `passed`."""
    try:
        open_gpu(adapter)
    except GpuError as error:
        return str(error)
    return "passed"


def wgpu_tests(bench: Bench, found: Found, share: float) -> None:
    """Compare the kernels with the CPU's, on the first adapter of wgpu and on the first one of NVRTC."""
    if bench.standin or choose_adapter(adapters())[0] is None:
        found["tests"] = NO_GPU
        return
    command = [sys.executable, "-m", "pytest", "-q", "-k", "not emulated"]
    command += ["tests/gpu", "tests/method/train/test_programs.py"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=max(bench.left(), 1))
    lines = ran.stdout.strip().splitlines() or ["nothing was printed"]
    found["tests"] = lines[-1].strip("= ")
    if ran.returncode != 0:
        raise RuntimeError("\n".join([*lines[-20:], ran.stderr[-1000:]]))


def iteration_times(bench: Bench, found: Found, share: float) -> None:
    """Measure the milliseconds of a keyframe's iteration: on the CPU, with gsplat, and on each adapter of wgpu and NVRTC."""
    rows = found["milliseconds"] = {}
    programs: list[tuple[str, SharedGpu | None]] = [("cpu", None)]
    programs += [("cuda", cuda())] if missing() is None and not bench.standin else []
    hardware = [each for each in adapters() if each.missing is None and not each.is_software]
    for each in hardware:
        route = f"nvrtc {each.name}" if each.interface == CUDA else f"wgpu {each.name} {each.interface}"
        programs.append((route, SharedGpu(each)))
    for probe in bench.sizes.probes:
        for name, gpu in programs:
            row = f"{probe.points} {probe.width}x{probe.height}, {name}"
            rows[row] = round(iteration_ms(gpu, probe, 1.0), 3)
    if not hardware:
        found["wgpu"] = NO_GPU


def drawing_rates(bench: Bench, found: Found, share: float) -> None:
    """Measure images per second."""
    found["points"] = bench.sizes.points
    with cuda_memory(found):
        for width, height in bench.sizes.drawn:
            found[f"fps {width}x{height}"] = drawing(bench.sizes.points, width, height, 3 * bench.sizes.repeats)


@contextlib.contextmanager
def cuda_memory(found: Found) -> Iterator[None]:
    """Record the largest memory that PyTorch takes on the GPU within the block."""
    import torch

    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats()
    try:
        yield
    finally:
        found["gpu_memory_mb"] = round(torch.cuda.max_memory_allocated() / 1e6, 1)


def basketball(bench: Bench, found: Found, share: float, quality: Quality) -> None:
    """Return the Panoptic capture as basketball.py opens it."""
    assert bench.basketball is not None
    train(bench, found, share, bench.basketball, bench.sizes.basketball, f"basketball-{quality}", quality)


def basketball_wgpu(bench: Bench, found: Found, share: float) -> None:
    """Train the Panoptic capture through wgpu, or NVRTC where there is no Vulkan, if there is a GPU for it."""
    assert bench.basketball is not None
    if bench.standin or choose_adapter(adapters())[0] is None:
        found["wgpu"] = NO_GPU
        return
    train(bench, found, share, bench.basketball, bench.sizes.basketball, "basketball-wgpu", "standard", "gpu")


def film(bench: Bench, found: Found, share: float) -> None:
    """Film the kitchen, unless it exists."""
    if not kitchen_folder(bench).exists():
        kitchen.film(bench.sizes.kitchen).write(kitchen_folder(bench), bench.sizes.frames)


def kitchen_folder(bench: Bench) -> Path:
    return bench.out / f"kitchen-{bench.sizes.kitchen}-{bench.sizes.frames}"


def kitchen_film(bench: Bench, found: Found, share: float, quality: Quality) -> None:
    train(bench, found, share, kitchen_folder(bench), bench.sizes.kitchen, f"kitchen-{quality}", quality)


def train(
    bench: Bench,
    found: Found,
    share: float,
    capture: Path,
    width: int,
    name: str,
    quality: Quality,
    device: str = "cuda",
) -> None:
    """Reconstruct a capture's first frames on the GPU for `share` seconds at most, and measure on the way."""
    source = open_capture(capture, width=width, frames=(0, bench.sizes.frames))
    config = changed(preset(quality), bench.sizes.settings)
    progress = console()
    try:
        with cuda_memory(found) if device == "cuda" else contextlib.nullcontext():
            reconstruct_until(found, source, bench.out / name, config, device, share, progress)
    finally:
        progress.close()
        source.close()


QUALITIES: tuple[Quality, ...] = ("standard", "paper")
STEPS: dict[str, Callable[[Bench, Found, float], None]] = {
    "adapters": list_adapters,
    "compile": compile_kernels,
    "tests": cuda_tests,
    "parity": parity,
    "wgpu-tests": wgpu_tests,
    "iterations": iteration_times,
    "drawing": drawing_rates,
    "basketball-standard": partial(basketball, quality="standard"),
    "basketball-wgpu-standard": basketball_wgpu,
    "basketball-paper": partial(basketball, quality="paper"),
    "film": film,
    **{f"kitchen-{quality}": partial(kitchen_film, quality=quality) for quality in QUALITIES},
}
"""What matters most first."""
WITHOUT_CUDA = ("adapters", "wgpu-tests", "iterations", "basketball-wgpu-standard", "film")
"""Steps that need no CUDA."""

if __name__ == "__main__":
    tyro.cli(main)
