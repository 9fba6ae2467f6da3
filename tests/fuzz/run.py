"""Fuzz the Python reader, guided by coverage, until stopped: python -m tests.fuzz.run FOLDER [options of libFuzzer].

Needs atheris (pip install atheris). FOLDER keeps what reaches new code; an input that breaks the rules of `target` is written as
FOLDER/crash-*, timeout-* or oom-*, and `python -m tests.fuzz.run FOLDER/crash-...` repeats it. Into tests/data/hostile goes the
edited file, which `--keep NAME` writes there.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["splatreel.codec"]):
    from tests.fuzz.edits import run
    from tests.fuzz.hostile import FOLDER
    from tests.fuzz.seeds import files
    from tests.fuzz.target import check


def keep(program: Path, name: str) -> None:
    """Write the edited file of a program where the tests find it."""
    seed, data = run(program.read_bytes())
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{seed.split('-')[0]}-{name}.bin").write_bytes(data)


def main() -> None:
    folder = Path(sys.argv[1])
    if sys.argv[2:3] == ["--keep"]:
        return keep(folder, sys.argv[3])
    if not folder.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        for index in range(len(files())):
            (folder / f"seed-{index}").write_bytes(bytes([index]))
    limits = [
        "-timeout=60",
        "-rss_limit_mb=3000",
        "-max_len=200",
        "-len_control=20",
        f"-artifact_prefix={folder}{os.sep}",
    ]
    atheris.Setup([sys.argv[0], str(folder), *limits, *sys.argv[2:]], lambda data: check(*run(data)))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
