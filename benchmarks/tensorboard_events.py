"""Write loss, PSNR, points, bytes and seconds of each group of a run as TensorBoard events, OUT/tensorboard. Needs tensorboardX.

python benchmarks/tensorboard_events.py OUT [--every 30]
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import tyro
from tensorboardX import event_file_writer, summary
from tensorboardX.proto import event_pb2

from splatreel.codec.manifest import Manifest
from splatreel.codec.writer import read_written_manifest
from splatreel.evaluation.page.run_facts import GroupFacts, group_facts
from splatreel.run.run_logs import RecordedStage, RunHistory, read_history

FOLDER = "tensorboard"
STEPS_PER_GROUP = 1000
"""Steps of the curves within groups: a loss halfway through the training of the third group has the step 2500."""


@dataclass(frozen=True)
class Scalar:
    """A number at a step of a curve.

    Attributes:
        tag: Name of the curve.
        value: The number.
        step: Number of the group, counted from 1; within groups in units of `STEPS_PER_GROUP`.
        time: Seconds since 1970.
    """

    tag: str
    value: float
    step: int
    time: float


class EventWriter:
    """Events of a run. They are written anew if there are older ones.

    Args:
        out: Output folder of the run.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._events: _EventFile | None = None
        self._written: set[tuple[str, int]] = set()

    def write(self) -> bool:
        """Write the numbers that are new. Return whether the run is finished. Numbers of the newest group follow with the next one."""
        manifest = read_written_manifest(self._out / "reel")
        if manifest is None:
            return False
        if self._events is None:
            for old in (self._out / FOLDER).glob("events.out.tfevents.*"):
                old.unlink()
            self._events = _EventFile(self._out / FOLDER)
        scalars = run_scalars(manifest, read_history(self._out / "work"), not manifest.live)
        new = [scalar for scalar in scalars if (scalar.tag, scalar.step) not in self._written]
        self._events.add(new)
        self._written.update((scalar.tag, scalar.step) for scalar in new)
        return not manifest.live

    def close(self) -> None:
        """Close the file."""
        if self._events is not None:
            self._events.close()


def run_scalars(manifest: Manifest, history: RunHistory, finished: bool) -> list[Scalar]:
    """Return the numbers of a run: the training loss within groups; loss, PSNR, points, bytes and seconds by group.

    Args:
        manifest: Manifest of the reel.
        history: History of the run.
        finished: True if the last group of the manifest is finished. Its seconds are incomplete before.
    """
    latest = {(stage.name, stage.group): stage for stage in history.stages}  # of a stage that was repeated, the last
    scalars = [scalar for stage in latest.values() for scalar in _loss_curve(stage)]
    groups = group_facts(manifest, history.group_seconds(), {})
    for facts in groups if finished else groups[:-1]:
        scalars += _group_scalars(facts, [stage for stage in latest.values() if stage.group == facts.index])
    return scalars


def _loss_curve(stage: RecordedStage) -> Iterator[Scalar]:
    """Yield the training loss within a stage."""
    for share, loss in stage.curve("loss"):
        step = round(STEPS_PER_GROUP * ((stage.group or 0) + share))
        yield Scalar(f"loss/{stage.name.replace(' ', '_')}", loss, step, stage.begin + share * stage.seconds)


def _group_scalars(facts: GroupFacts, stages: list[RecordedStage]) -> list[Scalar]:
    """Return the numbers of a group."""
    samples = [numbers for stage in stages for _, numbers in stage.samples]
    values = {
        "loss": next((numbers["loss"] for numbers in reversed(samples) if "loss" in numbers), None),
        "training_psnr": next((numbers["psnr"] for numbers in reversed(samples) if "psnr" in numbers), None),
        "static_points": facts.static,
        "dynamic_points": facts.dynamic,
        "bytes": facts.bytes,
        "seconds": facts.seconds,
    }
    end = max((stage.end for stage in stages), default=0.0)
    found = {name: value for name, value in values.items() if value is not None}
    return [Scalar(f"group/{name}", float(value), facts.index + 1, end) for name, value in found.items()]


class _EventFile:
    """Event file in a folder, which is created. Every event is on the disk when `add` returns.

    tensorboardX's own `SummaryWriter` writes in a thread, and its `flush` does not wait for it.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = event_file_writer.EventsWriter(str(folder / "events"))

    def add(self, scalars: list[Scalar]) -> None:
        """Write numbers."""
        for scalar in scalars:
            value = summary.scalar(scalar.tag, scalar.value)
            event = event_pb2.Event(wall_time=scalar.time, step=scalar.step, summary=value)  # pyright: ignore[reportAttributeAccessIssue]
            self._writer.write_event(event)
        self._writer.flush()

    def close(self) -> None:
        """Close the file."""
        self._writer.close()


def main(out: tyro.conf.Positional[Path], /, every: float | None = None) -> None:
    """Write the events of a run.

    Args:
        out: Output folder of `reconstruct`.
        every: Continue every so many seconds until the run is finished.
    """
    events = EventWriter(out)
    while not events.write() and every is not None:
        time.sleep(every)
    events.close()


if __name__ == "__main__":
    tyro.cli(main)
