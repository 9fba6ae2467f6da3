import dataclasses
import json
from typing import Any, get_args

import pytest

from splatreel.base.errors import UsageError
from splatreel.config import Config, EncodeConfig, GroupConfig, H265Config, Quality, preset
from splatreel.config.presets import BEYOND_THE_PAPER, SECTION_5_1
from splatreel.config.settings import changed

LEAST = {
    "seed": 0,
    "keyframe.first_iterations": 0,
    "keyframe.refine_iterations": 1,
    "keyframe.densify_every": 1,
    "keyframe.rate_scale": 0.001,
    "keyframe.far_step_scale": 1,
    "keyframe.max_points": 1,
    "layering.adapt_every": 0,
    "group.iterations_per_frame": 1,
    "group.length": 1,
    "group.overlap": 0,
}


@pytest.mark.parametrize("name", LEAST)
def test_too_small_value_is_refused_with_its_name(name: str) -> None:
    least = LEAST[name]
    with pytest.raises(UsageError, match=rf"^{name} {least - 1} is out of range. Choose {least} or more"):
        changed(Config(), {name: least - 1})
    with pytest.raises(UsageError, match=rf"^{name} -7 "):
        changed(Config(), {name: -7})


@pytest.mark.parametrize("name", [name for name in LEAST if name != "group.length"])
def test_smallest_value_is_accepted(name: str) -> None:
    assert changed(Config(), {name: LEAST[name]}) != changed(Config(), {name: LEAST[name] + 1})


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        (GroupConfig, {"coarse_share": 1.5}, "group.coarse_share 1.5 is out of range. Choose 0 to 1."),
        (GroupConfig, {"lambda_arap": float("nan")}, "group.lambda_arap nan is out of range. Choose 0 or more."),
        (
            GroupConfig,
            {"deformation": "rigid"},
            "group.deformation 'rigid' is unknown. Choose one of trajectory, hashgrid.",
        ),
        (
            EncodeConfig,
            {"renditions": ("low", "ultra")},
            "encode.renditions 'ultra' is unknown. Choose some of high, medium, low, or none.",
        ),
        (H265Config, {"crf": 52}, "encode.h265.crf 52 is out of range. Choose 0 to 51."),
    ],
)
def test_each_section_checks_its_values(section: type, values: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError) as error:
        section(**values)
    assert str(error.value) == message


def test_overlap_as_long_as_a_group_is_refused() -> None:
    with pytest.raises(UsageError, match=r"group\.overlap 5 does not fit group\.length 5"):
        Config(group=GroupConfig(length=5, overlap=5))
    assert Config(group=GroupConfig(length=1, overlap=0)).group.length == 1


def test_replaced_values_are_checked() -> None:
    with pytest.raises(UsageError, match="seed -1"):
        dataclasses.replace(Config(), seed=-1)


def test_every_quality_has_its_own_preset() -> None:
    presets = [preset(quality) for quality in get_args(Quality)]
    assert len({p.to_json() for p in presets}) == 3
    with pytest.raises(UsageError, match="Unknown quality 'best'"):
        preset("best")  # pyright: ignore[reportArgumentType]


def test_defaults_are_standard_and_paper_is_two_tables() -> None:
    assert preset("standard") == Config()
    assert not set(SECTION_5_1) & set(BEYOND_THE_PAPER)


def test_json_differs_for_different_configs() -> None:
    written = json.loads(Config(seed=3).to_json())
    assert written["seed"] == 3
    assert written["group"]["length"] == Config().group.length
    assert Config(seed=3).to_json() != Config(seed=4).to_json()


def test_longer_videos_train_the_first_keyframe_longer() -> None:
    iterations = [Config().for_video(frames).keyframe.first_iterations for frames in (0, 60, 150, 300, 10**6)]
    assert iterations == sorted(iterations)
    assert 1000 == iterations[0] < iterations[1] < iterations[2] < iterations[3] <= iterations[4] == 4000


def test_iterations_that_were_set_do_not_depend_on_the_video() -> None:
    config = changed(Config(), {"keyframe.first_iterations": 30})
    assert config.for_video(300) == config
