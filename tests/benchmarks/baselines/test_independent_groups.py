from pathlib import Path

import numpy as np
import pytest

from baselines.independent_groups import Stretch, run_independent_groups
from splatreel.base.progress import Silent
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.evaluate import uncompressed_frames
from splatreel.play.timeline import Timeline
from splatreel.scene.group import GroupSpan
from splatreel.scene.reel_source import ReelSource
from tests.evaluation import scenes
from tests.method.captures import WallCapture
from tests.method.small import small


def test_stretch_reads_the_frames_of_its_span(tmp_path: Path) -> None:
    source = scenes.capture(tmp_path)
    stretch = Stretch(source, GroupSpan(1, 2, 2, 3))
    assert stretch.frames == 3
    np.testing.assert_array_equal(stretch.read(1, 2, ["cam01"]), source.read(3, 2, ["cam01"]))
    assert stretch.fingerprint() != source.fingerprint()
    later = scenes.capture(tmp_path, first=20, end=25)
    assert Stretch(later, GroupSpan(1, 2, 2, 3)).reel_source() == ReelSource(22, ("cam00", "cam03"))


@pytest.mark.slow
def test_groups_are_chained_without_layers(tmp_path: Path) -> None:
    config, capture = small({"group.length": 3, "keyframe.first_iterations": 10}), WallCapture(6, speed=0.05)
    seconds, device = run_independent_groups(capture, tmp_path, config, "cpu", Silent())
    manifest = ReelReader(tmp_path / "reel").manifest
    assert [(g.first_frame, g.frames) for g in manifest.groups] == [(0, 4), (3, 3)]
    assert not manifest.layers
    assert all(g.points > 50 for g in manifest.groups)
    assert (manifest.group_length, manifest.overlap) == (3, 1)
    assert seconds["keyframe"] > 0
    assert device == "cpu"
    trained, decoded = (
        uncompressed_frames(tmp_path / "work", tmp_path / "reel")(5),
        Timeline(ReelReader(tmp_path / "reel")),
    )
    assert trained.means.mean(0) == pytest.approx(decoded.at(5 / decoded.fps).means.mean(0), abs=0.02)
    assert run_independent_groups(capture, tmp_path, config, "cpu", Silent()) == (seconds, "cpu")
