"""A few hundred steps of `tests.fuzz.run`, always the same, and the files that lie."""

import random
import tracemalloc
from pathlib import Path

import pytest

from tests.fuzz.edits import run
from tests.fuzz.hostile import FOLDER, LIES, MANIFEST_LIES
from tests.fuzz.seeds import files
from tests.fuzz.target import check

HOSTILE = sorted(FOLDER.glob("*.bin"))


def test_the_seeds_are_files_of_a_reel() -> None:
    assert all(check(name, data) for name, data in files().items())


def test_whatever_is_done_to_a_file_it_decodes_or_an_error_names_it() -> None:
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
def test_hostile_files_are_refused_at_little_cost(path: Path) -> None:
    tracemalloc.start()
    try:
        assert not check(path.stem.split("-")[0], path.read_bytes())
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_the_hostile_files_are_there() -> None:
    assert {path.stem for path in HOSTILE} >= {*LIES, *MANIFEST_LIES}
