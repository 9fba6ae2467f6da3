"""Nodes list shared files once per group, and only the files that they need."""

import hashlib
from pathlib import Path

import pytest

from splatreel.base.errors import StorageError
from splatreel.run.machines import exchange
from splatreel.run.machines.exchange import Exchange, SharedFolder
from splatreel.run.store import LAST_OF_GROUP, REEL_FILES_OF_GROUP
from splatreel.scene.group import ChapterSpan, GroupSpan
from splatreel.storage.address import Address
from tests.buckets import Bucket, Faults, breaking
from tests.storage.folders import KINDS, new_address

GROUPS = 12


def made(out: Path, group: int) -> None:
    """The files of a group, as a chapter leaves them."""
    folder = out / "work" / f"group{group:04d}"
    folder.mkdir(parents=True, exist_ok=True)
    for name in (*REEL_FILES_OF_GROUP, "keyframe.safetensors"):
        (folder / name).write_text(f"{name} of {group}")
    (out / "work" / "seconds-chapter0000.json").write_text(f"[{group}]")


def test_each_group_is_listed_once_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    sizes = Address.sizes
    monkeypatch.setattr(Address, "sizes", lambda self, prefix="": asked.append(prefix) or sizes(self, prefix))
    exchange = Exchange(str(tmp_path / "shared"), tmp_path / "node")
    for group in range(GROUPS):
        made(tmp_path / "node", group)
        exchange.send_group(0, group)
    assert asked == ["group0000/", "seconds-chapter0000.json@", *(f"group{g:04d}/" for g in range(1, GROUPS))]
    asked.clear()
    driver = Exchange(str(tmp_path / "shared"), tmp_path / "driver")
    driver.fetch_finished()
    assert asked == ["group"]
    assert sorted(path.name for path in (tmp_path / "driver" / "work" / "group0007").iterdir()) == sorted(
        REEL_FILES_OF_GROUP
    )
    asked.clear()
    (tmp_path / "driver" / "work" / "group0003" / LAST_OF_GROUP).unlink()
    driver.fetch_finished([3])
    assert asked == ["group0003/"]
    assert (tmp_path / "driver" / "work" / "group0003" / LAST_OF_GROUP).read_text() == f"{LAST_OF_GROUP} of 3"


def test_bucket_lists_by_prefix(tmp_path: Path, bucket: Bucket) -> None:
    exchange = Exchange(bucket.url("run"), tmp_path / "node")
    for group in range(3):
        made(tmp_path / "node", group)
        exchange.send_group(0, group)
    assert len(bucket.keys("run/work/seconds-")) == 1
    other = Exchange(bucket.url("run"), tmp_path / "other")
    other.fetch_chapter(ChapterSpan(0, (GroupSpan(1, 0, 1, 1),), None))
    assert {path.name for path in (tmp_path / "other" / "work").iterdir()} == {"group0001"}
    made(tmp_path / "other", 2)
    other.send_group(0, 2)  # a task that is made again by another node
    assert len(bucket.keys("run/work/seconds-")) == 1


@pytest.fixture(params=KINDS)
def address(request: pytest.FixtureRequest) -> str:
    """Return the address of a new folder for each kind of storage."""
    return new_address(request.param, request)


def write(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def read(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_pull_fetches_pushed_files_once(address, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    files = {"run.json": "{}", "group0000/keyframe": "points", "group0001/keyframe": "others", "empty": ""}
    write(one, files)
    assert SharedFolder(Address(address)).push(one, files) == list(files)
    assert SharedFolder(Address(address)).push(one, files) == []
    shared = SharedFolder(Address(address))
    assert shared.pull(["run.json", "empty"], two) == ["empty", "run.json"]
    assert shared.pull_all("group0000/", two) == ["group0000/keyframe"]
    assert shared.pull_all("", two) == ["group0001/keyframe"]
    assert shared.pull_all("", two) == []
    assert read(two) == files
    assert shared.files()["run.json"].sha256 == hashlib.sha256(b"{}").hexdigest()


def test_push_sends_only_changes_and_removes_old_versions(address, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    write(one, {"seconds.json": "[1]", "layout.json": "{}"})
    shared = SharedFolder(Address(address))
    shared.push(one, ["seconds.json", "layout.json"])
    shared.pull_all("", two)
    write(one, {"seconds.json": "[2]"})
    assert shared.push(one, ["seconds.json", "layout.json"]) == ["seconds.json"]
    assert shared.files()["seconds.json"].version == 1
    assert len(Address(address).sizes()) == 2
    assert shared.pull_all("", two) == ["seconds.json"]
    write(one, {"seconds.json": "[1]"})
    assert shared.push(one, ["seconds.json"]) == ["seconds.json"]
    assert shared.pull(["seconds.json"], two) == ["seconds.json"]
    assert read(two) == {"seconds.json": "[1]", "layout.json": "{}"}


def test_push_retries_and_keeps_old_versions_until_done(tmp_path):
    told = []
    write(tmp_path / "one", {"a": "old", "b": "b"})
    shared = SharedFolder(Address(tmp_path / "shared", report=told.append, pauses=(0.0,)))
    shared.push(tmp_path / "one", ["a", "b"])
    _, line = breaking(shared._address, {0, 2, 3})
    write(tmp_path / "one", {"a": "new", "b": "B"})
    with pytest.raises(StorageError, match="the line is cut"):
        shared.push(tmp_path / "one", ["a", "b"])
    assert len(told) == 2
    assert [entry[:3] for entry in line.log] == ["a@0", "-a@"]
    SharedFolder(Address(tmp_path / "shared")).pull_all("", tmp_path / "two")
    assert read(tmp_path / "two") == {"a": "new", "b": "b"}
    assert shared.push(tmp_path / "one", ["a", "b"]) == ["b"]


def test_pull_keeps_the_order_of_names(tmp_path):
    """A file that marks the others as complete can therefore be named last."""
    write(tmp_path / "one", {"a-done": "1", "b": "2", "c": "3"})
    shared = SharedFolder(Address(tmp_path / "shared"))
    _, line = breaking(shared._address)
    shared.push(tmp_path / "one", ["c", "b", "a-done"])
    assert [entry[0] for entry in line.log] == ["c", "b", "a"]
    fetch, fetched = shared._fetch, []
    shared._fetch = lambda file, into: (fetched.append(file.name), fetch(file, into))[1]
    shared.pull(["c", "b", "a-done", "b"], tmp_path / "two")
    assert fetched == ["c", "b", "a-done"]


def test_push_removes_versions_left_by_a_killed_push(tmp_path):
    write(tmp_path / "one", {"a": "1"})
    shared = SharedFolder(Address(tmp_path / "shared"))
    shared.push(tmp_path / "one", ["a"])
    write(tmp_path / "one", {"a": "2"})
    kept = dict(Address(tmp_path / "shared").sizes())
    (old,) = kept
    data = Address(tmp_path / "shared").read(old, 10)
    assert data is not None
    shared.push(tmp_path / "one", ["a"])
    Address(tmp_path / "shared").write(old, data)
    assert shared.pull_all("", tmp_path / "two") == ["a"]
    assert read(tmp_path / "two") == {"a": "2"}
    assert SharedFolder(Address(tmp_path / "shared")).push(tmp_path / "one", ["a"]) == []
    assert len(Address(tmp_path / "shared").sizes()) == 1


def test_pull_retries_files_replaced_meanwhile(tmp_path, monkeypatch):
    write(tmp_path / "one", {"a": "1"})
    shared = SharedFolder(Address(tmp_path / "shared"))
    shared.push(tmp_path / "one", ["a"])
    listed = shared.files
    changes = ["2"]

    def files(prefix):
        found = listed(prefix)
        if changes:
            write(tmp_path / "one", {"a": changes.pop()})
            SharedFolder(Address(tmp_path / "shared")).push(tmp_path / "one", ["a"])
        return found

    monkeypatch.setattr(shared, "files", files)
    assert shared.pull(["a"], tmp_path / "two") == ["a"]
    assert read(tmp_path / "two") == {"a": "2"}
    changes += [str(number) for number in range(exchange._LISTINGS + 1)]
    with pytest.raises(StorageError, match="change faster"):
        shared.pull(["a"], tmp_path / "three")


def test_pull_names_a_missing_file(address, tmp_path):
    with pytest.raises(StorageError, match=r"has no file 'group0003/group'\. Has the job that writes it finished"):
        SharedFolder(Address(address)).pull(["group0003/group"], tmp_path)


def test_pull_refuses_damaged_files(tmp_path):
    write(tmp_path / "one", {"a": "good"})
    shared = SharedFolder(Address(tmp_path / "shared"))
    shared.push(tmp_path / "one", ["a"])
    (kept,) = (tmp_path / "shared").iterdir()
    kept.write_text("evil")
    with pytest.raises(StorageError, match="is damaged"):
        shared.pull(["a"], tmp_path / "two")
    assert not (tmp_path / "two" / "a").exists()


@pytest.mark.parametrize("name", ["../a", "/a", ".hidden", "missing"])
def test_push_refuses_invalid_files(tmp_path, name):
    (tmp_path / "one").mkdir()
    (tmp_path / "a").write_text("1")
    with pytest.raises(StorageError, match=r"not a path within a folder|cannot be read"):
        SharedFolder(Address(tmp_path / "shared")).push(tmp_path / "one", [name])


def test_pull_ignores_names_outside_the_folder(tmp_path):
    digest = hashlib.sha256(b"1").hexdigest()
    fsspec = pytest.importorskip("fsspec", reason="needs the extra cloud")
    files = fsspec.filesystem("memory")
    files.pipe_file("/hostile/shared/..%2f/x", b"1")
    files.pipe_file(f"/hostile/shared/.ssh/keys@000000-{digest}", b"1")
    shared = SharedFolder(Address("memory://hostile/shared"))
    assert shared.pull_all("", tmp_path) == []
    assert read(tmp_path) == {}


def test_files_arrive_though_each_first_request_fails(faulty: tuple[Bucket, Faults], tmp_path: Path) -> None:
    bucket, faults = faulty
    told: list[str] = []
    one = Exchange(bucket.url("run"), tmp_path / "one", told.append)
    faults.begin("is_busy", ("GET", "PUT"))
    for group in range(2):
        made(tmp_path / "one", group)
        one.send_group(0, group)
    assert faults.met == len(told) > 2 * len(REEL_FILES_OF_GROUP)
    faults.begin("cuts", ("GET",))
    Exchange(bucket.url("run"), tmp_path / "two", told.append).fetch_finished()
    assert faults.met >= 2 * len(REEL_FILES_OF_GROUP)
    for path in (tmp_path / "two" / "work").rglob("*/*"):
        assert path.read_text() == (tmp_path / "one" / path.relative_to(tmp_path / "two")).read_text()


def test_private_bucket_of_machines_is_explained(faulty: tuple[Bucket, Faults], tmp_path: Path) -> None:
    bucket, faults = faulty
    faults.begin("is_private", ("GET", "PUT"), 100)
    with pytest.raises(StorageError, match="is private"):
        Exchange(bucket.url("run"), tmp_path).fetch_scene()
    assert faults.met == 1
