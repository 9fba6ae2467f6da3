"""Sections of a group file."""

import dataclasses

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, encode_group
from splatreel.config import EncodeConfig
from tests.codec.reels import new_group

LIGHT = np.geomspace((1, 1, 1), (0.3, 2, 5), 3, dtype=np.float32)


@pytest.mark.parametrize("dynamic", [0, 15])
def test_light_round_trips(dynamic: int) -> None:
    group = dataclasses.replace(new_group(0, dynamic, 20), light=LIGHT)
    data, _ = encode_group(group, EncodeConfig())
    decoded = decode_group(data, "a file").light
    assert decoded is not None
    np.testing.assert_allclose(decoded, LIGHT, rtol=1e-3)


def test_constant_light_takes_no_bytes() -> None:
    data, _ = encode_group(new_group(0, 15, 20), EncodeConfig())
    assert "light" not in unpack_file(data)[1]
    assert decode_group(data, "a file").light is None


@pytest.mark.parametrize(
    "change",
    [
        {"max": [1.0, 1.0, 20.0]},
        {"min": [-20.0, 0.0, 0.0]},
        {"min": [0.0, 0.0]},
        {"codec": "fluorescent"},
        {"bits": 13},
        {"max": [1.0, 1.0, float(10**30)]},
    ],
)
def test_invalid_light_is_refused(change: dict) -> None:
    data, _ = encode_group(dataclasses.replace(new_group(0, 0, 20), light=LIGHT), EncodeConfig())
    header, sections = unpack_file(data)
    section = sections["light"]
    sections["light"] = dataclasses.replace(section, parameters=section.parameters | change)
    with pytest.raises(ReelError, match=r"^a file: section 'light'"):
        decode_group(pack_file(header, sections), "a file")
