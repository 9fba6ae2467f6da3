"""Presentation in the manifest: round trip, hostile content, and writing."""

import dataclasses
import json
from pathlib import Path

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.manifest import Manifest, parse_manifest
from splatreel.codec.presentation import (
    EMPTY,
    Asset,
    Limits,
    Poster,
    Presentation,
    Sound,
    SoundSegment,
    Thumbnails,
    check_text,
)
from splatreel.codec.reader import ReelReader
from tests.codec.reels import new_group, new_writer, points, write_reel
from tests.golden import GOLDEN

TEXT = (GOLDEN / "manifest.json").read_text()


def asset(name: str) -> Asset:
    return Asset(name, 1000, "0" * 64)


FULL = Presentation(
    title="Two chairs <b>",
    author="N. N.",
    description="A room.\nTwo chairs.",
    licence="CC BY 4.0",
    poster=Poster(asset("poster.jpg"), 640, 360),
    thumbnails=Thumbnails(96, 54, 5, 5, 0.5, 30, (asset("thumbnails/0000.jpg"), asset("thumbnails/0001.jpg"))),
    sound=Sound(
        type='audio/mp4; codecs="opus"',
        rate=48000,
        channels=2,
        init=asset("sound/init.mp4"),
        segments=(SoundSegment(asset("sound/0000.m4s"), 0, 2), SoundSegment(asset("sound/0001.m4s"), 2, 1.5)),
        position=(1.0, -2.0, 0.5),
    ),
    limits=Limits((0.0, 1.0, 0.0), 25.0, (0.5, 4.0), -1.0),
)


def manifest() -> Manifest:
    return parse_manifest(TEXT.encode(), "m")


def test_presentation_round_trips() -> None:
    written = dataclasses.replace(manifest(), presentation=FULL).to_json()
    assert parse_manifest(written.encode(), "m").presentation == FULL


def test_empty_presentation_adds_no_fields() -> None:
    assert manifest().presentation == EMPTY
    assert manifest().to_json() == TEXT


def test_each_limit_is_optional() -> None:
    some = Presentation(limits=Limits((0.0, 0.0, 0.0), floor=0.0))
    written = dataclasses.replace(manifest(), presentation=some).to_json()
    assert parse_manifest(written.encode(), "m").presentation == some
    assert json.loads(written)["limits"] == {"focus": [0, 0, 0], "floor": 0}


@pytest.mark.parametrize(
    ("field", "change", "said"),
    [
        ("title", "x" * 201, "201 characters"),
        ("author", 7, "not text"),
        ("poster", [], "not an object"),
        ("poster", {"uri": "../poster.jpg"}, "plain relative paths"),
        ("poster", {"bytes": 1 << 40}, "bytes"),
        ("poster", {"width": 0}, "width"),
        ("thumbnails", {"count": 51}, "51 images"),
        ("thumbnails", {"seconds": 0}, "seconds"),
        ("thumbnails", {"sheets": {}}, "list of files"),
        ("sound", {"type": "text/html"}, "text/html"),
        ("sound", {"segments": [{"uri": "a", "bytes": 1, "sha256": "0" * 64}]}, "start"),
        ("sound", {"init": None}, "not an object"),
        ("limits", {"focus": [0, 0]}, "focus"),
        ("limits", {"angle": 270}, "angle"),
        ("limits", {"distance": [3, 1]}, "least and the most"),
        ("limits", {"floor": "low"}, "floor"),
    ],
)
def test_invalid_presentations_are_refused(field: str, change: object, said: str) -> None:
    document = json.loads(dataclasses.replace(manifest(), presentation=FULL).to_json())
    document[field] = document[field] | change if isinstance(change, dict) else change
    with pytest.raises(ReelError, match=said) as error:
        parse_manifest(json.dumps(document).encode(), "m")
    assert field in str(error.value)


def test_overlapping_sound_segments_are_refused() -> None:
    document = json.loads(dataclasses.replace(manifest(), presentation=FULL).to_json())
    document["sound"]["segments"].reverse()
    with pytest.raises(ReelError, match="order of time"):
        parse_manifest(json.dumps(document).encode(), "m")


def test_writer_adds_and_removes_assets(tmp_path: Path) -> None:
    writer = new_writer(tmp_path)
    poster = Poster(writer.write_asset("poster.jpg", b"an image"), 64, 36)
    writer.present(Presentation(title="Before the first group", poster=poster))
    writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(0, 15, 20))
    assert ReelReader(tmp_path).manifest.presentation.title == "Before the first group"
    assert ReelReader(tmp_path).manifest.live
    writer.finish()
    assert verify_reel(tmp_path).strangers == []

    (tmp_path / "poster.jpg").write_bytes(b"a pictur!")
    with pytest.raises(ReelError, match=r"poster\.jpg"):
        verify_reel(tmp_path)

    writer.present(Presentation(title="After"))
    assert not (tmp_path / "poster.jpg").exists()
    assert not ReelReader(tmp_path).manifest.live, "a finished reel stays finished"
    assert verify_reel(tmp_path).groups == 1


def test_presentation_is_kept_only_on_resume(tmp_path: Path) -> None:
    write_reel(tmp_path)
    writer = new_writer(tmp_path, resume=True)
    writer.present(Presentation(poster=Poster(writer.write_asset("poster.jpg", b"an image"), 64, 36)))
    assert new_writer(tmp_path, resume=True).manifest.presentation.poster is not None
    assert new_writer(tmp_path).manifest.presentation == EMPTY
    assert not (tmp_path / "poster.jpg").exists()


def test_unpaired_surrogates_are_not_written():
    """Terminals with another encoding pass such text, and no reader accepts it."""
    with pytest.raises(ReelError, match="a title that holds half a character"):
        check_text("title", "caf\udce9")
