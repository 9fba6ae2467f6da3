"""Frames and cameras of the capture that a reel was made from, as JSON."""

from typing import Any

import pytest

from splatreel.scene.reel_source import ReelSource, parse_reel_source


@pytest.mark.parametrize(
    "source",
    [ReelSource(0), ReelSource(None, ("a", "b")), ReelSource(20, ("cam05",), ("cam09",), "masks", edited=True)],
)
def test_source_survives_json(source: ReelSource) -> None:
    assert parse_reel_source(source.to_dict()) == source


@pytest.mark.parametrize(
    "value",
    [
        *(None, 5, [], {}),
        *({"held_out": "cam00"}, {"held_out": [5]}, {"held_out": [], "left_out": {}}, {"held_out": ["x" * 300]}),
        *({"held_out": [], "frame": frame} for frame in (-1, 1.5, "0", True, 1 << 60)),
        *({"held_out": [], "part": part} for part in ("half", [], 3)),
    ],
)
def test_malformed_source_is_unknown(value: Any) -> None:
    """A reel plays without its source, so no reader refuses one for it."""
    assert parse_reel_source(value) is None


def test_later_start_shifts_the_frame() -> None:
    assert ReelSource(20).shifted(5).frame == 25
    assert ReelSource(None).shifted(5).frame is None
