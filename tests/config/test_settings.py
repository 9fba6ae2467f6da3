import pytest

from splatreel.base.errors import UsageError
from splatreel.config import Config
from splatreel.config.settings import changed, parse_settings, settings


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
