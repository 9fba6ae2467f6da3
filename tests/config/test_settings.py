"""Settings by name, and runs of an earlier version: settings that it did not have count as turned off."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.config import Config, preset
from splatreel.config.presets import unusual_settings
from splatreel.config.setting_values import Needs, shown
from splatreel.config.settings import (
    ADDED_SETTINGS,
    FORMER_DEFAULTS,
    REMOVED_SETTINGS,
    changed,
    complete_settings,
    parse_settings,
    settings,
    with_former_defaults,
    without_effect,
)
from splatreel.run.run_folder import RunLock, run_record
from tests.method.captures import WallCapture


def test_every_setting_is_documented() -> None:
    docs = [setting.doc for setting in settings().values()]
    assert all(len(doc) > 10 and doc.endswith(".") for doc in docs)
    assert len(set(docs)) > len(docs) - 3


def test_every_default_can_be_parsed_from_text() -> None:
    for name, setting in settings().items():
        value = setting.of(Config())
        text = ",".join(value) if isinstance(value, tuple) else str(value).lower()
        assert parse_settings([f"{name}={text}"]) == {name: value}


def test_several_settings_of_one_section_change_at_once() -> None:
    values = parse_settings(["group.length=3", "group.overlap=2", "encode.h265.crf=30", "seed=4"])
    config = changed(Config(), values)
    assert (config.group.length, config.group.overlap, config.seed) == (3, 2, 4)
    assert config.encode.h265.crf == 30
    assert changed(config, {name: settings()[name].of(Config()) for name in values}) == Config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("group.lambda_arap", "'group.lambda_arap' has no value. Write NAME=VALUE, such as group.lambda_arap=0."),
        (
            "group.lambda_arp=0",
            "'group.lambda_arp' is not a setting. Did you mean group.lambda_arap or group.lambda_sh or group.lambda_temporal? "
            "`splatreel config` lists all.",
        ),
        (
            "coarse_share=0",
            "'coarse_share' is not a setting. Did you mean keyframe.coarse_share or group.coarse_share? `splatreel config` lists all.",
        ),
        ("group=3", "'group' is not a setting. `splatreel config` lists all."),
        ("group.length=long", "group.length 'long' is not a whole number, 1 or more."),
        ("group.length=2.5", "group.length '2.5' is not a whole number, 1 or more."),
        ("group.length=0", "group.length 0 is out of range. Choose 1 or more."),
        ("group.coarse_share=inf", "group.coarse_share 'inf' is not a number from 0 to 1."),
        ("group.tracks=maybe", "group.tracks 'maybe' is not true or false."),
        ("encode.h265.quat_bits=x", "encode.h265.quat_bits 'x' is not a whole number from 1 to 16, or none."),
        ("layering.flow=sift", "layering.flow 'sift' is unknown. Choose one of dis, raft."),
    ],
)
def test_unknown_settings_and_values_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError) as error:
        parse_settings([text])
    assert str(error.value) == message


def test_setting_given_twice_is_refused() -> None:
    with pytest.raises(UsageError, match=r"group\.length is set twice"):
        parse_settings(["group.length=3", "group.length=4"])


def all_needs(needs: tuple[Needs, ...]) -> list[Needs]:
    """Return conditions with their alternatives."""
    return [one for need in needs for one in (need, *all_needs((need.other,) if need.other else ()))]


def test_conditions_name_settings_and_possible_values() -> None:
    for setting in settings().values():
        for need in all_needs(setting.needs):
            other = settings()[need.name]
            assert other.name != setting.name
            for value in (*need.values, *need.but):
                other.kind.check(other.name, value)
                assert parse_settings([f"{other.name}={shown(value)}"]) == {other.name: value}
            for value in need.always:
                setting.kind.check(setting.name, value)


H265 = {"encode.codec": "h265"}


@pytest.mark.parametrize(
    ("name", "values", "reason"),
    [
        ("encode.h265.crf", {}, "encode.codec=predictive. It needs encode.codec=h265"),
        ("encode.h265.crf", H265, None),
        ("encode.h265.crf", H265 | {"encode.h265.source": "raw"}, "encode.h265.source=raw"),
        ("encode.h265.color_bits", H265 | {"encode.h265.crf_attributes": 20}, "encode.h265.crf_attributes=20"),
        ("encode.h265.weighted_codebook", H265 | {"encode.sh_entries": None}, "encode.sh_entries=none"),
        ("encode.coarseness", {}, None),
        ("encode.coarseness", H265, "encode.codec=h265. It needs encode.codec=predictive"),
        (
            "encode.coarseness",
            {"encode.renditions": ("high", "low")},
            "encode.renditions=high,low. It needs encode.renditions=none",
        ),
        ("encode.renditions", H265 | {"encode.renditions": ("high",)}, "encode.codec=h265"),
        ("encode.sh_entries", {"encode.sh_entries": 512}, "encode.codec=predictive"),
        ("encode.sh_entries", {"encode.sh_entries": 0}, None),
        ("encode.sh_entries", H265 | {"keyframe.sh_degree": 0}, "keyframe.sh_degree=0"),
        (
            "group.lambda_sh",
            {"keyframe.sh_degree": 0},
            "keyframe.sh_degree=0. It needs keyframe.sh_degree other than 0",
        ),
        (
            "layering.adapt_changed_share",
            {"layering.enabled": False},
            "layering.enabled=false. It needs layering.enabled=true",
        ),
        ("layering.flow", {"layering.enabled": False}, None),
        (
            "layering.flow",
            {"layering.enabled": False, "group.tracks": False},
            "layering.enabled=false and group.tracks=false. It needs layering.enabled=true or group.tracks=true",
        ),
        ("layering.adapt_changed_share", {"layering.adapt_every": 0}, "layering.adapt_every=0"),
    ],
)
def test_settings_know_when_they_have_no_effect(name: str, values: dict[str, object], reason: str | None) -> None:
    found = without_effect(changed(Config(), values), [name]).get(name)
    if reason is None:
        assert found is None
    else:
        assert found is not None
        assert found.startswith(f"has no effect with {reason}")


def test_values_of_no_preset_are_unusual() -> None:
    assert unusual_settings(preset("paper")) == []
    mixed = changed(preset("paper"), {"encode.codec": "predictive", "group.overlap": 4})
    assert unusual_settings(mixed) == ["group.overlap"]


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


def with_removed(name: str, value: Any) -> dict[str, Any]:
    """Return the record of a version that had a setting which is removed now."""
    record = run_record(WallCapture(4), Config(), "auto")["config"]
    *sections, last = name.split(".")
    place = record
    for section in sections:
        place = place[section]
    place[last] = value
    return record


@pytest.mark.parametrize(("name", "value"), REMOVED_SETTINGS.items())
def test_run_with_a_removed_setting_continues_if_it_has_the_fixed_value(tmp_path: Path, name: str, value: Any) -> None:
    assert name not in settings()
    enter(tmp_path, {"config": with_removed(name, value)})
    with pytest.raises(ReconstructionError, match=rf"config.{name} is 7 there, not to be set now"):
        enter(tmp_path, {"config": with_removed(name, 7)})
    with pytest.raises(UsageError, match=rf"{name} is not a setting any more: it is {shown(value)} in every run"):
        parse_settings([f"{name}=7"])
