import pytest

from splatreel.base.errors import UsageError
from splatreel.config import Config, preset
from splatreel.config.presets import unusual_settings
from splatreel.config.setting_values import Needs, shown
from splatreel.config.settings import changed, parse_settings, settings, without_effect


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
    values = parse_settings(["group.length=3", "group.overlap=2", "encode.h265.crf_rotation=30", "seed=4"])
    config = changed(Config(), values)
    assert (config.group.length, config.group.overlap, config.seed) == (3, 2, 4)
    assert config.encode.h265.crf_rotation == 30
    assert changed(config, {name: settings()[name].of(Config()) for name in values}) == Config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("group.lambda_arap", "'group.lambda_arap' has no value. Write NAME=VALUE, such as group.lambda_arap=0."),
        (
            "group.lambda_arp=0",
            "'group.lambda_arp' is not a setting. Did you mean group.lambda_arap or group.lambda_sh or layering.lambda_nn? "
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
        ("layering.lambda_nn", {}, "layering.lift=vote. It needs layering.lift=optimize"),
        (
            "layering.lambda_dyn",
            {"layering.lift": "optimize", "layering.enabled": False},
            "layering.enabled=false. It needs layering.enabled=true",
        ),
        ("layering.flow", {"layering.enabled": False}, None),
        (
            "layering.flow",
            {"layering.enabled": False, "group.tracks": False},
            "layering.enabled=false and group.tracks=false. It needs layering.enabled=true or group.tracks=true",
        ),
        ("layering.adapt_gradient", {"layering.adapt_every": 0}, "layering.adapt_every=0"),
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
    mixed = changed(preset("paper"), {"encode.codec": "predictive", "layering.lambda_nn": 0.7})
    assert unusual_settings(mixed) == ["layering.lambda_nn"]
