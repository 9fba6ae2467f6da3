"""Places that verbs refuse to write to, and what remains of refused and simultaneous commands."""

import inspect
import os
from pathlib import Path

import pytest
from tyro.extras import SubcommandApp

from splatreel.base.atomic import move
from splatreel.cli.main import build, main
from tests.codec.reels import write_reel
from tests.files import contents
from tests.importing.films import frame, write_film

COMMANDS = {
    "demo": "--out {}",
    "capture check": "CAPTURE --page {}",
    "capture board": "{}",
    "capture masks": "CAPTURE --out {}",
    "capture convert": "CAPTURE {}",
    "capture film": "{}",
    "reconstruct": "CAPTURE --out {}",
    "encode": "RUN --out {}",
    "import": "FRAMES --out {}",
    "edit": "REEL scale=2 --out {}",
    "export": "REEL --out {}",
    "evaluate": "REEL CAPTURE --out {}",
}
"""Arguments of every verb that writes a file or folder which its arguments name."""


def arguments(verb: str, out: str) -> list[str]:
    return [*verb.split(), *COMMANDS[verb].format(out).split()]


def verbs(app: SubcommandApp, before: str = "") -> dict[str, set[str]]:
    """Return the names of all parameters by verb."""
    found: dict[str, set[str]] = {}
    for name, command in app._subcommands.items():
        call = command.target
        if isinstance(call, SubcommandApp):
            found |= verbs(call, f"{before}{name} ")
        else:
            found[before + name] = set(inspect.signature(call).parameters)
    return found


def test_the_list_of_commands_has_every_verb_with_an_output() -> None:
    writing = {name for name, parameters in verbs(build()).items() if parameters & {"out", "page", "file"}}
    assert writing == set(COMMANDS)


@pytest.mark.parametrize("verb", COMMANDS)
@pytest.mark.parametrize("address", ["s3://bucket/reel", "https://host/film.mp4"])
def test_addresses_are_refused_by_verbs_that_write_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str, address: str
) -> None:
    """A folder named s3: was written."""
    monkeypatch.chdir(tmp_path)
    assert main(arguments(verb, address)) == 2
    error = capsys.readouterr().err
    assert "is an address" in error or "is not a folder of this machine" in error
    assert address.replace("://", ":/") in error.replace("://", ":/")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_whose_name_ends_with_a_colon_may_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ab:").mkdir()
    assert main(["capture", "board", "ab:/board.svg"]) == 0


@pytest.mark.parametrize(
    "command",
    [
        "edit reel scale=2 --out reel/sub",
        "edit reel scale=2 --out reel",
        "export reel --out reel/frames",
        "export reel --out reel/film.mp4",
        "export reel --out link/page.html",
        "evaluate reel capture --out reel/report",
        "encode run --out run/reel/sub",
        "encode run --out run/work",
        "import frames --out frames",
        "publish reel reel/public",
        "capture convert capture capture/undistorted",
        "capture masks capture --out capture",
    ],
)
def test_verbs_do_not_write_into_what_they_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_reel(tmp_path / "reel")
    os.symlink("reel", "link")
    for name in ("run/reel", "run/work", "capture", "frames"):
        Path(name).mkdir(parents=True)
    before = contents(tmp_path)
    assert main(command.split()) == 2
    assert "this command reads" in (error := capsys.readouterr().err) or "lies in the reel itself" in error
    assert contents(tmp_path) == before
    assert not Path("reel/sub").exists()


@pytest.mark.parametrize("out", ["out", "new/below/out"])
def test_refused_commands_leave_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("frames").mkdir()
    Path("frames/0.ply").write_text("ply\nno more\n")
    write_film(tmp_path / "film", [frame(number) for number in range(2)])
    damaged = next((tmp_path / "film").glob("*.ply"))
    damaged.write_bytes(damaged.read_bytes()[:-40])
    write_reel(tmp_path / "reel")
    group = tmp_path / "reel" / "groups" / "0000.safetensors"
    group.write_bytes(group.read_bytes()[:-40])
    before = sorted(tmp_path.iterdir())
    for command in (
        f"import frames --out {out}",
        f"import film --out {out}",
        f"edit reel scale=2 --out {out}",
        f"export reel --out {out}",
        f"encode frames --out {out}",
    ):
        assert main(command.split()) != 0
        assert sorted(tmp_path.iterdir()) == before, command


@pytest.mark.parametrize("command", ["edit reel scale=2 --out out", "capture film out"])
def test_of_two_same_commands_at_once_both_succeed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """The one that ends last finds the folder of the other. It said that the disk is full."""
    monkeypatch.chdir(tmp_path)
    write_reel(tmp_path / "reel")
    started: list[str] = []

    def move_late(source: Path, target: Path) -> None:
        if not started:
            started.append(command)
            assert main(command.split()) == 0
        move(source, target)

    monkeypatch.setattr("splatreel.base.new_folder.move", move_late)
    assert main(command.split()) == 0
    assert started
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "reel"]
