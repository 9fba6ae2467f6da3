"""Reconstruct a capture, evaluate the decoded reel and record the result. Benchmarks of whole captures share this."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

from record import machine, record, summary
from splatreel.base.display import console
from splatreel.base.process import keep_freed_memory
from splatreel.capture.base import Capture
from splatreel.codec.inspection import reel_info
from splatreel.config import Config
from splatreel.evaluation.evaluate import evaluate, uncompressed_frames
from splatreel.run.pipeline import reconstruct


def run(
    benchmark: str,
    capture: Capture,
    out: Path,
    config: Config,
    cameras: Sequence[str] | None,
    note: str,
    filming: float | None = None,
) -> dict:
    """Return a line of results.jsonl: the report, the share of the float32 model, and the wall time of this run.

    filming: seconds it took to make the capture, where that is part of it. seconds_total counts every stage once, also those that an
    interrupted earlier run had finished.
    """
    keep_freed_memory()  # as the command line does
    before = machine()
    started = time.monotonic() - (filming or 0.0)
    progress = console()
    try:
        result = reconstruct(capture, out, config, progress=progress)
        seconds = result.seconds if filming is None else {"capture": round(filming, 3), **result.seconds}
        report = evaluate(
            result.reel,
            capture,
            cameras=cameras,
            out=out,
            undecoded=uncompressed_frames(result.work, result.reel),
            seconds=seconds,
            device=result.device,
            progress=progress,
        )
    finally:
        progress.close()
    values = summary(dataclasses.asdict(report))
    values["seed"] = config.seed
    values["seconds_total"] = round(sum(seconds.values()), 1)
    values["seconds_wall"] = round(time.monotonic() - started, 1)
    values["share_of_float32"] = round(report.reel_bytes / reel_info(result.reel).float32_bytes, 4)
    values["machine_before"] = before
    line = record(benchmark, values, note)
    print(report.to_markdown())
    return line
