"""Append one measurement to benchmarks/results.jsonl, labelled with what it was measured on."""

import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from splatreel.run.machine_speed import processor_name

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results.jsonl"


def record(benchmark: str, values: dict, note: str = "", results: Path = RESULTS) -> dict:
    """Append {benchmark, revision, date, machine, note, **values} as one line, and return it.

    A record in the project's own file also goes into the tables of the documents, which a test compares with that file.
    """
    line = {
        "benchmark": benchmark,
        "revision": revision(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "machine": machine(),
        "note": note,
        **values,
    }
    with results.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line, allow_nan=False) + "\n")
    if results == RESULTS:
        import table  # which reads this module

        table.write(table.latest(results))
    return line


def revision() -> str:
    """Return the short hash of the commit, with + if tracked files differ from it; `unknown` outside of a checkout."""
    return _git_name("HEAD")


def source() -> str:
    """Return git's name of src, with + if files differ from it; `unknown` outside of a checkout.

    Unlike the commit, it stays the same when results are committed.
    """
    return _git_name("HEAD:src")


def _git_name(what: str) -> str:
    named = subprocess.run(["git", "rev-parse", "--short", what], cwd=ROOT, capture_output=True, text=True)
    if named.returncode != 0:
        return "unknown"
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "src"], cwd=ROOT, capture_output=True)
    return named.stdout.strip() + ("+" if changed.returncode else "")


def machine() -> str:
    """Return such as `2 cores of AMD EPYC 7763 64-Core Processor, Linux, load 0.4`.

    Times are not reliable if the load is near or above the number of cores.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{cores} cores of {processor_name()}, {platform.system()}{load}"


def summary(report: dict) -> dict:
    """Return a report.json without its long lists."""
    return {name: value for name, value in report.items() if name not in ("cameras", "per_frame")}
