"""Coverage-guided fuzzing of the Python reader until stopped: python -m tests.fuzz.run FOLDER [options of libFuzzer].

It needs atheris (pip install atheris). FOLDER keeps inputs that reach new code. An input that breaks the rules of `target` is written
to FOLDER/crash-*, timeout-* or oom-*. `python -m tests.fuzz.run FOLDER/crash-...` repeats it, and with `--keep NAME` writes the edited
file to tests/data/hostile. Numba code is checked for out-of-bounds access, but coverage comes from the Python code around it.
Interpreting numba code with coverage would take a hundred times as long.
"""

from __future__ import annotations

import os
import pkgutil
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from types import FunctionType

os.environ["NUMBA_BOUNDSCHECK"] = "1"
os.environ["NUMBA_CACHE_DIR"] = str(Path(tempfile.gettempdir()) / "splatreel-fuzz-numba")

import atheris

from splatreel import codec
from tests.fuzz.edits import run
from tests.fuzz.hostile import FOLDER
from tests.fuzz.seeds import files
from tests.fuzz.target import check


def instrument() -> None:
    """Instrument all functions and methods of the codec for coverage, except functions that numba compiles."""
    for entry in pkgutil.iter_modules(codec.__path__, f"{codec.__name__}."):
        module = import_module(entry.name)
        classes = [value for value in vars(module).values() if isinstance(value, type)]
        for owner in (module, *classes):
            if owner.__dict__.get("__module__", entry.name) != entry.name:
                continue
            for value in vars(owner).values():
                found = getattr(value, "__wrapped__", getattr(value, "__func__", getattr(value, "fget", value)))
                if isinstance(found, FunctionType) and found.__module__ == entry.name:
                    atheris.instrument_func(found)  # pyright: ignore[reportAttributeAccessIssue]


def keep(program: Path, name: str) -> None:
    """Write the edited file of a program to the folder of hostile files."""
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
    for name, data in files().items():
        check(name, data)
    instrument()
    limits = [
        "-timeout=60",
        "-rss_limit_mb=800",
        "-max_len=200",
        "-len_control=20",
        f"-artifact_prefix={folder}{os.sep}",
    ]
    atheris.Setup([sys.argv[0], str(folder), *limits, *sys.argv[2:]], lambda data: check(*run(data)))  # pyright: ignore[reportArgumentType]
    atheris.Fuzz()


if __name__ == "__main__":
    main()
