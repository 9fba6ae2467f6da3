"""TensorBoard events of a run, OUT/tensorboard, with the extra `splatreel[tensorboard]`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.codec.manifest import Manifest
from splatreel.codec.written_reel import read_written_manifest
from splatreel.evaluation.page.run_facts import GroupFacts, group_facts
from splatreel.run.run_history import RecordedStage, RunHistory, read_history
from splatreel.storage.address import local_path

if TYPE_CHECKING:
    from splatreel.codec.writer import ReelWriter
    from splatreel.evaluation.page.report_writer import ReportWriter

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
    """Hook of a run that writes TensorBoard events after each group. A continued run writes all events anew.

    Args:
        out: Output folder of the run.
        report: Hook to call first.
    """

    def __init__(self, out: Path, report: ReportWriter) -> None:
        self._out = out
        self._report = report
        self._events: _EventFile | None = None
        self._written: set[tuple[str, int]] = set()

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        """Call the other hook, then write what the run has recorded. Numbers of the newest group follow with the next one."""
        self._report(writer, group)
        if group is not None:
            self._write(writer.manifest, finished=False)

    def finish(self) -> None:
        """Finish the other hook, and write the numbers of the last group."""
        self._report.finish()
        manifest = read_written_manifest(self._out / "reel")
        if manifest is not None:
            self._write(manifest, finished=True)
        if self._events is not None:
            self._events.close()

    def _write(self, manifest: Manifest, finished: bool) -> None:
        """Write the numbers that are new."""
        if self._events is None:
            for old in (self._out / FOLDER).glob("events.out.tfevents.*"):
                old.unlink()
            self._events = _EventFile(self._out / FOLDER)
        scalars = run_scalars(manifest, read_history(self._out / "work"), finished)
        new = [scalar for scalar in scalars if (scalar.tag, scalar.step) not in self._written]
        self._events.add(new)
        self._written.update((scalar.tag, scalar.step) for scalar in new)


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


def check_tensorboard(out: str) -> None:
    """Check that a run can write events.

    Args:
        out: Output folder or address of the run.

    Raises:
        UsageError: The folder is not on this machine.
        MissingDependencyError: tensorboardX is not installed.
    """
    if local_path(out) is None:
        raise UsageError(
            f"--tensorboard writes to OUT/{FOLDER}, but {out} is not a folder of this machine. Leave it out."
        )
    _import_tensorboardx()


class _EventFile:
    """Event file in a folder, which is created. Every event is on the disk when `add` returns.

    tensorboardX's own `SummaryWriter` writes in a thread, and its `flush` does not wait for it.
    """

    def __init__(self, folder: Path) -> None:
        event_file_writer, self._event_pb2, self._summary = _import_tensorboardx()
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = event_file_writer.EventsWriter(str(folder / "events"))

    def add(self, scalars: list[Scalar]) -> None:
        """Write numbers."""
        for scalar in scalars:
            summary = self._summary.scalar(scalar.tag, scalar.value)
            event = self._event_pb2.Event(wall_time=scalar.time, step=scalar.step, summary=summary)
            self._writer.write_event(event)
        self._writer.flush()

    def close(self) -> None:
        """Close the file."""
        self._writer.close()


def _import_tensorboardx() -> tuple[Any, Any, Any]:
    """Return the modules that write event files.

    Raises:
        MissingDependencyError: tensorboardX is not installed.
    """
    try:
        from tensorboardX import event_file_writer, summary  # pyright: ignore[reportMissingImports]
        from tensorboardX.proto import event_pb2  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingDependencyError(
            f"--tensorboard needs tensorboardX, which cannot be imported ({error}). "
            f"Run: {install_command('tensorboard')}"
        ) from error
    return event_file_writer, event_pb2, summary
