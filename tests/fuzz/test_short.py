"""Four hundred fixed steps of `tests.fuzz.run`, and the hostile files."""

import random
import tracemalloc
from pathlib import Path

import pytest

from tests.fuzz.edits import run
from tests.fuzz.hostile import FOLDER, LIES, MANIFEST_LIES
from tests.fuzz.seeds import files
from tests.fuzz.target import check

HOSTILE = sorted(FOLDER.glob("*.bin"))


def test_seeds_are_valid_files() -> None:
    assert all(check(name, data) for name, data in files().items())


def test_edited_file_decodes_or_raises_named_error() -> None:
    dice = random.Random(0)
    outcomes = []
    for step in range(400):
        program = bytes([step % len(files())]) + dice.randbytes(dice.randrange(1, 40))
        try:
            outcomes.append(check(*run(program)))
        except Exception as error:
            raise AssertionError(f"program {program.hex()}") from error
    assert {True, False} == set(outcomes)


@pytest.mark.parametrize("path", HOSTILE, ids=lambda path: path.stem)
def test_hostile_file_is_rejected_with_little_memory(path: Path) -> None:
    tracemalloc.start()
    try:
        assert not check(path.stem.split("-")[0], path.read_bytes())
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_hostile_files_exist() -> None:
    assert {path.stem for path in HOSTILE} >= {*LIES, *MANIFEST_LIES}
