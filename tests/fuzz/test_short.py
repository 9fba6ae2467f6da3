"""A few hundred steps of `tests.fuzz.run`, always the same, and everything it ever found."""

import random
from pathlib import Path

import pytest

from tests.fuzz.edits import run
from tests.fuzz.seeds import files
from tests.fuzz.target import check

HOSTILE = sorted((Path(__file__).parent.parent / "data" / "hostile").glob("*.bin"))


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
def test_what_was_found(path: Path) -> None:
    """Each broke a rule of `check` once, which raises where it still does."""
    check(path.stem.split("-")[0], path.read_bytes())
