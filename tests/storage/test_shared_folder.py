import hashlib

import pytest

from splatreel.base.errors import StorageError
from splatreel.storage import shared_folder
from splatreel.storage.addresses import open_folder
from splatreel.storage.shared_folder import SharedFolder
from tests.buckets import BreakingFolder


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
    assert SharedFolder(address).push(one, files) == list(files)
    assert SharedFolder(address).push(one, files) == []
    shared = SharedFolder(address)
    assert shared.pull(["run.json", "empty"], two) == ["empty", "run.json"]
    assert shared.pull_all("group0000/", two) == ["group0000/keyframe"]
    assert shared.pull_all("", two) == ["group0001/keyframe"]
    assert shared.pull_all("", two) == []
    assert read(two) == files
    assert shared.files()["run.json"].sha256 == hashlib.sha256(b"{}").hexdigest()


def test_push_sends_only_changes_and_removes_old_versions(address, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    write(one, {"seconds.json": "[1]", "layout.json": "{}"})
    shared = SharedFolder(address)
    shared.push(one, ["seconds.json", "layout.json"])
    shared.pull_all("", two)
    write(one, {"seconds.json": "[2]"})
    assert shared.push(one, ["seconds.json", "layout.json"]) == ["seconds.json"]
    assert shared.files()["seconds.json"].version == 1
    assert len(open_folder(address).sizes()) == 2
    assert shared.pull_all("", two) == ["seconds.json"]
    write(one, {"seconds.json": "[1]"})
    assert shared.push(one, ["seconds.json"]) == ["seconds.json"]
    assert shared.pull(["seconds.json"], two) == ["seconds.json"]
    assert read(two) == {"seconds.json": "[1]", "layout.json": "{}"}


def test_push_retries_and_keeps_old_versions_until_done(tmp_path):
    told = []
    write(tmp_path / "one", {"a": "old", "b": "b"})
    shared = SharedFolder(tmp_path / "shared", told.append, pauses=(0.0,))
    shared.push(tmp_path / "one", ["a", "b"])
    breaking = shared._folder._folder = BreakingFolder(shared._folder._folder, breaks={0, 2, 3})
    write(tmp_path / "one", {"a": "new", "b": "B"})
    with pytest.raises(StorageError, match="the line is cut"):
        shared.push(tmp_path / "one", ["a", "b"])
    assert len(told) == 2
    assert [entry[:3] for entry in breaking.log] == ["a@0", "-a@"]
    SharedFolder(tmp_path / "shared").pull_all("", tmp_path / "two")
    assert read(tmp_path / "two") == {"a": "new", "b": "b"}
    assert shared.push(tmp_path / "one", ["a", "b"]) == ["b"]


def test_pull_keeps_the_order_of_names(tmp_path):
    """A file that marks the others as complete can therefore be named last."""
    write(tmp_path / "one", {"a-done": "1", "b": "2", "c": "3"})
    shared = SharedFolder(tmp_path / "shared")
    logged = shared._folder._folder = BreakingFolder(shared._folder._folder, breaks=set())
    shared.push(tmp_path / "one", ["c", "b", "a-done"])
    assert [entry[0] for entry in logged.log] == ["c", "b", "a"]
    fetch, fetched = shared._fetch, []
    shared._fetch = lambda file, into: (fetched.append(file.name), fetch(file, into))[1]
    shared.pull(["c", "b", "a-done", "b"], tmp_path / "two")
    assert fetched == ["c", "b", "a-done"]


def test_push_removes_versions_left_by_a_killed_push(tmp_path):
    write(tmp_path / "one", {"a": "1"})
    shared = SharedFolder(tmp_path / "shared")
    shared.push(tmp_path / "one", ["a"])
    write(tmp_path / "one", {"a": "2"})
    kept = dict(open_folder(tmp_path / "shared").sizes())
    (old,) = kept
    data = open_folder(tmp_path / "shared").read(old, 10)
    assert data is not None
    shared.push(tmp_path / "one", ["a"])
    open_folder(tmp_path / "shared").write(old, data)
    assert shared.pull_all("", tmp_path / "two") == ["a"]
    assert read(tmp_path / "two") == {"a": "2"}
    assert SharedFolder(tmp_path / "shared").push(tmp_path / "one", ["a"]) == []
    assert len(open_folder(tmp_path / "shared").sizes()) == 1


def test_pull_retries_files_replaced_meanwhile(tmp_path, monkeypatch):
    write(tmp_path / "one", {"a": "1"})
    shared = SharedFolder(tmp_path / "shared")
    shared.push(tmp_path / "one", ["a"])
    listed = shared.files
    changes = ["2"]

    def files(prefix):
        found = listed(prefix)
        if changes:
            write(tmp_path / "one", {"a": changes.pop()})
            SharedFolder(tmp_path / "shared").push(tmp_path / "one", ["a"])
        return found

    monkeypatch.setattr(shared, "files", files)
    assert shared.pull(["a"], tmp_path / "two") == ["a"]
    assert read(tmp_path / "two") == {"a": "2"}
    changes += [str(number) for number in range(shared_folder._LISTINGS + 1)]
    with pytest.raises(StorageError, match="change faster"):
        shared.pull(["a"], tmp_path / "three")


def test_pull_names_a_missing_file(address, tmp_path):
    with pytest.raises(StorageError, match=r"has no file 'group0003/group'\. Has the job that writes it finished"):
        SharedFolder(address).pull(["group0003/group"], tmp_path)


def test_pull_refuses_damaged_files(tmp_path):
    write(tmp_path / "one", {"a": "good"})
    shared = SharedFolder(tmp_path / "shared")
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
        SharedFolder(tmp_path / "shared").push(tmp_path / "one", [name])


def test_pull_ignores_names_outside_the_folder(tmp_path):
    digest = hashlib.sha256(b"1").hexdigest()
    fsspec = pytest.importorskip("fsspec", reason="needs the extra cloud")
    files = fsspec.filesystem("memory")
    files.pipe_file("/hostile/shared/..%2f/x", b"1")
    files.pipe_file(f"/hostile/shared/.ssh/keys@000000-{digest}", b"1")
    shared = SharedFolder("memory://hostile/shared")
    assert shared.pull_all("", tmp_path) == []
    assert read(tmp_path) == {}
