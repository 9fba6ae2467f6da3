import threading
import time

import pytest

from splatreel.base.errors import StorageError
from splatreel.codec.background_publication import LAST_TRIES, BackgroundPublication
from splatreel.codec.publication import Publication
from splatreel.codec.verification import verify_reel
from splatreel.storage.folder import LocalFolder
from tests.buckets import BreakingFolder
from tests.codec.reels import new_group, new_writer, points


class Told:
    """Recorded messages, with a way to wait for them."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.event = threading.Event()

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        self.event.set()


def wait_for(condition) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def write_group(writer, index: int) -> None:
    if index == 0:
        writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(index, 5, 20))


def test_each_group_is_published_in_the_background(tmp_path):
    told, writer = Told(), new_writer(tmp_path / "reel")
    background = BackgroundPublication(Publication(tmp_path / "reel", LocalFolder(tmp_path / "there")), told)
    for index in range(3):
        write_group(writer, index)
        background.changed()
        wait_for(
            lambda n=index + 1: (
                (tmp_path / "there/manifest.json").exists() and verify_reel(tmp_path / "there").groups == n
            )
        )
    writer.finish()
    published = background.finish()
    assert published is not None
    assert (published.live, published.files) == (False, 4)
    assert told.lines == []


def test_unreachable_folder_is_reported_before_the_first_group(tmp_path):
    folder, told = LocalFolder(tmp_path / "there"), Told()

    def refuse(prefix: str = "") -> dict[str, int]:
        raise StorageError("s3://bucket/: cannot be listed (Forbidden).")

    folder.sizes = refuse
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(60.0,))
    assert told.event.wait(120)
    assert told.lines == ["s3://bucket/: cannot be listed (Forbidden). Retrying."]
    background.stop()


def test_failures_are_reported_once_and_do_not_block(tmp_path):
    told, writer = Told(), new_writer(tmp_path / "reel")
    folder = BreakingFolder(LocalFolder(tmp_path / "there"), set(range(100_000)))
    write = folder.write

    def write_elsewhere(*arguments) -> None:
        assert threading.current_thread() is not threading.main_thread(), "it waits for the line"
        write(*arguments)

    folder.write = write_elsewhere  # pyright: ignore[reportAttributeAccessIssue]
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(0.01,))
    for index in range(3):
        write_group(writer, index)
        background.changed()
    wait_for(lambda: folder.writes > 20)
    assert len(told.lines) == 1
    assert told.lines[0].endswith("could not be written (the line is cut). Retrying.")
    folder.breaks = set()
    wait_for(lambda: len(told.lines) == 2)
    assert told.lines[1].endswith("is reachable again; everything so far is published.")
    writer.finish()
    assert background.finish() is not None
    assert verify_reel(tmp_path / "there").groups == 3


def test_finish_gives_up_after_repeated_failures(tmp_path):
    writer = new_writer(tmp_path / "reel")
    write_group(writer, 0)
    writer.finish()
    folder = BreakingFolder(LocalFolder(tmp_path / "there"), set(range(10_000)))
    publication = Publication(tmp_path / "reel", folder)
    background = BackgroundPublication(publication, Told(), pauses=(0.001,))
    with pytest.raises(StorageError, match="the line is cut") as caught:
        background.finish()
    assert background.failure is caught.value
    assert LAST_TRIES <= folder.writes < 10_000  # before the end it tries as often as its thread gets to


def test_finish_continues_while_files_arrive(tmp_path):
    writer = new_writer(tmp_path / "reel")
    for index in range(12):
        write_group(writer, index)
    writer.finish()
    folder = BreakingFolder(LocalFolder(tmp_path / "there"), {n for n in range(1000) if n % 3})
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), Told(), pauses=(0.001,))
    assert background.finish() is not None
    assert verify_reel(tmp_path / "there").groups == 12


def test_stop_works_during_failures(tmp_path):
    writer = new_writer(tmp_path / "reel")
    write_group(writer, 0)
    folder = BreakingFolder(LocalFolder(tmp_path / "there"), set(range(1000)))
    told = Told()
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(60.0,))
    background.changed()
    assert told.event.wait(120)
    background.stop()
    background._thread.join(120)
    assert not background._thread.is_alive()


def test_unexpected_error_is_raised_by_finish(tmp_path):
    publication = Publication(tmp_path, LocalFolder(tmp_path / "there"))
    publication.update = lambda: 1 / 0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ZeroDivisionError):
        BackgroundPublication(publication, Told()).finish()
