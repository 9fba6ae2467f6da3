"""`splatreel publish`, `reconstruct --publish`, and the verbs that read a reel from a bucket."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from splatreel import config
from splatreel.base.errors import StorageError
from splatreel.cli.main import main
from splatreel.codec import publish
from splatreel.codec.inspection import verify_reel
from splatreel.codec.publish import AT_ONCE
from splatreel.storage import address as addresses
from splatreel.storage.address import Address
from splatreel.storage.transport import Bucket as Transport
from splatreel.storage.transport import Disk
from tests.buckets import BreakingLine, Bucket, Faults, web_server
from tests.capture import folders
from tests.golden import GOLDEN, PREDICTIVE
from tests.golden_long import LONG
from tests.method.captures import WallCapture
from tests.method.small import small


def test_reel_is_published_and_read_from_its_bucket(bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    url = bucket.url("reels/golden")
    assert main(["publish", str(PREDICTIVE), url]) == 0
    size = verify_reel(PREDICTIVE).bytes
    said = f"{url}: the whole reel is published, 4 files, {size:,} bytes, of which "
    assert capsys.readouterr().out == f"{said}{size:,} were sent now\n"
    assert main(["publish", str(PREDICTIVE), url]) == 0
    assert capsys.readouterr().out == f"{said}0 were sent now\n"
    assert main(["verify", url]) == 0
    assert capsys.readouterr().out.startswith(f"{url}: complete and undamaged: 2 groups")
    assert main(["info", f"{url}/manifest.json"]) == 0
    assert "14 frames at 30 a second" in capsys.readouterr().out
    for source, name in ((url, "there"), (str(PREDICTIVE), "here")):
        assert main(["export", source, "--frame", "3", "--out", str(tmp_path / f"{name}.ply")]) == 0
    assert (tmp_path / "there.ply").read_bytes() == (tmp_path / "here.ply").read_bytes()
    assert main(["export", url, "--out", str(tmp_path / "page.html")]) == 0


def test_reel_of_a_reconstruction_goes_to_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(GOLDEN, tmp_path / "out" / "reel")
    assert main(["publish", str(tmp_path / "out"), str(tmp_path / "web")]) == 0
    assert verify_reel(tmp_path / "web").groups == 2
    document = (tmp_path / "out" / "reel" / "manifest.json").read_text().replace('"live": false', '"live": true')
    (tmp_path / "out" / "reel" / "manifest.json").write_text(document)
    assert main(["publish", str(tmp_path / "out"), str(tmp_path / "web"), "--keep", "0"]) == 0
    assert "the reel is not finished: run the same command again to send what is added" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["{reel}", "{reel}"], 2, "lies in the reel itself"),
        (["{reel}", "https://example.org/reel"], 2, "web servers take no files"),
        (["{reel}", "{web}", "--keep", "-1"], 2, "--keep -1: give hours"),
        (["{reel}", "{web}", "--keep", "nan"], 2, "--keep nan: give hours"),
        (["{empty}", "{web}"], 1, "is not a reel, it has no manifest.json"),
        (["{reel}", "{reel}/manifest.json"], 2, "lies in the reel itself"),
    ],
)
def test_impossible_publications_are_refused(
    arguments, code, words, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(GOLDEN, tmp_path / "reel")
    names = {name: str(tmp_path / name) for name in ("reel", "web", "empty")}
    assert main(["publish", *(argument.format(**names) for argument in arguments)]) == code
    assert words in capsys.readouterr().err


def test_broken_connection_is_retried(monkeypatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(addresses, "PAUSES", 3 * (0.0,))
    line = BreakingLine(addresses.Disk(tmp_path / "web", StorageError), {0, 3, 4})
    monkeypatch.setattr(addresses, "Disk", lambda path, kind: line if path.name == "web" else Disk(path, kind))
    assert main(["publish", str(GOLDEN), str(tmp_path / "web")]) == 0
    assert capsys.readouterr().err.count("the line is cut). Retrying.") == 3
    assert verify_reel(tmp_path / "web").groups == 2


KILLED = """
import itertools, os, signal, sys
from splatreel.cli.main import main
from splatreel.storage.transport import Bucket as Transport

write, number, last = Transport.write, itertools.count(), int(sys.argv[1])

def write_or_die(*arguments):
    if next(number) == last:
        os.kill(os.getpid(), signal.SIGKILL)
    write(*arguments)

Transport.write = write_or_die
main(sys.argv[2:])
"""
"""The command, killed before it sends the n-th file."""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("count", [7, 26, 29], ids=["group", "page", "manifest"])
def test_killed_command_is_continued_by_the_same(bucket, monkeypatch, count: int) -> None:
    url, command = bucket.url("reel"), ["publish", str(LONG), bucket.url("reel")]
    killed = subprocess.run([sys.executable, "-c", KILLED, str(count), *command], stderr=subprocess.PIPE, check=False)
    assert killed.returncode == -signal.SIGKILL
    there = set(Address(url).sizes())
    assert max(count + 1 - AT_ONCE, 0) <= len(there) <= count
    assert "manifest.json" not in there
    sent, write = set(), Transport.write
    monkeypatch.setattr(Transport, "write", lambda *arguments: (sent.add(arguments[1]), write(*arguments))[1])
    assert main(command) == 0
    assert not sent & there
    assert set(Address(url).sizes()) == sent | there
    assert verify_reel(url).files == verify_reel(LONG).files == 30


@pytest.mark.slow
def test_reconstruction_is_published_while_it_grows_despite_failures(
    bucket, monkeypatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    less = {"group.length": 3, "group.iterations_per_frame": 2, "keyframe.refine_iterations": 5}
    monkeypatch.setattr(config, "preset", lambda quality: small(less))
    monkeypatch.setattr("splatreel.cli.reconstruct.preset", lambda quality: small(less))
    capture, out, url = write_capture(tmp_path / "capture"), tmp_path / "out", bucket.url("live")
    seen = watch_groups(monkeypatch, url)
    command = ["reconstruct", str(capture), "--out", str(out), "--publish"]
    assert main([*command, url]) == 0
    assert seen == [1, 2]  # after each group that group is there, before the next one is made
    assert verify_reel(url).points == verify_reel(out / "reel").points
    assert f"{url}: the whole reel is published" in capsys.readouterr().err
    assert main([*command, "s3://no-such-bucket/reel"]) == 1
    said = capsys.readouterr().err
    assert said.count("Retrying after the next group.") == 1
    assert f"The reel is complete in {out / 'reel'}, but not at s3://no-such-bucket/reel." in said
    assert f"splatreel publish {out / 'reel'} s3://no-such-bucket/reel" in said
    assert verify_reel(out / "reel").groups == 2
    assert main([*command, "nix://a/b"]) == 2
    assert "is not the address of a folder" in capsys.readouterr().err


@pytest.mark.parametrize("fault", [503, "cuts"])
def test_verbs_read_a_reel_though_each_first_request_fails(
    monkeypatch, tmp_path: Path, fault: int | str, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(addresses, "PAUSES", (0.0, 0.0))
    assert main(["export", str(PREDICTIVE), "--frame", "3", "--out", str(tmp_path / "here.ply")]) == 0
    for command in (["info"], ["verify"], ["export", "--frame", "3", "--out", str(tmp_path / "there.ply")]):
        with web_server(PREDICTIVE.parent, fault) as (server, asked):
            assert main([command[0], f"{server}/{PREDICTIVE.name}", *command[1:]]) == 0
            assert asked.count(f"/{PREDICTIVE.name}/manifest.json") > 1
    assert (tmp_path / "there.ply").read_bytes() == (tmp_path / "here.ply").read_bytes()
    capsys.readouterr()
    with web_server(PREDICTIVE.parent, 403, always=True) as (server, asked):
        assert main(["info", f"{server}/{PREDICTIVE.name}"]) == 1
        assert len(asked) == 1
    assert "is private" in capsys.readouterr().err


@pytest.mark.parametrize("fault", ["is_busy", "cuts"])
def test_publication_survives_a_fault_of_each_request(faulty: tuple[Bucket, Faults], fault: str) -> None:
    bucket, faults = faulty
    faults.begin(fault, ("GET", "PUT"))
    assert main(["publish", str(PREDICTIVE), bucket.url("reel")]) == 0
    assert faults.met >= 5
    faults.begin("", (), 0)
    assert verify_reel(bucket.url("reel")).bytes == verify_reel(PREDICTIVE).bytes


def test_private_bucket_is_not_tried_again(faulty: tuple[Bucket, Faults], capsys: pytest.CaptureFixture[str]) -> None:
    bucket, faults = faulty
    faults.begin("is_private", ("GET", "PUT"), 100)
    assert main(["publish", str(PREDICTIVE), bucket.url("reel")]) == 1
    assert "is private" in capsys.readouterr().err
    assert faults.met == 1


def write_capture(folder: Path) -> Path:
    source = WallCapture(5)
    folder.mkdir()
    for camera in source.cameras:
        folders.write_video(folder / f"{camera.name}.mp4", list(source.read(0, 5, [camera.name])[:, 0]))
    np.save(folder / "poses_bounds.npy", folders.llff(source.cameras))
    return folder


def watch_groups(monkeypatch: pytest.MonkeyPatch, url: str) -> list[int]:
    """Count the published groups after each group that was made, and wait for them."""
    import time

    from splatreel.base.errors import ReelError
    from splatreel.codec.reader import ReelReader

    seen: list[int] = []
    changed = publish.BackgroundPublication.changed

    def groups() -> int:
        try:
            return len(ReelReader(url).manifest.groups)
        except ReelError:
            return 0

    def changed_and_there(self) -> None:
        changed(self)
        if len(seen) < 2:
            end = time.monotonic() + 120
            while groups() <= len(seen) and time.monotonic() < end:
                time.sleep(0.02)
            seen.append(groups())

    monkeypatch.setattr(publish.BackgroundPublication, "changed", changed_and_there)
    return seen
