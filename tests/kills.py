"""Commands that are killed at random moments and continued by the same command: their result must be the same bytes.

Moments are counted, so that a seed decides where a command dies: around everything that changes what lies on the disk (a file is begun,
half written, made durable, moved, deleted), and around every stage and iteration. A killed command goes on with what it has kept, so a
chain of many kills costs no more than a few runs. python -m tests.kills sequence=8 film=2
"""

from __future__ import annotations

import json
import mmap
import os
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import wave
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load

from tests.capture import folders
from tests.capture.recorder import Recorder
from tests.files import contents
from tests.importing import films
from tests.method.captures import WallCapture
from tests.method.small import FEW
from tests.segmentation import scenes

FRAMES = 4
REACH = 3
"""A command dies within this share of the moments that a whole run has: one that comes too far has little left to be killed in."""
CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate")
"""Audit events of Python's that change a folder; opening a file to write is one more."""
STAGES = {
    "reading": "cameras",
    "finding": "points",
    "building": "keyframe",
    "refining": "keyframe",
    "telling": "layering",
    "following": "tracking",
    "learning": "motion",
    "writing": "publishing",
}
"""By a word of what the user reads."""


@dataclass(frozen=True)
class Command:
    """One verb. arguments: for the folder that it writes to. content: what it leaves there, without what tells of the run itself."""

    name: str
    arguments: Callable[[Path], list[str]]
    content: Callable[[Path], dict[str, bytes]] = contents


@dataclass(frozen=True)
class Attempt:
    """End of a process. moments: moments it reached. stage: stage in which it ended."""

    code: int
    moments: int
    stage: str
    output: str

    @property
    def killed(self) -> bool:
        return self.code == -signal.SIGKILL


@dataclass
class Found:
    """Findings about one command. killed: number of kills by stage; refused: number of times that a full disk stopped it.

    different, checkpoints: files of the result and of the checkpoints that differ from an undisturbed run, and the difference.
    """

    command: str
    moments: int = 0
    seconds: float = 0.0
    killed: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    different: list[str] = field(default_factory=list)
    checkpoints: list[str] = field(default_factory=list)

    def compare(self, out: Path, expected: dict[str, bytes], left: dict[str, bytes]) -> None:
        """Note the files in `out` that differ."""
        for name in sorted({*expected, *left}):
            wanted, found = expected.get(name), left.get(name)
            if wanted != found:
                whose = self.checkpoints if name.startswith("work/") else self.different
                whose.append(f"{out.name}/{name} ({_difference(name, wanted, found)})")


class Moments:
    """Counts in a process, and kills it at moment number `fatal`. What it counted is in shared memory, where its parent reads it."""

    def __init__(self, shared: mmap.mmap, fatal: int | None) -> None:
        self.shared, self.fatal, self.count, self.stage = shared, fatal, 0, "opening"

    def __call__(self) -> None:
        self.count += 1
        self.shared[: 8 + len(self.stage)] = struct.pack("<Q", self.count) + self.stage.encode()
        if self.count == self.fatal:
            os.kill(os.getpid(), signal.SIGKILL)

    def watch(self) -> None:
        """Let everything count from now on."""
        from splatreel.base.display import Lines
        from splatreel.method.train.group_trainer import GroupTrainer
        from splatreel.method.train.keyframe_trainer import KeyframeTrainer

        sys.addaudithook(self._hear)
        self._around(os, "fsync")
        self._around(os, "replace")
        self._around(os, "unlink")
        self._around(GroupTrainer, "_iterate")
        self._around(KeyframeTrainer, "_run_batch")
        self._around(Lines, "update")
        self._around(Lines, "stage", enter=self._begin)
        written = Path.write_bytes

        def write_in_halves(path: Path, data: bytes) -> int:
            written(path, data[: len(data) // 2])
            self()
            return written(path, data)

        Path.write_bytes = write_in_halves  # pyright: ignore[reportAttributeAccessIssue]

    def _begin(self, _lines: object, name: str, *_: object) -> None:
        self.shared[8:] = bytes(len(self.shared) - 8)
        self.stage = next((stage for word, stage in STAGES.items() if word in name.split()), name.split(": ")[-1])[:40]

    def _hear(self, event: str, args: tuple[Any, ...]) -> None:
        writes = event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if event in CHANGES or writes:
            self()

    def _around(self, owner: Any, name: str, enter: Callable[..., None] | None = None) -> None:
        really = getattr(owner, name)

        def counted(*args: Any, **named: Any) -> Any:
            if enter is not None:
                enter(*args, **named)
            self()
            result = really(*args, **named)
            self()
            return result

        setattr(owner, name, counted)


def attempt(command: Command, out: Path, fatal: int | None = None, most: int | None = None) -> Attempt:
    """Run a command in a process of its own, which begins with everything imported.

    It dies at moment `fatal`. most: bytes that a file may have there: more are refused, as by a full disk.
    """
    shared = mmap.mmap(-1, 128)
    log = out.parent / f"{out.name}.log"
    read, write = os.pipe()  # a limit of files would cut the log
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.close(read)
            handle = write if most is not None else os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, 1)
            os.dup2(handle, 2)
            if most is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
            moments = Moments(shared, fatal)
            moments.watch()
            from splatreel.cli.main import main

            code = main(command.arguments(out))
            sys.stdout.flush()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read, errors="replace") as pipe:
        said = pipe.read() if most is not None else ""
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    stage = shared[8:].rstrip(b"\0").decode()
    return Attempt(code, struct.unpack("<Q", shared[:8])[0], stage, said or log.read_text(errors="replace"))


def chain(command: Command, out: Path, kills: int, moments: int, rng: np.random.Generator) -> Counter[str]:
    """Kill a command up to so many times, and then let it end. Returns the stages that it was killed in."""
    killed: Counter[str] = Counter()
    while True:
        within = max(moments // REACH, 2)
        fatal = int(rng.integers(1, within + 1)) if killed.total() < kills else None
        ended = attempt(command, out, fatal)
        if ended.code == 0:
            return killed
        if not ended.killed:
            raise AssertionError(f"{command.name}: code {ended.code} after {killed.total()} kills\n{ended.output}")
        killed[ended.stage] += 1


def try_command(command: Command, folder: Path, kills: int, seed: int) -> Found:
    """Kill a command so many times in all, in as many chains as that takes."""
    found, rng = Found(command.name), np.random.default_rng(seed)
    whole = folder / f"{command.name} whole"
    whole.mkdir()
    started = time.monotonic()
    ended = attempt(command, whole)
    if ended.code != 0:
        raise AssertionError(f"{command.name}: code {ended.code}\n{ended.output}")
    found.seconds, found.moments = time.monotonic() - started, ended.moments
    expected = command.content(whole)
    number = 0
    while found.killed.total() < kills:
        number += 1
        out = folder / f"{command.name} {number}"
        out.mkdir()
        met = chain(command, out, kills - found.killed.total(), found.moments, rng)
        if not met:
            raise AssertionError(f"{command.name}: could not be killed within {found.moments} moments")
        found.killed += met
        found.compare(out, expected, command.content(out))
    out = folder / f"{command.name} full"
    out.mkdir()
    found.refused = _fill(command, out, max(len(data) for data in expected.values()))
    found.compare(out, expected, command.content(out))
    return found


def _fill(command: Command, out: Path, largest: int) -> int:
    """Let a command meet a disk that has room for a third of its largest file, for two thirds, and for all. Returns how often it was
    refused. Raises AssertionError where it does not say what to do."""
    refused = 0
    for most in (largest // 3, 2 * largest // 3, None):
        ended = attempt(command, out, most=most)
        explained = ended.code == 1 and "Error: " in ended.output and "Traceback" not in ended.output
        if ended.code != 0 and not (most is not None and explained):
            raise AssertionError(f"{command.name}: code {ended.code} where files may have {most} bytes\n{ended.output}")
        refused += ended.code
    return refused


def _difference(name: str, wanted: bytes | None, found: bytes | None) -> str:
    """In what two versions of a file differ."""
    if wanted is None or found is None:
        return "should not be there" if wanted is None else "is missing"
    if not name.endswith(".safetensors"):
        return f"{len(wanted)} bytes, {len(found)} found"
    arrays, others = load(wanted), load(found)
    if {key: value.shape for key, value in arrays.items()} != {key: value.shape for key, value in others.items()}:
        return "other arrays"
    apart = {key: np.abs(value.astype(float) - others[key]) for key, value in arrays.items()}
    told = [f"{key}: {(by != 0).sum()} of {by.size} values, by {by.max()}" for key, by in apart.items() if by.any()]
    return "; ".join(told) or "not in what they say"


def commands(folder: Path) -> Iterator[Command]:
    """Each of what takes long, on a tiny capture. What needs a finished run has the first command's, left by `try_command`."""
    capture, music, gaussians, scene = (folder / name for name in ("capture", "music.wav", "gaussians", "scene"))
    pictures = folder / "pictures"
    filming = os.fork()  # threads that draw would not be there in processes that are forked later, and be waited for
    if filming == 0:
        try:
            _film(capture, music)
            films.write_film(gaussians, [films.frame(number) for number in range(FRAMES)])
            _record(pictures)
            scenes.write_capture(scene, FRAMES)
        finally:
            os._exit(not scene.exists())
    assert os.waitpid(filming, 0)[1] == 0
    sizes = [f"--set={name}={json.dumps(value)}" for name, value in FEW.items()]
    run = ["reconstruct", str(capture), f"--sound={music}", "--hold-out=cam01", *sizes]

    def reel(out: Path) -> dict[str, bytes]:
        times = ("work/seconds.json", "work/logs/", "report.html")
        return {name: data for name, data in contents(out).items() if not name.startswith(times)}

    yield Command("sequence", lambda out: [*run, "--renditions=high,low", f"--out={out}"], reel)
    yield Command("chapters", lambda out: [*run, "--set=chapter_frames=3", f"--out={out}"], reel)
    made = folder / "sequence whole"
    yield Command("encode", lambda out: ["encode", str(made), f"--out={out / 'reel'}", "--rate=low"])
    yield Command("import", lambda out: ["import", str(gaussians), f"--out={out / 'reel'}"])
    yield Command("publish", lambda out: ["publish", str(made), str(out / "public")])
    yield Command("evaluate", lambda out: ["evaluate", str(made / "reel"), str(capture), f"--out={out}"], _report)
    yield Command("film", lambda out: ["export", str(made / "reel"), f"--out={out / 'film.mp4'}"])
    yield Command("page", lambda out: ["export", str(made / "reel"), f"--out={out / 'page.html'}"])
    yield Command("edit", lambda out: ["edit", str(made / "reel"), "scale=2", f"--out={out / 'reel'}"])
    yield Command("convert", lambda out: ["capture", "convert", str(capture), str(out / "converted")])
    yield Command("masks", lambda out: ["capture", "masks", str(scene), f"--out={out / 'masks'}", "--width=64"])
    person = ["reconstruct", str(scene), "--masks=auto", "--hold-out=none", *sizes]
    yield Command("subject", lambda out: [*person, f"--out={out}"], reel)
    followed = ["reconstruct", str(pictures), "--follow", "--follow-timeout=0.5", "--hold-out=none", *sizes]
    yield Command("follow", lambda out: [*followed, f"--out={out}", f"--publish={out / 'public'}"], reel)
    yield Command("frames", lambda out: ["export", str(made / "reel"), f"--out={out / 'frames'}", "--format=spz"])


def _film(capture: Path, music: Path) -> None:
    source = WallCapture(FRAMES, cameras=5)
    capture.mkdir()
    for camera in source.cameras:
        folders.write_video(capture / f"{camera.name}.mp4", list(source.read(0, FRAMES, [camera.name])[:, 0]))
    np.save(capture / "poses_bounds.npy", folders.llff(source.cameras))
    with wave.open(str(music), "wb") as file:
        file.setparams((1, 2, 48000, 0, "NONE", ""))
        file.writeframes((8000 * np.sin(np.arange(12000) / 20)).astype("<i2").tobytes())


def _record(folder: Path) -> None:
    """Write a capture of images that may still grow."""
    wall = WallCapture(FRAMES, cameras=5)

    def image(camera: int, frame: int) -> np.ndarray:
        return wall.read(frame, 1, [wall.cameras[camera].name])[0, 0]

    Recorder(folder, "pictures", image, cameras=wall.cameras, fps=30).write(FRAMES)


def _report(out: Path) -> dict[str, bytes]:
    """A report without the time and the memory that the process took, which are never the same."""
    found = contents(out)
    plain = json.loads(found.get("report.json", b"{}"))
    for name in ("peak_memory_bytes", "seconds", "decode_ms_per_frame", "render_fps"):
        plain.pop(name, None)
    measured = (b"| Peak memory", b"| Time", b"| Decoding", b"| Rendering")
    lines = [line for line in found.get("report.md", b"").splitlines() if not line.startswith(measured)]
    found.pop("report.html", None)
    return found | {"report.json": json.dumps(plain).encode(), "report.md": b"\n".join(lines)}


def run(kills: dict[str, int], seed: int) -> list[Found]:
    """Kill each of these commands so many times, and say what became of it."""

    with tempfile.TemporaryDirectory() as place:
        results = []
        for number, command in enumerate(commands(Path(place))):
            if command.name not in kills:
                continue
            found = try_command(command, Path(place), kills[command.name], seed + number)
            stages = ", ".join(f"{name} {count}" for name, count in sorted(found.killed.items()))
            whole = f"{found.moments} moments in {found.seconds:.1f} s"
            met = f"killed in {stages}; {found.refused} full disks"
            print(f"{found.command}: {whole}; {met}; files that differ: {found.different or 'none'}", flush=True)
            if found.checkpoints:
                print(f"  checkpoints that differ: {found.checkpoints}", flush=True)
            results.append(found)
        return results


NAMES = (
    "sequence",
    "chapters",
    "encode",
    "import",
    "publish",
    "evaluate",
    "film",
    "page",
    "edit",
    "convert",
    "masks",
    "subject",
    "follow",
    "frames",
)

if __name__ == "__main__":
    asked = dict(text.split("=") for text in sys.argv[1:])
    results = run({name: int(count) for name, count in asked.items()}, seed=0)
    sys.exit(any(found.different for found in results))
