"""Output folders that appear when they are complete, and commands that are run again."""

from pathlib import Path

import pytest

from splatreel.base.errors import UsageError
from splatreel.base.new_folder import is_taken, new_folder
from splatreel.base.progress import Silent

REFUSAL = UsageError("out: exists already.")


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {str(file.relative_to(folder)): file.read_text() for file in folder.rglob("*") if file.is_file()}


FILES = {"a": "1", "groups/b": "2"}


@pytest.mark.parametrize("empty", [True, False])
def test_folder_appears_when_it_is_complete(tmp_path: Path, empty: bool) -> None:
    out = tmp_path / "below" / "out"
    if empty:
        out.mkdir(parents=True)
    assert not is_taken(out)
    with new_folder(out, REFUSAL) as made:
        write(made.path, FILES)
        assert not is_taken(out)
        assert made.existing is None
    assert contents(out) == FILES
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_nothing_is_left_of_a_failure(tmp_path: Path) -> None:
    def fail() -> None:
        with new_folder(tmp_path / "out", REFUSAL) as made:
            write(made.path, FILES)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("others", [{}, {".DS_Store": "x"}, {"notes.txt": "mine"}, {f".a.{'0' * 16}.tmp": "half"}])
def test_the_same_output_succeeds_and_stays(tmp_path: Path, others: dict[str, str]) -> None:
    out = tmp_path / "out"
    write(out, FILES | others)
    before = {file: file.stat().st_mtime_ns for file in out.rglob("*")}
    assert is_taken(out)
    with new_folder(out, REFUSAL) as made:
        write(made.path, FILES)
        assert made.existing == out
    assert contents(out) == FILES | others
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*")} == before
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("there", [{"a": "1"}, {"a": "1", "groups/b": "3"}, {"a": "1", "groups/b/c": ""}, {"x": ""}])
def test_another_output_is_refused_and_stays(tmp_path: Path, there: dict[str, str]) -> None:
    out = tmp_path / "out"
    write(out, there)
    with pytest.raises(UsageError, match="exists already"), new_folder(out, REFUSAL) as made:
        write(made.path, FILES)
    assert contents(out) == there
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("kind", ["file", "link to nothing"])
def test_names_that_are_no_folder_are_refused_at_once(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    out.symlink_to(tmp_path / "nothing") if kind == "link to nothing" else out.write_text("mine")
    assert is_taken(out)
    with pytest.raises(UsageError, match="exists already"), new_folder(out, REFUSAL):
        pytest.fail("nothing is written")
    assert out.is_symlink() or out.read_text() == "mine"


def test_difference_stops_at_the_first_file(tmp_path: Path) -> None:
    write(tmp_path / "out", {"groups/0": "1", "groups/1": "old", "manifest": "2"})
    steps = []

    def run() -> None:
        with new_folder(tmp_path / "out", REFUSAL) as made:
            progress = made.checked(Silent(), "groups")
            for number, text in enumerate(["1", "2", "3"]):
                write(made.path, {f"groups/{number}": text, "manifest": str(number)})
                progress.update(number)
                steps.append(number)

    with pytest.raises(UsageError, match="exists already"):
        run()
    assert steps == [0]
