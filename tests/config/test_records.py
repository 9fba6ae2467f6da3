"""Runs that version 0.1 began: their run.json has older names, and settings that are constants now."""

import json
from pathlib import Path
from typing import Any, get_args

import pytest

from splatreel.config import Config, Quality, preset
from splatreel.config.records import CONSTANT, RENAMED, UNSAID, updated
from splatreel.config.settings import changed, settings
from splatreel.errors import ReconstructionError
from splatreel.recon.run.run_lock import RunLock
from tests.recon.captures import WallCapture

UNKNOWN = {"chapter_frames": 0, "training_megapixels": 0.0}
"""Of what such a version did not know, what it did."""
RUNS = Path(__file__).parent.parent / "data" / "runs"


def old(name: str) -> dict[str, Any]:
    """A run.json as version 0.1 wrote it."""
    return json.loads((RUNS / f"{name}.json").read_text())


@pytest.mark.parametrize("quality", get_args(Quality))
def test_the_presets_are_what_they_were(quality: Quality) -> None:
    assert updated(old(quality)["config"]) == json.loads(preset(quality).to_json()) | UNKNOWN


def test_the_tables_know_every_setting_and_no_other() -> None:
    assert set(UNSAID) == set(settings())
    assert set(RENAMED.values()) <= set(settings())
    assert not (set(RENAMED) | set(CONSTANT)) & set(settings())


def test_what_a_record_does_not_say_is_off() -> None:
    config = old("standard")["config"]
    del config["group"]["track"], config["keyframe"]["pace"], config["background"]
    expected = changed(preset("standard"), {"group.tracks": False, "keyframe.rate_scale": 1.0, "background": False})
    assert updated(config) == json.loads(expected.to_json()) | UNKNOWN
    assert updated(None) == updated({})


def enter(tmp_path: Path, record: dict[str, Any], config: Config) -> None:
    """Go on with a run of that record."""
    capture = WallCapture(4)
    (tmp_path / "work").mkdir(exist_ok=True)
    (tmp_path / "work" / "run.json").write_text(json.dumps(record | {"capture": capture.describe()}))
    with RunLock(tmp_path, capture, config):
        pass


@pytest.mark.parametrize("quality", get_args(Quality))
def test_runs_are_continued(tmp_path: Path, quality: Quality) -> None:
    enter(tmp_path, old(quality), preset(quality))


@pytest.mark.parametrize(
    ("section", "name", "value", "message"),
    [
        ("layering", "label_threshold", 0.7, "config.layering.label_threshold is 0.7 there, not to be set now"),
        ("group", "delays", False, "config.group.time_offsets is false there, true now"),
        ("encode", "crf", 14, "config.encode.h265.crf is 14 there, 20 now"),
        ("layering", "lift", "optimise", 'config.layering.lift is "optimize" there, "vote" now'),
    ],
)
def test_other_settings_are_named_as_they_are_called_now(
    tmp_path: Path, section: str, name: str, value: Any, message: str
) -> None:
    record = old("standard")
    record["config"][section][name] = value
    with pytest.raises(ReconstructionError) as error:
        enter(tmp_path, record, preset("standard"))
    assert message in str(error.value)


def test_a_record_that_is_none(tmp_path: Path) -> None:
    for record in ({}, {"config": 3}, {"config": {"group": [1]}}):
        with pytest.raises(ReconstructionError, match="this folder holds another reconstruction"):
            enter(tmp_path, record, preset("standard"))
