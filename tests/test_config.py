import dataclasses
import json
from typing import Any, get_args

import pytest

from splatreel.config import LEAST, Config, GroupConfig, KeyframeConfig, LayeringConfig, Quality, preset
from splatreel.errors import UsageError

PARTS = {"keyframe": KeyframeConfig, "layering": LayeringConfig, "group": GroupConfig}


def config(name: str, value: Any) -> Config:
    """The default configuration with one field changed."""
    part, _, field = name.rpartition(".")
    return Config(**{part: PARTS[part](**{field: value})}) if part else Config(**{field: value})


@pytest.mark.parametrize("name", LEAST)
def test_a_count_below_its_least_is_refused_by_name_and_value(name: str) -> None:
    least = LEAST[name]
    with pytest.raises(UsageError, match=rf"^{name} {least - 1} is out of range. Choose {least} or more"):
        config(name, least - 1)
    with pytest.raises(UsageError, match=rf"^{name} -7 "):
        config(name, -7)


@pytest.mark.parametrize("name", [name for name in LEAST if name != "group.length"])
def test_the_least_count_is_taken(name: str) -> None:
    assert config(name, LEAST[name]) != config(name, LEAST[name] + 1)


def test_an_overlap_as_long_as_a_group_is_refused() -> None:
    with pytest.raises(UsageError, match=r"group\.overlap 5 does not fit group\.length 5"):
        Config(group=GroupConfig(length=5, overlap=5))
    assert Config(group=GroupConfig(length=1, overlap=0)).group.length == 1


def test_a_change_by_replace_is_judged_too() -> None:
    with pytest.raises(UsageError, match="seed -1"):
        dataclasses.replace(Config(), seed=-1)


def test_every_quality_has_a_preset_of_its_own_and_no_other_has_one() -> None:
    presets = [preset(quality) for quality in get_args(Quality)]
    assert len({p.to_json() for p in presets}) == 3
    with pytest.raises(UsageError, match="Unknown quality 'best'"):
        preset("best")  # pyright: ignore[reportArgumentType]


def test_the_written_form_tells_configurations_apart() -> None:
    written = json.loads(Config(seed=3).to_json())
    assert written["seed"] == 3
    assert written["group"]["length"] == Config().group.length
    assert Config(seed=3).to_json() != Config(seed=4).to_json()
