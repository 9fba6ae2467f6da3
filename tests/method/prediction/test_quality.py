"""Expected quality of novel views, for rigs with good and with poor coverage."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Silent
from splatreel.capture.color import over_color
from splatreel.codec.reader import ReelReader
from splatreel.method.prediction import trial
from splatreel.method.prediction.quality import Coverage, cover
from splatreel.method.prediction.trial import Trial
from splatreel.run import pipeline, preparation
from splatreel.run.store import Store
from splatreel.scene.camera import Camera
from tests.method import corner
from tests.method.captures import WallCapture
from tests.method.scenes import look_at
from tests.method.small import small
from tests.notes import Notes


@pytest.fixture(autouse=True)
def few_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "ITERATIONS", 60)
    monkeypatch.setattr(trial, "POINTS", 2000)
    monkeypatch.setattr(trial, "TRIAL_WIDTH", 96)


def test_good_coverage_is_reported() -> None:
    cameras = corner.arc(5)
    found = cover(cameras, corner.make_images(cameras), progress=Silent())
    assert found.trial is not None
    assert found.trial.camera == "cam2", "the middle one is left out"
    assert found.trial.holds
    assert found.angle is None
    assert found.points > 100
    assert min(found.shared) > 20
    said = found.sentences()
    assert f"{found.trial.psnr:.0f} dB: 20 dB is poor, 30 dB is good" in said[-1]
    assert not any("hardly any" in sentence for sentence in said)


def test_cameras_that_have_nothing_in_common_are_told_that_new_views_will_be_unusable() -> None:
    cameras = corner.arc(4)
    noise = np.random.default_rng(0).integers(0, 256, (4, 12, 18, 3)).astype(np.uint8)
    images = noise.repeat(corner.HEIGHT // 12 + 1, 1).repeat(corner.WIDTH // 18 + 1, 2)
    found = cover(cameras, images[:, : corner.HEIGHT, : corner.WIDTH], progress=Silent())
    assert found.trial is not None
    assert not found.trial.holds
    assert found.angle is not None
    assert found.angle <= 10
    said = found.sentences()
    assert f"novel views more than {found.angle:.0f} degrees from a camera will not be usable" in said[-1]
    assert any("hardly any points in common with two other cameras: cam0" in sentence for sentence in said)


def test_no_trial_unless_asked_for() -> None:
    cameras = corner.arc(3)
    found = cover(cameras, corner.make_images(cameras), with_trial=False, progress=Silent())
    assert found.trial is None
    assert len(found.sentences()) == 2


def test_angles_are_measured_from_the_focus() -> None:
    cameras = [turned(degrees) for degrees in (0, 10, 25, 115)]
    found = cover(cameras, np.zeros((4, 32, 48, 3), np.uint8), with_trial=False, progress=Silent())
    assert found.angles == pytest.approx([10, 10, 15, 90], abs=0.5)
    assert "10 to 90 degrees from the nearest other one" in found.sentences()[0]
    assert "(cam115 is the farthest)" in found.sentences()[0]
    assert (found.points, found.shared) == (0, [0, 0, 0, 0])
    assert found.twins == []


def test_cameras_with_the_same_pose_are_named() -> None:
    cameras = [turned(degrees) for degrees in (0, 10, 25)]
    cameras.append(replace(cameras[1], name="copy"))
    found = cover(cameras, np.zeros((4, 32, 48, 3), np.uint8), with_trial=False, progress=Silent())
    assert found.twins == [["cam10", "copy"]]
    assert "cam10 and copy have the same pose" in found.sentences()[-1]


def turned(degrees: float) -> Camera:
    angle = np.radians(degrees)
    return replace(look_at([4 * np.sin(angle), 0, -4 * np.cos(angle)]), name=f"cam{degrees}")


def test_coverage_round_trips_through_json(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.coverage() is None
    found = Coverage(["a", "b", "c"], [1.0, 2.0, 1.0], [3, 4, 5], 6, Trial("b", 30.0, 11.2, 13.0, 9.5), [["a", "b"]])
    store.save_coverage(found)
    assert store.coverage() == found
    assert found.angle == 10
    (tmp_path / "coverage.json").write_text('{"names": []}')
    with pytest.raises(ReconstructionError, match="is damaged"):
        store.coverage()


def test_failed_trial_limits_the_views_of_the_reel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [camera.name for camera in WallCapture(1).cameras]
    failed = Coverage(names, [20.0] * 4, [0] * 4, 0, Trial(names[1], 14.0, 11.2, 13.0, 9.5))
    monkeypatch.setattr(preparation, "cover", lambda *_, **__: failed)
    angles = []
    for tried in (True, False):
        out, heard = tmp_path / str(tried), Notes()
        config = small({"check_coverage": tried})
        result = pipeline.reconstruct(WallCapture(1), out, config, device="cpu", progress=heard)
        limits = ReelReader(result.reel).manifest.presentation.limits
        assert limits is not None
        angles.append(limits.angle)
        assert any("more than 7 degrees" in line for line in heard.lines) == tried
        assert (out / "work" / "coverage.json").exists() == tried
    assert angles[0] == 7 < angles[1]


def test_room_behind_soft_edges_does_not_count_as_an_error_of_the_subject(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = corner.arc(3)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, cameras[0].height, cameras[0].width, 3)).astype(np.uint8)
    alpha = np.full(images.shape[:3], 100, np.uint8)  # soft everywhere
    alpha[:, :4] = 0
    small = trial.narrow_camera(cameras[1], trial.TRIAL_WIDTH)
    truth, mask = trial.resize_image(images[1], small), trial.resize_image(alpha[1], small)
    layout = SimpleNamespace(near=0.1, background=(0, 0, 0))
    monkeypatch.setattr(trial, "reconstruct_single_frame", lambda *_, **__: (None, layout))
    monkeypatch.setattr(trial, "middle_camera", lambda *_: 1)
    brightness = 1.0
    monkeypatch.setattr(trial, "render_image", lambda *_, **__: brightness * over_color(truth, mask, (0, 0, 0)) / 255)

    def tried() -> Trial:
        return trial.leave_one_out(cameras, images, np.zeros(3), None, None, None, Silent(), alpha)

    assert tried().psnr == trial.BEST
    brightness = 0.9
    assert tried().psnr < 40, "evaluate does not fit the exposure either"
