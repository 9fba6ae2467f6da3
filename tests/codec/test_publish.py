"""Publication of a reel to disk, memory and a bucket, with connection errors and changing reels."""

import json
import shutil
import subprocess
import sys
import threading
import time

import pytest

from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.publish import (
    HOUR,
    RECORD,
    BackgroundPublication,
    Publication,
    file_entries,
    is_published_name,
    published_name,
    transfer_in_threads,
)
from splatreel.codec.reader import ReelReader
from splatreel.storage.address import Address
from tests.buckets import BreakingLine, breaking
from tests.codec.reels import add_chapter_group, new_group, new_writer, points, write_chapters, write_reel
from tests.flashes import GOLDEN as WITH_SOUND
from tests.golden import GOLDEN
from tests.storage.folders import KINDS, new_address


class Clock:
    def __init__(self) -> None:
        self.now = 1e9

    def __call__(self) -> float:
        return self.now


@pytest.fixture(params=KINDS)
def address(request):
    return new_address(request.param, request)


@pytest.fixture
def reel(tmp_path):
    return write_reel(tmp_path / "reel")


def named(data: bytes) -> set[str]:
    """Return the files that a manifest names."""
    return {entry["uri"] for entry in file_entries(json.loads(data))}


def copy_of(folder) -> set[str]:
    return set(folder.sizes()) - {"manifest.json", RECORD}


def test_publication_names_files_by_content(address, reel):
    published = Publication(reel, Address(address)).update()
    here, there = verify_reel(reel), verify_reel(address)
    assert (there.files, there.bytes, there.points) == (here.files, here.bytes, here.points)
    assert published is not None
    assert (published.files, published.bytes, published.sent, published.live) == (4, here.bytes, 4, False)
    reader = ReelReader(address)
    for before, after in zip(ReelReader(reel).manifest.files, reader.manifest.files, strict=True):
        assert after.uri == published_name(before.uri, before.sha256)
        assert (after.bytes, after.sha256, after.group) == (before.bytes, before.sha256, before.group)
    assert len(reader.group(1).dynamic) == 15


def test_publication_includes_images_and_sound(tmp_path):
    Publication(WITH_SOUND, Address(tmp_path / "there")).update()
    assert verify_reel(tmp_path / "there").strangers == []
    assert ReelReader(tmp_path / "there").manifest.presentation.sound is not None


def test_published_pages_use_published_names(address, tmp_path):
    reel = write_chapters(tmp_path / "reel")
    publication = Publication(reel, Address(address))
    published = publication.update()
    here, there = verify_reel(reel), verify_reel(address)
    assert published is not None
    assert (there.files, there.groups, there.points) == (here.files, here.groups, here.points)
    manifest = ReelReader(address).manifest
    assert len(manifest.pages) > 1
    assert all(map(is_published_name, manifest.uris))
    assert copy_of(Address(address)) == manifest.uris
    assert published.bytes == sum(size for name, size in Address(address).sizes().items() if name in manifest.uris)


def test_pages_are_sent_once_and_dropped_files_removed(tmp_path):
    clock, (folder, line) = Clock(), breaking(tmp_path / "there")
    writer = new_writer(tmp_path / "reel", page=2)
    publication, pages_read = Publication(tmp_path / "reel", folder, keep=10, clock=clock), []
    intact = publication._read_intact
    publication._read_intact = lambda file: (
        pages_read.append(file.uri) if "pages/" in file.uri else None,
        intact(file),
    )[1]
    for index in range(10):
        add_chapter_group(writer, index, 4)
        publication.update()
        clock.now += 1
    sent = [name for name in line.log if name.startswith("pages/")]
    assert len(sent) == len(set(sent)) == len(pages_read) == len(set(pages_read)) > 1
    writer.drop_before(5)
    publication.update()
    first = verify_reel(tmp_path / "there")
    clock.now += 10
    publication.update()
    assert verify_reel(tmp_path / "there").points == first.points
    assert copy_of(folder) == ReelReader(tmp_path / "there").manifest.uris
    assert len(list((tmp_path / "there" / "groups").iterdir())) == first.groups < 10


def test_nothing_is_sent_twice(address, reel):
    folder, line = breaking(address)
    Publication(reel, folder).update()
    sent = line.writes
    again = Publication(reel, folder).update()
    assert again is not None
    assert (line.writes, again.sent, again.sent_bytes) == (sent, 0, 0)


def test_publication_of_a_publication_is_identical(tmp_path, reel):
    Publication(reel, Address(tmp_path / "one")).update()
    Publication(tmp_path / "one", Address(tmp_path / "two")).update()
    assert Address(tmp_path / "one").sizes() == Address(tmp_path / "two").sizes()
    assert (tmp_path / "one" / "manifest.json").read_bytes() == (tmp_path / "two" / "manifest.json").read_bytes()


@pytest.mark.parametrize("arrives", [False, True], ids=["lost", "arrived without an answer"])
@pytest.mark.parametrize("cut", range(5))
def test_interrupted_publication_is_valid_and_resumes(request, reel, cut, arrives):
    address = new_address("bucket" if cut % 2 else "memory", request)
    folder, line = breaking(address, {cut}, halves=arrives)
    publication = Publication(reel, folder)
    with pytest.raises(StorageError, match="the line is cut"):
        publication.update()
    if "manifest.json" in folder.sizes():
        verify_reel(address)
    else:
        with pytest.raises(ReelError, match=r"manifest\.json"):
            ReelReader(address)
    arrived = copy_of(folder)
    line.log.clear()
    again = Publication(reel, folder).update() if cut < 3 else publication.update()  # by a new process, or the same
    assert again is not None
    assert not arrived & set(line.log)
    assert again.sent == 4 - len(arrived)
    verify_reel(address)


def test_every_published_manifest_finds_its_files(tmp_path):
    """After each write and deletion, all files of every manifest of the last hour exist."""
    clock, reel = Clock(), tmp_path / "reel"
    there, manifests = Address(tmp_path / "there"), []

    class Watched(BreakingLine):
        def write(self, name, data, headers):
            super().write(name, data, headers)
            if name == "manifest.json":
                manifests.append((clock.now, named(data)))
            self.check()

        def remove(self, name):
            super().remove(name)
            self.check()

        def check(self):
            latest = manifests[-1:]
            for left, names in [*manifests, *latest]:
                superseded = min((when for when, _ in manifests if when > left), default=clock.now)
                if clock.now - superseded < HOUR:
                    assert names <= set(there.sizes())

    watched = Address(tmp_path / "there")
    watched._transport = Watched(there._transport, set())
    publication = Publication(reel, watched, keep=HOUR, clock=clock)
    for groups in (1, 2, 3, 2, 1):  # it grows, and is then made anew, shorter
        write_reel(reel, groups)
        edited = json.loads((reel / "manifest.json").read_text()) | {"title": f"{groups} groups at {clock.now}"}
        (reel / "manifest.json").write_text(json.dumps(edited))
        publication.update()
        clock.now += 0.4 * HOUR
    assert len(manifests) == 5
    clock.now += 2 * HOUR
    publication.update()
    assert copy_of(there) == manifests[-1][1]


def test_new_encoding_keeps_files_of_the_old_one(tmp_path):
    clock, folder = Clock(), Address(tmp_path / "there")
    Publication(write_reel(tmp_path / "reel"), folder, clock=clock).update()
    watcher = ReelReader(tmp_path / "there")
    shutil.rmtree(tmp_path / "reel")
    writer = new_writer(tmp_path / "reel")
    writer.add_layer(0, 0, points(12, seed=9))
    writer.add_group(new_group(0, 7, 12))
    writer.finish()
    Publication(tmp_path / "reel", folder, clock=clock).update()
    assert len(watcher.group(1).dynamic) == 15
    assert len(ReelReader(tmp_path / "there").group(0).dynamic) == 7


def test_grace_period_spans_several_runs(address, reel, tmp_path):
    clock, folder = Clock(), Address(address)
    Publication(reel, folder, keep=10, clock=clock).update()
    old = copy_of(folder)
    shutil.rmtree(reel)
    shutil.copytree(GOLDEN, reel)
    for seconds, removed in ((0, 0), (6, 0), (3, 0), (1, len(old)), (1, 0)):
        clock.now += seconds
        published = Publication(reel, folder, keep=10, clock=clock).update()
        assert published is not None
        assert published.removed == removed
    assert not old & copy_of(folder)
    assert json.loads(folder.read(RECORD, 10_000) or b"")["left"] == {}
    verify_reel(address)


def test_lost_record_extends_the_grace_period(tmp_path, reel):
    clock, folder = Clock(), Address(tmp_path / "there")
    Publication(reel, folder, keep=10, clock=clock).update()
    write_reel(reel, 1)
    Publication(reel, folder, keep=10, clock=clock).update()
    for damage in (b"no JSON", b'{"left": 3}', b'{"left": {"groups/0001.safetensors": "x"}}'):
        folder.write(RECORD, damage)
        clock.now += 9
        published = Publication(reel, folder, keep=10, clock=clock).update()
        assert published is not None
        assert published.removed == 0


@pytest.mark.parametrize("left", ["1e999", '"inf"', '"-inf"', '"nan"'])
def test_record_without_times_extends_the_grace_period(tmp_path, reel, left):
    clock, folder = Clock(), Address(tmp_path / "there")
    Publication(reel, folder, keep=10, clock=clock).update()
    old = copy_of(folder)
    write_reel(reel, 1)
    folder.write(RECORD, f'{{"left": {{{", ".join(f"{json.dumps(name)}: {left}" for name in sorted(old))}}}}}'.encode())
    removed = []
    for seconds in (0, 9, 1):
        clock.now += seconds
        published = Publication(reel, folder, keep=10, clock=clock).update()
        assert published is not None
        removed.append(published.removed)
    assert removed[:2] == [0, 0]
    assert removed[2] > 0


def test_clock_that_is_set_back_restarts_the_grace_period(tmp_path, reel):
    clock, folder = Clock(), Address(tmp_path / "there")
    Publication(reel, folder, keep=10, clock=clock).update()
    write_reel(reel, 1)
    Publication(reel, folder, keep=10, clock=clock).update()
    removed = []
    for seconds in (-1000, 9, 1):
        clock.now += seconds
        published = Publication(reel, folder, keep=10, clock=clock).update()
        assert published is not None
        removed.append(published.removed)
    assert removed[:2] == [0, 0]
    assert removed[2] > 0


@pytest.mark.parametrize("jump", [-1e9, 1e9])
def test_clock_that_is_set_while_a_reel_is_published_deletes_nothing(tmp_path, reel, jump, monkeypatch):
    folder = Address(tmp_path / "there")
    publication, now = Publication(reel, folder), time.time()
    publication.update()
    old = copy_of(folder)
    write_reel(reel, 1)
    publication.update()
    monkeypatch.setattr(time, "time", lambda: now + jump)
    for _ in range(2):
        published = publication.update()
        assert published is not None
        assert published.removed == 0
    assert old <= copy_of(folder)


def test_foreign_files_are_never_deleted(tmp_path, reel):
    clock, folder = Clock(), Address(tmp_path / "there")
    others = {"index.html", "assets/app-0123456789abcdef.js", "other/layers/0000-0123456789abcdef.safetensors"}
    others |= {"groups/notes.txt", "groups/0000.safetensors", "photo-0123456789abcdef.jpg"}
    for name in others:
        folder.write(name, b"mine")
    folder.write("groups/0009-0123456789abcdef.safetensors", b"of a publication that was cut off")
    Publication(reel, folder, keep=1, clock=clock).update()
    clock.now += 2
    published = Publication(reel, folder, keep=1, clock=clock).update()
    assert published is not None
    assert published.removed == 1
    assert others <= set(folder.sizes())


def test_reel_changed_during_publication_is_resent(tmp_path, reel):
    publication = Publication(reel, Address(tmp_path / "there"))
    check, others = publication._checked, [GOLDEN, WITH_SOUND]

    def check_and_change(data):
        document = check(data)
        if others:
            shutil.rmtree(reel)
            shutil.copytree(others.pop(), reel)
        return document

    publication._checked = check_and_change
    publication.update()
    assert others == []
    assert verify_reel(tmp_path / "there").points == verify_reel(GOLDEN).points


def test_reel_that_keeps_changing_is_given_up(tmp_path, reel):
    publication = Publication(reel, Address(tmp_path / "there"))
    check, groups = publication._checked, iter(range(10))

    def check_and_change(data):
        document = check(data)
        shutil.rmtree(reel)
        write_reel(reel, 1 + next(groups) % 2)
        (reel / "groups" / "0000.safetensors").write_bytes(b"of another run")
        return document

    publication._checked = check_and_change
    with pytest.raises(StorageError, match="changes faster than it can be sent"):
        publication.update()
    assert not (tmp_path / "there" / "manifest.json").exists()


def test_damaged_reel_is_not_published(tmp_path, reel):
    (reel / "groups" / "0001.safetensors").write_bytes(b"damaged")
    with pytest.raises(ReelError, match=r"groups/0001\.safetensors: does not match the manifest"):
        Publication(reel, Address(tmp_path / "there")).update()
    assert not (tmp_path / "there" / "manifest.json").exists()


def test_missing_reel_returns_none(tmp_path):
    assert Publication(tmp_path, Address(tmp_path / "there")).update() is None


def test_bucket_has_right_names_and_headers(bucket, reel):
    Publication(reel, Address(bucket.url("reel"))).update()
    found = {name: bucket.headers(f"reel/{name}") for name in Address(bucket.url("reel")).sizes()}
    assert found["manifest.json"]["content-type"] == "application/json"
    assert found["manifest.json"]["cache-control"] == "no-cache"
    lasting = [headers for name, headers in found.items() if is_published_name(name)]
    assert len(lasting) == 4
    assert {headers["cache-control"] for headers in lasting} == {"public, max-age=31536000, immutable"}
    assert {headers["content-type"] for headers in lasting} == {"application/octet-stream"}


def test_published_names_known_answers():
    digest = "0123456789abcdef" * 4
    name = "groups/0003.low-0123456789abcdef.safetensors"
    assert published_name("groups/0003.low.safetensors", digest) == name
    assert published_name(name, digest) == name
    assert is_published_name(name)
    assert is_published_name(published_name("poster.jpg", digest))
    assert not is_published_name("groups/0003.low.safetensors")
    assert not is_published_name(f"nested/{name}")


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
    background = BackgroundPublication(Publication(tmp_path / "reel", Address(tmp_path / "there")), told)
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
    folder, told = Address(tmp_path / "there"), Told()

    def refuse(prefix: str) -> dict[str, int]:
        raise PermissionError("Forbidden")

    folder._transport.sizes = refuse
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(60.0,))
    assert told.event.wait(120)
    assert told.lines == [
        f"{tmp_path}/there: cannot be listed (Forbidden). Change its permissions. Retrying after the next group."
    ]
    background.stop()


def test_failures_are_reported_once_and_do_not_block(tmp_path):
    told, writer = Told(), new_writer(tmp_path / "reel")
    folder, line = breaking(tmp_path / "there", set(range(100_000)))
    write = line.write

    def write_elsewhere(*arguments) -> None:
        assert threading.current_thread() is not threading.main_thread(), "it waits for the line"
        write(*arguments)

    line.write = write_elsewhere  # pyright: ignore[reportAttributeAccessIssue]
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(0.01,))
    for index in range(3):
        write_group(writer, index)
        background.changed()
    wait_for(lambda: line.writes > 20)
    assert len(told.lines) == 1
    assert told.lines[0].endswith("bytes) (the line is cut). Retrying.")
    line.breaks = set()
    wait_for(lambda: len(told.lines) == 2)
    assert told.lines[1].endswith("is reachable again; everything so far is published.")
    writer.finish()
    assert background.finish() is not None
    assert verify_reel(tmp_path / "there").groups == 3


def test_refused_access_is_tried_again_after_the_next_group(tmp_path):
    told, writer = Told(), new_writer(tmp_path / "reel")
    folder = Address(tmp_path / "there")
    sizes = folder._transport.sizes

    def refuse(prefix: str) -> dict[str, int]:
        raise PermissionError("Forbidden")

    folder._transport.sizes = refuse
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told)
    assert told.event.wait(120)
    folder._transport.sizes = sizes
    write_group(writer, 0)
    background.changed()
    wait_for(lambda: len(told.lines) == 2)
    assert told.lines[1] == f"{tmp_path}/there: is reachable again; everything so far is published."
    assert verify_reel(tmp_path / "there").groups == 1
    background.stop()


def test_finish_gives_up_after_repeated_failures(tmp_path):
    writer = new_writer(tmp_path / "reel")
    write_group(writer, 0)
    writer.finish()
    folder, line = breaking(tmp_path / "there", set(range(10_000)))
    publication = Publication(tmp_path / "reel", folder)
    background = BackgroundPublication(publication, Told(), pauses=6 * (0.001,))
    with pytest.raises(StorageError, match="the line is cut") as caught:
        background.finish()
    assert background.failure is caught.value
    assert 6 < line.writes < 10_000  # before the end it tries as often as its thread gets to


def test_finish_continues_while_files_arrive(tmp_path):
    writer = new_writer(tmp_path / "reel")
    for index in range(12):
        write_group(writer, index)
    writer.finish()
    folder, _ = breaking(tmp_path / "there", {n for n in range(1000) if n % 3})
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), Told(), pauses=9 * (0.001,))
    assert background.finish() is not None
    assert verify_reel(tmp_path / "there").groups == 12


def test_stop_works_during_failures(tmp_path):
    writer = new_writer(tmp_path / "reel")
    write_group(writer, 0)
    folder, _ = breaking(tmp_path / "there", set(range(1000)))
    told = Told()
    background = BackgroundPublication(Publication(tmp_path / "reel", folder), told, pauses=(60.0,))
    background.changed()
    assert told.event.wait(120)
    background.stop()
    background._thread.join(120)
    assert not background._thread.is_alive()


def test_unexpected_error_is_raised_by_finish(tmp_path):
    publication = Publication(tmp_path, Address(tmp_path / "there"))
    publication.update = lambda: 1 / 0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ZeroDivisionError):
        BackgroundPublication(publication, Told()).finish()


def test_each_item_is_transferred_once_in_parallel():
    together, seen, most = threading.Barrier(3), [], 0
    working = set()

    def work(item):
        nonlocal most
        working.add(item)
        most = max(most, len(working))
        if item < 3:
            together.wait(120)  # three of them come together, or it breaks
        working.discard(item)
        seen.append(item)

    assert sorted(transfer_in_threads(work, range(20), 3)) == list(range(20))
    assert sorted(seen) == list(range(20))
    assert most == 3


def test_error_stops_new_transfers_and_waits_for_running_ones():
    begun, ended, first = [], [], threading.Event()

    def work(item):
        begun.append(item)
        if item == 0:
            first.wait(120)
            raise ValueError("cut")
        first.set()
        time.sleep(1)  # meanwhile the other thread fails
        ended.append(item)

    with pytest.raises(ValueError, match="cut"):
        list(transfer_in_threads(work, range(50), 2))
    assert begun == [0, 1]
    assert ended == [1]


def test_no_items_need_no_threads():
    assert list(transfer_in_threads(print, [], 4)) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_interrupt_does_not_wait_for_a_hanging_transfer():
    code = "import signal, sys, threading\nfrom splatreel.codec.publish import transfer_in_threads\n"
    code += "signal.signal(signal.SIGALRM, signal.default_int_handler); signal.setitimer(signal.ITIMER_REAL, 0.2)\n"
    code += "try: list(transfer_in_threads(lambda _: threading.Event().wait(), range(9), 2))\n"
    code += "except KeyboardInterrupt: sys.exit(130)"
    assert subprocess.run([sys.executable, "-c", code], timeout=300, check=False).returncode == 130
