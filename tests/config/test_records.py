"""Runs of an earlier version: settings that it did not have count as turned off."""

import json
from pathlib import Path
from typing import Any

import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.config import Config
from splatreel.config.records import ADDED_SETTINGS, FORMER_DEFAULTS, complete_settings, with_former_defaults
from splatreel.config.settings import changed, settings
from splatreel.run.run_lock import RunLock
from splatreel.run.run_record import run_record
from tests.method.captures import WallCapture


def enter(tmp_path: Path, changes: dict[str, Any]) -> None:
    """Continue a run whose record has other values at its top."""
    capture, config = WallCapture(4), Config()
    (tmp_path / "work").mkdir(exist_ok=True)
    record = run_record(capture, config, "auto") | changes
    (tmp_path / "work" / "run.json").write_text(json.dumps(record))
    with RunLock(tmp_path, run_record(capture, config, "auto")):
        pass


def test_added_settings_exist() -> None:
    assert set(ADDED_SETTINGS) <= set(settings())


def test_missing_settings_are_completed() -> None:
    added = {"group.lambda_new": 0.0, "new.section.flag": False, "seed": 0}
    assert complete_settings({"group": {"length": 3}, "seed": 4}, added) == {
        "group": {"length": 3, "lambda_new": 0.0},
        "new": {"section": {"flag": False}},
        "seed": 4,
    }
    assert complete_settings({"group": 3}, added)["group"] == 3
    assert complete_settings(None, {}) == {}


def test_same_run_is_continued(tmp_path: Path) -> None:
    enter(tmp_path, {})


def test_other_settings_are_refused(tmp_path: Path) -> None:
    config = json.loads(Config().to_json())
    config["group"]["overlap"] = 4
    with pytest.raises(ReconstructionError, match=r"config.group.overlap is 4 there, 5 now"):
        enter(tmp_path, {"config": config})
    config["group"] |= {"overlap": 5, "delays": True}
    with pytest.raises(ReconstructionError, match=r"config.group.delays is true there, not to be set now"):
        enter(tmp_path, {"config": config})


@pytest.mark.parametrize("config", [None, 3, {"group": [1]}])
def test_damaged_record_is_refused(tmp_path: Path, config: Any) -> None:
    with pytest.raises(ReconstructionError, match="this folder holds another reconstruction"):
        enter(tmp_path, {"config": config})


def test_former_defaults_differ_from_present_ones() -> None:
    usual = Config()
    assert all(settings()[name].of(usual) != former for name, former in FORMER_DEFAULTS.items())


def test_run_of_former_version_continues_with_its_defaults(tmp_path: Path) -> None:
    """Its record lacks the settings added since, and has the defaults of its time."""
    record = json.loads(changed(Config(), FORMER_DEFAULTS).to_json())
    for name in ADDED_SETTINGS:
        section, _, last = name.rpartition(".")
        (record[section] if section else record).pop(last)
    config = with_former_defaults(Config(), record)
    assert {name: settings()[name].of(config) for name in FORMER_DEFAULTS} == FORMER_DEFAULTS
    assert config.for_video(4).keyframe.first_iterations == FORMER_DEFAULTS["keyframe.first_iterations"]
    assert (
        with_former_defaults(changed(Config(), {"keyframe.first_iterations": 7}), record).keyframe.first_iterations == 7
    )


@pytest.mark.parametrize("record", [None, 3, json.loads(Config().for_video(60).to_json())])
def test_other_runs_have_present_defaults(record: Any) -> None:
    assert with_former_defaults(Config(), record) == Config()
