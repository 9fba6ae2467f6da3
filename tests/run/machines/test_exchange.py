"""Nodes list shared files once per group, and only the files that they need."""

from pathlib import Path

import pytest

from splatreel.run.machines.exchange import Exchange
from splatreel.run.store import LAST_OF_GROUP, REEL_FILES_OF_GROUP
from splatreel.scene.spans import ChapterSpan, GroupSpan
from splatreel.storage.folder import LocalFolder
from tests.buckets import Bucket

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
    sizes = LocalFolder.sizes
    monkeypatch.setattr(LocalFolder, "sizes", lambda self, prefix="": asked.append(prefix) or sizes(self, prefix))
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
