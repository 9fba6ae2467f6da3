"""A reel with several renditions: written together, read one at a time."""

from dataclasses import fields

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.config import COARSENESS, EncodeConfig
from splatreel.play.timeline import open_reel
from tests.codec.reels import new_group, new_writer, points
from tests.golden import write_golden

RATES = ("high", "medium", "low")


@pytest.fixture(scope="module")
def reel(tmp_path_factory):
    path = tmp_path_factory.mktemp("renditions") / "reel"
    write_golden(path, "predictive", RATES)
    return path


def test_each_rendition_is_encoded_at_its_rate(reel):
    manifest = ReelReader(reel).manifest
    assert manifest.renditions == RATES
    sizes = list(manifest.rendition_bytes().values())
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 3
    steps = {}
    for name in RATES:
        reader = ReelReader(reel, name)
        assert reader.manifest.renditions == ()
        _, sections = unpack_file(reader.read_file(reader.manifest.groups[0]))
        steps[name] = sections["shapes"].parameters["step"]
    assert steps["low"] / steps["high"] == pytest.approx(COARSENESS["low"] / COARSENESS["high"])
    _, sections = unpack_file(reader.read_file(manifest.layers[0]))
    assert sections["shapes"].parameters["step"] == steps["high"]


def test_best_rendition_is_the_default(reel):
    found, best = open_reel(reel).at(0.2), open_reel(reel, "high").at(0.2)
    assert all(np.array_equal(getattr(found, f.name), getattr(best, f.name)) for f in fields(best) if f.name != "fade")
    low = open_reel(reel, "low").at(0.2)
    assert len(low) == len(best)
    assert np.abs(np.sort(low.means[:, 0]) - np.sort(best.means[:, 0])).max() < 0.02
    assert (low.means != best.means).any()


def test_missing_rendition_is_named(reel):
    with pytest.raises(ReelError, match=r"manifest\.json: has no rendition 'best'; it has high, medium, low"):
        ReelReader(reel, "best")


def test_verify_reads_all_renditions(reel):
    found = verify_reel(reel)
    assert (found.files, found.groups, found.layers) == (9, 2, 2)
    assert found.bytes == sum(file.stat().st_size for file in reel.glob("*/*"))


def test_verify_finds_damage_in_any_rendition(reel, tmp_path):
    write_golden(tmp_path / "reel", "predictive", RATES)
    file = tmp_path / "reel" / "groups" / "0001.low.safetensors"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ReelError, match=r"groups/0001\.low\.safetensors: has"):
        verify_reel(tmp_path / "reel")


def test_resume_keeps_groups_intact_in_all_renditions(tmp_path):
    config = EncodeConfig(renditions=("high", "low"))
    writer = new_writer(tmp_path, config=config)
    for index in range(2):
        writer.add_group(new_group(index, 15, 0))
    (tmp_path / "groups" / "0001.low.safetensors").unlink()
    assert len(new_writer(tmp_path, config=config, resume=True).manifest.groups) == 1
    assert sorted(file.name for file in (tmp_path / "groups").iterdir()) == ["0000.low.safetensors", "0000.safetensors"]
    assert new_writer(tmp_path, config=EncodeConfig(), resume=True).manifest.groups == ()
    assert list((tmp_path / "groups").iterdir()) == []


def test_layers_use_the_best_rendition(tmp_path):
    born = points(30)
    one, _ = new_writer(tmp_path / "one", config=EncodeConfig(coarseness=0.3)).add_layer(0, 0, born)
    both, _ = new_writer(tmp_path / "both", config=EncodeConfig(renditions=("high", "low"))).add_layer(0, 0, born)
    assert (one.means == both.means).all()
