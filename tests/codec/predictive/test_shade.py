"""Changes of color and opacity round trip in both codecs."""

import dataclasses

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, encode_group
from splatreel.codec.predictive.precision import STEPS
from splatreel.config import EncodeConfig
from tests.codec.predictive.groups import CONFIG, group
from tests.golden import random_shade


@pytest.mark.parametrize("codec", ["predictive", "h265"])
def test_shade_round_trips(codec):
    before = dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12))
    data, order = encode_group(before, EncodeConfig(codec=codec), None)
    after = decode_group(data, "x")
    step = STEPS.shade * CONFIG.coarseness
    assert after.shade is not None
    np.testing.assert_allclose(after.shade, before.shade[:, order], atol=step)
    assert not np.allclose(after.at(3).opacities, after.at(0).opacities, atol=0.05)


def test_shade_of_wrong_size_is_refused():
    data, _ = encode_group(dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12)), CONFIG)
    header, sections = unpack_file(data)
    sections["shade"] = dataclasses.replace(sections["shade"], data=sections["shade"].data[:-3])
    with pytest.raises(ReelError, match="'shade'"):
        decode_group(pack_file(header, sections), "x")
