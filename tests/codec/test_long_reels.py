"""Long reels: retired layers, pages, dropped groups; a killed writer resumes to the same bytes."""

import contextlib
import dataclasses
import json

import numpy as np
import pytest

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReelError, StorageError
from splatreel.codec import writer as writer_module
from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_group
from splatreel.codec.inspection import reel_info, verify_reel
from splatreel.codec.manifest import edit_reel
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.storage.address import Address
from tests.codec.reels import QUICK, add_chapter_group, new_group, new_writer, points, write_chapters
from tests.files import contents


def chapters(path, **changes) -> ReelWriter:
    return new_writer(path, **({"config": QUICK, "page": 2} | changes))


def grown(path, groups: int, **changes) -> ReelWriter:
    writer = chapters(path, **changes)
    for index in range(writer.manifest.end_group, groups):
        add_chapter_group(writer, index, 4)
    return writer


def numbers(path, kind: str) -> list[str]:
    return sorted(p.name.removesuffix(".safetensors").removesuffix(".json") for p in (path / kind).glob("*"))


def remembering(encode):
    """Cache the encoding of the tests' layers and groups by number and size."""
    known = {}

    def wrapped(self, what, *more):
        key = (what, *(len(x) for x in more[1:2])) if isinstance(what, int) else what.index
        if key not in known:
            known[key] = encode(self, what, *more)
        return known[key]

    return wrapped


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write_chapters(tmp_path_factory.mktemp("long") / "reel", groups=9)


def test_several_layers_of_a_group_round_trip(tmp_path):
    writer = chapters(tmp_path)
    shared, _ = writer.add_layer(0, 0, points(6, seed=1))
    own, _ = writer.add_layer(0, 0, points(4, seed=2), until=1)
    writer.add_group(new_group(0, 3, np.arange(10) % 3 > 0))
    writer.add_layer(1, 2, points(5, seed=3), until=9)
    writer.add_group(new_group(1, 3, np.arange(11) % 3 > 0))
    writer.finish()
    reader = ReelReader(tmp_path)
    said = [(layer.uri, layer.group, layer.until) for layer in reader.manifest.layers]
    assert said == [
        ("layers/0000.safetensors", 0, None),
        ("layers/0000.1.safetensors", 0, 1),
        ("layers/0001.safetensors", 1, 9),
    ]
    np.testing.assert_array_equal(reader.static(0)[0].means, np.concatenate([shared.means, own.means]))
    np.testing.assert_array_equal(reader.static(1)[0].means[:6], shared.means)
    assert [len(reader.group(g).alive) for g in (0, 1)] == [10, 11]
    assert verify_reel(tmp_path).layers == 3
    assert json.loads((tmp_path / "manifest.json").read_text())["version"] == 2


def test_encoded_files_are_written_unchanged(tmp_path, whole):
    writer = chapters(tmp_path / "again")
    reader = ReelReader(whole)
    for entry in reader.manifest.groups:
        for layer in (x for x in reader.manifest.layers if x.group == entry.group):
            given = (reader.read_file(layer),), np.arange(layer.points)
            writer.add_layer(layer.group, layer.first_frame, points(layer.points), encoded=given, until=layer.until)
        data = reader.read_file(entry)
        writer.add_group(decode_group(data, entry.uri), encoded={entry.uri: data})
    writer.finish()
    assert contents(tmp_path / "again") == contents(whole)


@pytest.mark.parametrize(
    ("lives", "message"),
    [
        ([(0, 4), (0, None)], "cannot follow one of group 0 until 4"),
        ([(0, 4), (0, 5)], "longest-lived"),
        ([(0, 0)], "would never show; choose more than 0"),
        ([(1, None)], "the next one is 0"),
    ],
)
def test_layers_out_of_order_are_refused(tmp_path, lives, message):
    writer = chapters(tmp_path)
    *before, (group, until) = lives
    for earlier in before:
        writer.add_layer(earlier[0], 0, points(3), until=earlier[1])
    with pytest.raises(ReelError, match=message):
        writer.add_layer(group, 0, points(3), until=until)


def test_alive_counts_the_points_that_live_at_a_group(tmp_path):
    writer = grown(tmp_path, 4)
    with pytest.raises(ReelError, match=r"Group 4 has alive flags of 12 static points.* hold 6"):
        writer.add_group(new_group(4, 3, 12))


@pytest.mark.parametrize("page", [0, 1025])
def test_invalid_page_sizes_are_refused(tmp_path, page):
    with pytest.raises(ReelError, match=f"pages of {page} groups"):
        chapters(tmp_path, page=page)


def test_older_groups_move_into_immutable_pages(tmp_path):
    writer, seen = chapters(tmp_path), {}
    for index in range(11):
        add_chapter_group(writer, index, 4)
        document = json.loads((tmp_path / "manifest.json").read_text())
        assert len(document["groups"]) == (index + 1 if index < 3 else 2 + (index + 1) % 2)
        now = contents(tmp_path / "pages") if (tmp_path / "pages").exists() else {}
        assert now | seen == now
        assert len(now) == len(document.get("pages", [])) == max((index + 1) // 2 - 1, 0)
        seen = now
        assert ReelReader(tmp_path).manifest.groups == writer.manifest.groups
    assert numbers(tmp_path, "pages") == ["000000", "000002", "000004", "000006"]
    assert verify_reel(tmp_path).groups == 11


def test_resumed_writer_gives_the_same_bytes(tmp_path, whole):
    for index in range(9):
        grown(tmp_path, index + 1, resume=index > 0)
    chapters(tmp_path, resume=True).finish()
    assert contents(tmp_path) == contents(whole)


@pytest.mark.parametrize("name", ["pages/000002.json", "groups/0003.safetensors", "layers/0000.1.safetensors"])
@pytest.mark.parametrize("damage", ["missing", "damaged"])
def test_resumed_writer_replaces_damaged_files_with_the_same_bytes(tmp_path, whole, name, damage):
    grown(tmp_path, 9)
    data = bytearray((tmp_path / name).read_bytes())
    data[-5] ^= 1
    (tmp_path / name).write_bytes(data)
    if damage == "missing":
        (tmp_path / name).unlink()
    writer = chapters(tmp_path, resume=True)
    assert writer.manifest.end_group == {"p": 2, "g": 3, "l": 0}[name[0]]
    if writer.manifest.groups:
        assert verify_reel(tmp_path).strangers == []
    grown(tmp_path, 9, resume=True).finish()
    assert contents(tmp_path) == contents(whole)


def test_adding_an_earlier_group_drops_pages(tmp_path, whole):
    writer = grown(tmp_path, 9)
    add_chapter_group(writer, 3, 4)
    assert (writer.manifest.end_group, numbers(tmp_path, "pages")) == (4, ["000000"])
    assert (verify_reel(tmp_path).groups, numbers(tmp_path, "layers")) == (4, ["0000", "0000.1", "0001"])
    grown(tmp_path, 9, resume=True).finish()
    assert contents(tmp_path) == contents(whole)


def test_without_resume_pages_are_dropped(tmp_path):
    write_chapters(tmp_path)
    chapters(tmp_path)
    assert contents(tmp_path) == {}


def test_retention_drops_whole_pages_and_retired_layers(tmp_path):
    writer = grown(tmp_path, 9)
    writer.drop_before(5)
    manifest = ReelReader(tmp_path).manifest
    assert manifest.to_json() == writer.manifest.to_json()
    assert (manifest.first_group, manifest.end_group, manifest.first_frame, manifest.frames) == (4, 9, 8, 19)
    assert numbers(tmp_path, "pages") == ["000004"]
    assert numbers(tmp_path, "groups") == ["0004", "0005", "0006", "0007", "0008"]
    assert numbers(tmp_path, "layers") == ["0000", "0004", "0005", "0008"]
    assert verify_reel(tmp_path).strangers == []
    writer.drop_before(8)
    assert (writer.manifest.first_group, writer.manifest.pages) == (8, ())
    writer.drop_before(50)
    assert writer.manifest.first_group == 8
    add_chapter_group(writer, 9, 4)
    assert (verify_reel(tmp_path).groups, numbers(tmp_path, "layers")) == (2, ["0000", "0008", "0009"])


def test_retention_with_kills_gives_the_same_reel(tmp_path):
    def go(path, killed):
        writer = chapters(path)
        for index in range(14):
            if killed:
                writer = chapters(path, resume=index > 0)
            add_chapter_group(writer, index, 4)
            writer.drop_before(index - 4)
        writer.finish()
        return contents(path)

    one = go(tmp_path / "a", False)
    assert one == go(tmp_path / "b", True)
    assert json.loads(one["manifest.json"])["first_group"] == 8


def test_killed_writer_leaves_a_valid_reel_that_resumes(tmp_path, monkeypatch):
    """The retention window moves, so pages are added and removed. The files on disk are read at each of these moments."""
    left = 0

    def may_be_killed(function):
        def wrapped(*arguments, **named):
            nonlocal left
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
            return function(*arguments, **named)

        return wrapped

    def go(path):
        writer = chapters(path, resume=True)
        for index in range(writer.manifest.end_group, 9):
            writer.drop_before(index - 6)  # before the group: one that was killed after it does it now
            add_chapter_group(writer, index, 4)
        writer.drop_before(3)
        writer.finish()

    monkeypatch.setattr("os.fsync", lambda _: None)  # of a thousand files
    for kind in ("layer", "group"):  # encoded once, taken from there each time
        monkeypatch.setattr(ReelEncoder, kind, remembering(getattr(ReelEncoder, kind)))
    go(tmp_path / "whole")
    monkeypatch.setattr(writer_module, "write_bytes", may_be_killed(writer_module.write_bytes))
    monkeypatch.setattr(ReelWriter, "_delete", may_be_killed(ReelWriter._delete))
    killed = 0
    while left <= 0:
        killed += 1
        left, path = killed, tmp_path / str(killed)
        with contextlib.suppress(KeyboardInterrupt):
            go(path)
            break
        if (path / "manifest.json").exists():
            reader = ReelReader(path)
            assert all(reader.read_file(entry) for entry in reader.manifest.files)
        go(path)
        assert contents(path) == contents(tmp_path / "whole"), f"killed at {killed}"
    assert killed > 30


def test_full_disk_at_a_page_leaves_a_valid_reel(tmp_path, monkeypatch):
    writer = grown(tmp_path, 3)

    def full(path, data):
        if path.parent.name == "pages":
            raise StorageError(f"{path}: could not write")
        write_bytes(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(writer_module, "write_bytes", full)
        with pytest.raises(StorageError, match="could not write"):
            add_chapter_group(writer, 3, 4)
    assert verify_reel(tmp_path).groups == 3
    add_chapter_group(writer, 3, 4)
    assert (verify_reel(tmp_path).groups, numbers(tmp_path, "pages")) == (4, ["000000"])


def test_resume_deletes_leftover_files(tmp_path, monkeypatch):
    writer = grown(tmp_path, 9)

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_delete", killed)
    with pytest.raises(KeyboardInterrupt):
        writer.drop_before(6)
    (tmp_path / "groups" / "notes.txt").write_text("of a person")
    assert len(verify_reel(tmp_path).strangers) == 12
    assert chapters(tmp_path, resume=True).manifest.first_group == 6
    assert verify_reel(tmp_path).strangers == ["groups/notes.txt"]


def test_outdated_reader_is_told_to_reopen(tmp_path):
    writer = grown(tmp_path, 9)
    reader = ReelReader(tmp_path)
    writer.drop_before(6)
    with pytest.raises(ReelError, match=r"0001\.safetensors: does not exist.* drops old files: open it again"):
        reader.group(1)
    with pytest.raises(ReelError, match="has 3 groups from 6 on, group 1 was asked for"):
        ReelReader(tmp_path).group(1)
    assert ReelReader(tmp_path).group(6).index == 6


def test_page_dropped_during_open_is_no_error(tmp_path, monkeypatch):
    writer = grown(tmp_path, 9)
    fetch = Address.fetch

    def late(self, file, *limits):
        if file == "pages/000000.json":
            writer.drop_before(4)
        return fetch(self, file, *limits)

    monkeypatch.setattr(Address, "fetch", late)
    assert ReelReader(tmp_path).manifest.first_group == 4


def test_live_reel_starts_at_a_later_group_with_earlier_layers(tmp_path):
    writer = chapters(tmp_path, first_group=5)
    writer.add_layer(0, 0, points(6, seed=1))
    with pytest.raises(ReelError, match="would never show; choose more than 5"):
        writer.add_layer(3, 6, points(4, seed=2), until=5)
    writer.add_layer(3, 6, points(4, seed=2), until=6)
    with pytest.raises(ReelError, match="group 4 cannot be added, the next one is 5"):
        writer.add_group(new_group(4, 3, 10))
    writer.add_layer(5, 10, points(2, seed=3))
    writer.add_group(new_group(5, 3, 12))
    writer.add_group(new_group(6, 3, 8))
    assert verify_reel(tmp_path).groups == 2
    reader = ReelReader(tmp_path)
    assert (reader.manifest.first_frame, reader.group(6).index, len(reader.static(6)[0])) == (10, 6, 8)
    assert chapters(tmp_path, resume=True).manifest.to_json() == writer.manifest.to_json()
    (tmp_path / "layers" / "0000.safetensors").unlink()
    writer = chapters(tmp_path, resume=True)
    assert (writer.manifest.first_group, writer.manifest.layers, writer.manifest.end_group) == (5, (), 5)
    assert contents(tmp_path) == {}
    assert chapters(tmp_path, first_group=9).manifest.end_group == 9


def test_renditions_are_written_in_pages_too(tmp_path):
    config = dataclasses.replace(EncodeConfig(), renditions=("high", "low"))
    reel = write_chapters(tmp_path, groups=6, config=config)
    assert verify_reel(reel).groups == 6
    info = reel_info(reel)
    assert info.rendition_bytes == ReelReader(reel).manifest.rendition_bytes()
    low = ReelReader(reel, "low")
    assert [low.group(g).index for g in range(6)] == list(range(6))
    on_disk = sum(len(data) for name, data in contents(reel).items() if ".low." not in name)
    assert info.bytes == on_disk


def test_edit_keeps_pages(tmp_path):
    reel = write_chapters(tmp_path, groups=6)
    before = contents(reel)
    assert edit_reel(reel, {"title": "A title"}).presentation.title == "A title"
    changed = {name for name, data in contents(reel).items() if before[name] != data}
    assert changed == {"manifest.json"}
    assert verify_reel(reel).groups == 6


def test_reader_forgets_retired_layers(tmp_path, whole):
    reader = ReelReader(whole)
    for group in range(9):
        reader.static(group)
        assert len(reader._layers) <= 1 + 3
    assert len(reader.static(0)[0]) == 10
