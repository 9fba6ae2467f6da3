from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.run.steps import EXPOSURE
from tests.benchmarks.baselines.starts import SECONDS, write_start
from tests.evaluation import scenes


def test_baselines_start_from_the_cameras_images_and_points_of_our_run(tmp_path: Path) -> None:
    start = write_start(capture := scenes.capture(tmp_path), tmp_path / "run")
    assert start.rig.names == ["cam01", "cam02", "cam04"]
    np.testing.assert_array_equal(start.keyframe.means, scenes.truth(0).means)
    np.testing.assert_array_equal(start.training_images(2).pixels, capture.read(2, 1, start.rig.names))
    assert start.seconds == sum(SECONDS.values())
    assert start.shared_seconds == SECONDS["points"] + SECONDS["keyframe"]
    assert start.light(0, scenes.FRAMES) is None


def test_images_that_do_not_exist_are_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = write_start(capture := scenes.capture(tmp_path), tmp_path / "run")
    monkeypatch.setattr(capture, "missing", lambda *_: np.array([[False, True, False]]))
    images = start.training_images(1)
    assert images.unknown is not None
    assert images.unknown.shape == images.pixels.shape[:-1]
    assert images.unknown.all((0, 2, 3)).tolist() == [False, True, False]
    assert not images.unknown[0, [0, 2]].any()


def test_changes_of_exposure_are_removed_as_in_our_run(tmp_path: Path) -> None:
    start = write_start(capture := scenes.capture(tmp_path), tmp_path / "run")
    change = np.zeros((scenes.FRAMES, 3, 3), np.float32)
    change[1, 0] = np.log(0.5)
    light = np.zeros((scenes.FRAMES, 3), np.float32)
    light[2] = np.log(2.0)
    start.store.group(0).save(EXPOSURE.name, {"change": change, "light": light})
    plain, evened = capture.read(1, 1, start.rig.names)[0], start.training_images(1).pixels[0]
    dark = plain[0] < 120
    np.testing.assert_allclose(evened[0][dark], 2.0 * plain[0][dark], atol=1.5)
    np.testing.assert_array_equal(evened[1:], plain[1:])
    found = start.light(1, 2)
    assert found is not None
    np.testing.assert_allclose(found, [[1, 1, 1], [2, 2, 2]], rtol=1e-5)


def test_runs_without_a_first_keyframe_are_refused(tmp_path: Path) -> None:
    start = write_start(scenes.capture(tmp_path), tmp_path / "run")
    start.store.group(0).forget()
    with pytest.raises(UsageError, match="no first keyframe to start baselines from"):
        _ = start.keyframe
