"""Commands that are stopped and continued, on a clock that goes back, on disks that refuse to move files."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from splatreel.cli.main import main
from splatreel.codec.inspection import verify_reel
from splatreel.codec.publish import HOUR, Publication
from splatreel.storage.address import Address
from tests.codec.reels import write_reel
from tests.files import contents
from tests.importing.films import frame, write_film


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    write_film(tmp_path / "film", [frame(number) for number in range(3)])
    return "film"


@pytest.mark.skipif(os.name != "posix", reason="POSIX signals")
def test_command_that_is_stopped_for_a_while_goes_on(film: str) -> None:
    assert main(["import", film, "--out", "undisturbed"]) == 0
    command = [sys.executable, "-m", "splatreel", "import", film, "--out", "stopped"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(("writing", "comparing")):
            process.send_signal(signal.SIGSTOP)
            assert os.WIFSTOPPED(os.waitpid(process.pid, os.WUNTRACED)[1])
            process.send_signal(signal.SIGCONT)
    assert process.wait(60) == 0
    process.communicate()
    assert contents(Path("stopped")) == contents(Path("undisturbed"))


def test_files_stay_where_the_clock_is_set_back(tmp_path: Path) -> None:
    """A jump of the clock neither shortens the grace period of old files nor extends it forever."""
    reel, there, now = write_reel(tmp_path / "reel"), Address(tmp_path / "there"), [1e9]
    Publication(reel, there, 2 * HOUR, clock=lambda: now[0]).update()
    first = set(there.sizes())
    shutil.rmtree(reel)
    write_reel(reel, groups=1)
    Publication(reel, there, 2 * HOUR, clock=lambda: now[0]).update()
    old = first - {"manifest.json"}
    for hours in (-24 * 365, 1):
        now[0] += hours * HOUR
        Publication(reel, there, 2 * HOUR, clock=lambda: now[0]).update()
        assert old <= set(there.sizes())
        verify_reel(tmp_path / "there")


@pytest.mark.parametrize("number", range(4))
def test_file_that_cannot_be_moved_leaves_nothing_half_made(
    film: str, number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", film, "--out", "undisturbed"]) == 0
    count, move = [0], os.replace

    def refuse(source: object, target: object, **rest: object) -> None:
        count[0] += 1
        if count[0] > number:
            raise OSError(errno.EPERM, "Operation not permitted", str(target))
        move(source, target, **rest)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", refuse)
        assert main(["import", film, "--out", "reel"]) == 1
    error = capsys.readouterr().err
    assert "Error: " in error
    assert "Traceback" not in error
    assert not [path for path in Path("reel").rglob("*") if path.suffix == ".tmp"]
    assert main(["import", film, "--out", "reel"]) == 0
    assert contents(Path("reel")) == contents(Path("undisturbed"))
