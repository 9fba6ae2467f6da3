"""Evaluation of a reel, and the quality of its images."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import UsageError
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.evaluate import ImageComparison, Quality, check_same_capture, choose_frames, evaluate
from splatreel.evaluation.metrics import Moments, dssim, psnr, psnr_color_fitted, psnr_per_channel, ssim, ssim_skimage
from splatreel.evaluation.perceptual import Lpips, LpipsDistances
from splatreel.evaluation.report import Report
from tests.any_threads import assert_same_on_any_threads
from tests.evaluation import scenes, small_lpips


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scenes.write_reel(tmp_path_factory.mktemp("evaluate") / "reel")


def test_good_reel_scores_high_with_a_complete_report(reel: Path, tmp_path: Path) -> None:
    report = evaluate(
        reel,
        scenes.capture(tmp_path),
        out=tmp_path / "out",
        undecoded=scenes.truth,
        seconds={"keyframe": 12.5},
        device="cpu",
    )
    assert report.psnr_undecoded is not None
    assert report.flicker is not None
    assert 40 < report.psnr < report.psnr_undecoded
    assert report.psnr_undecoded > 55  # only the rounding to 8 bits is between them
    assert report.psnr_per_channel >= report.psnr
    assert 0 < report.flicker < 2
    assert report.flicker_borders is None
    assert 0.99 < report.ssim <= 1
    assert (report.frames, report.width, report.height) == (scenes.FRAMES, scenes.WIDTH, scenes.HEIGHT)
    assert (report.points_static, report.points_dynamic) == (90, 200)
    assert report.reel_bytes == sum(p.stat().st_size for p in reel.rglob("*") if p.is_file())
    assert report.first_view_bytes == report.reel_bytes  # one group: the first image needs all
    assert (report.total_bytes, report.start_bytes) == (report.reel_bytes, report.first_view_bytes)
    assert report.bytes_per_second == report.reel_bytes / (scenes.FRAMES / 30)
    assert 0 < (report.playing_bytes_per_second or 0) < report.bytes_per_second
    assert report.psnr < (report.psnr_color_fitted or 0) < report.psnr + 1
    assert set(report.seconds) == {"keyframe", "evaluate"}
    assert [c["name"] for c in report.cameras] == report.held_out == ["cam00", "cam03"]
    assert report.trained_on == ["cam01", "cam02", "cam04"]
    assert "Held-out cameras" in report.to_markdown()
    assert [f["frame"] for f in report.per_frame] == list(range(scenes.FRAMES))
    assert np.mean([c["psnr"] for c in report.cameras]) == pytest.approx(report.psnr)
    assert np.mean([f["psnr"] for f in report.per_frame]) == pytest.approx(report.psnr)
    assert Report.read(tmp_path / "out" / "report.json") == report
    image = Image.open(tmp_path / "out" / "pictures" / "cam03.png")
    assert image.size == (3 * scenes.WIDTH, scenes.HEIGHT)


def test_report_is_the_same_on_any_threads(reel: Path, tmp_path: Path) -> None:
    source = scenes.capture(tmp_path)

    def report() -> Report:
        found = evaluate(reel, source, lpips_every=0, undecoded=scenes.truth)
        return replace(found, seconds={}, render_fps=0.0, decode_ms_per_frame=0.0, peak_memory_bytes=0)

    assert_same_on_any_threads(report)


def test_report_measures_motion_bytes_and_speed(reel: Path, tmp_path: Path) -> None:
    report = evaluate(reel, scenes.capture(tmp_path), lpips_every=0)
    assert report.moving is not None
    assert report.moving["psnr"] is not None
    assert 0 < report.moving["psnr"] < report.psnr  # the background of this scene is empty
    assert report.moving_share is not None
    assert 0 < report.moving_share < 1
    assert sum(report.bytes_by_kind.values()) == report.reel_bytes
    assert report.bytes_by_kind["static points"] > 0
    assert report.bytes_by_kind["motion"] > 0
    assert report.decode_ms_per_frame is not None
    assert report.decode_ms_per_frame > 0
    assert report.render_fps is not None
    assert report.render_fps > 0
    assert (report.lpips_frames, report.lpips) == (0, None)


@pytest.mark.parametrize(("every", "measured"), [(1, [0, 1, 2, 3, 4]), (2, [0, 2, 4]), (10, [0])])
def test_lpips_is_measured_at_every_nth_frame(
    reel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: int, measured: list[int]
) -> None:
    small_lpips.install_port(tmp_path / "site", monkeypatch)
    report = evaluate(reel, scenes.capture(tmp_path), cameras=["cam00"], lpips_every=every)
    assert [f["frame"] for f in report.per_frame if f["lpips"] is not None] == measured
    assert report.lpips_frames == len(measured)
    values = [f["lpips_alex"] for f in report.per_frame if f["lpips_alex"] is not None]
    assert report.lpips_alex == pytest.approx(np.mean(values))
    assert "LPIPS (AlexNet)" in report.to_markdown()


class Mirrored(scenes.FilmedCapture):
    """Capture of the mirrored scene."""

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        super()._read_into(out, first, cameras)
        out[:] = out[:, :, :, ::-1].copy()


def test_wrong_image_scores_low(reel: Path, tmp_path: Path) -> None:
    true = scenes.capture(tmp_path)
    wrong = Mirrored(tmp_path, true.cameras, held_out=true.held_out, frame_range=(0, scenes.FRAMES), fps=30)
    good, bad = evaluate(reel, true, frames=[0]), evaluate(reel, wrong, frames=[0])
    assert bad.psnr < good.psnr - 10
    assert bad.ssim < good.ssim - 0.1


def test_frames_and_cameras_can_be_chosen(reel: Path, tmp_path: Path) -> None:
    report = evaluate(reel, scenes.capture(tmp_path), cameras=["cam02"], frames=[4, 0])
    assert report.frames == 2
    assert [c["name"] for c in report.cameras] == ["cam02"]
    assert (report.trained_on, report.held_out) == (["cam01", "cam02", "cam04"], [])
    assert report.psnr_undecoded is None
    whole = evaluate(reel, scenes.capture(tmp_path), cameras=["cam02"])
    assert [f for f in whole.per_frame if f["frame"] in (0, 4)] == report.per_frame


def test_report_names_training_views(reel: Path, tmp_path: Path) -> None:
    """A reel made with `--hold-out none` was trained on the cameras that the capture would hold out."""
    report = evaluate(reel, scenes.capture(tmp_path, held_out=["cam01", "cam02"]), frames=[0], out=tmp_path)
    assert report.held_out == []
    text = (tmp_path / "report.md").read_text()
    assert "Training views, rendered from the decoded reel" in text
    assert "Held-out" not in text
    partly = evaluate(reel, scenes.capture(tmp_path, held_out=["cam01", "cam03"]), frames=[0])
    assert [c["name"] for c in partly.cameras] == partly.held_out == ["cam03"]
    with pytest.raises(UsageError, match=r"trained on cam01 and not on the others. Evaluate one kind"):
        evaluate(reel, scenes.capture(tmp_path), cameras=["cam00", "cam01"])


def test_camera_with_corrected_pose_still_matches(tmp_path: Path) -> None:
    many = [replace(c, name=f"cam{i}") for i, c in enumerate(scenes.cameras()[1:])]
    manifest = ReelReader(scenes.write_reel(tmp_path / "reel")).manifest
    capture = scenes.FilmedCapture(tmp_path, many, held_out=[], frame_range=(0, 1))
    turned = replace(many[1], viewmat=many[1].viewmat + 0.01)
    check_same_capture(replace(manifest, cameras=(many[0], turned, *many[2:])), capture, "reel")
    wrong = replace(manifest, cameras=(replace(many[0], viewmat=many[0].viewmat + 0.01), turned, *many[2:]))
    with pytest.raises(UsageError, match="made with a camera 'cam0'"):
        check_same_capture(wrong, capture, "reel")


def test_invalid_requests_are_refused(reel: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no camera is held out"):
        evaluate(reel, scenes.capture(tmp_path, held_out=[]))
    with pytest.raises(UsageError, match=r"\[5\].*0 to 4"):
        evaluate(reel, scenes.capture(tmp_path), frames=[0, 5])
    other = scenes.capture(tmp_path)
    other.cameras = [replace(c, viewmat=np.eye(4)) for c in other.cameras]
    with pytest.raises(UsageError, match="Give the capture that the reel was made from"):
        evaluate(reel, other)


def test_report_file_is_valid_json(reel: Path, tmp_path: Path) -> None:
    evaluate(reel, scenes.capture(tmp_path), out=tmp_path, frames=[2])
    values = json.loads((tmp_path / "report.json").read_text())
    assert values["lpips"] is None or 0 <= values["lpips"] <= 1
    assert values["peak_memory_bytes"] > 10_000_000


def test_choose_frames_uses_the_reels_range() -> None:
    assert choose_frames(5, None) == [0, 1, 2, 3, 4]
    assert choose_frames(5, None, 3) == [3, 4]
    assert choose_frames(5, [4, 3, 4], 3) == [3, 4]
    with pytest.raises(UsageError, match=r"Frames \[2\] cannot be evaluated: reel and capture share frames 3 to 4"):
        choose_frames(5, [2, 4], 3)
    with pytest.raises(UsageError, match="Frames none"):
        choose_frames(3, None, 3)


REAL_MOMENTS = Moments.of


class FakeLpips(Lpips):
    """Mean absolute difference in place of a network."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def distances(self, image: np.ndarray, truth: np.ndarray, shifted: bool = True) -> LpipsDistances:
        scale = self.factor if shifted else self.factor / 2
        return LpipsDistances([scale * np.abs(image - truth).mean(-1)])


LPIPS: Mapping[str, Lpips] = {"alex": FakeLpips(1), "vgg": FakeLpips(2)}


def test_mean_averages_each_metric() -> None:
    a, b = Quality(30.0, 31.0, 0.9, 0.1, 0.2, 0.8, 0.1, 0.05), Quality(32.0, 33.0, 0.8, 0.3, 0.4, 0.6, 0.2, 0.15)
    assert dataclasses.astuple(Quality.mean([a, b]))[:8] == pytest.approx((31.0, 32.0, 0.85, 0.2, 0.3, 0.7, 0.15, 0.1))
    assert Quality.mean([a, dataclasses.replace(b, lpips=None)]).lpips == 0.1
    assert Quality.mean([Quality(1, 1, 1)]).lpips is None


def test_measure_fills_all_metrics_of_an_image_and_of_its_masked_part() -> None:
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32) * 0.8
    image = truth.copy()
    image[:20] += 0.1
    upper = np.arange(40)[:, None].repeat(40, 1) < 20
    compared = ImageComparison(image, truth, LPIPS)
    whole, masked = compared.quality(), compared.quality(upper)
    assert all(value is not None for value in dataclasses.astuple(whole))
    assert (masked.psnr, masked.lpips_alex, masked.lpips) == pytest.approx((20, 0.1, 0.2), abs=1e-4)
    assert (whole.lpips_alex, whole.lpips) == pytest.approx((0.05, 0.1), abs=1e-4)
    assert whole.ssim_skimage == ssim_skimage(image, truth)
    one, two, upper_one = (float(value or 0) for value in (whole.dssim1, whole.dssim2, masked.dssim1))
    assert one == pytest.approx((1 - float(whole.ssim_skimage or 0)) / 2)
    assert 0 < two < one < upper_one
    assert (masked.lpips_3dgs, whole.lpips_3dgs) == pytest.approx((0.1, 0.05), abs=1e-4)
    assert ImageComparison(image, truth, {}).quality().lpips is None
    assert whole.psnr == psnr(image, truth)
    assert masked.psnr_per_channel == psnr_per_channel(image, truth, upper)
    assert (whole.ssim, masked.ssim) == (ssim(image, truth), ssim(image, truth, upper))
    assert whole.dssim2 == dssim(ssim_skimage(image, truth, data_range=2.0))
    assert whole.psnr_color_fitted == psnr_color_fitted(image, truth)


def test_each_pair_is_filtered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The masks and both data ranges share the maps of a Gaussian and of a uniform window."""
    calls = []
    monkeypatch.setattr(Moments, "of", lambda *given: calls.append(given) or REAL_MOMENTS(*given))
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32)
    compared = ImageComparison(truth * 0.5, truth, {})
    for where in (None, truth[..., 0] > 0.5, truth[..., 1] > 0.5):
        compared.quality(where)
    assert len(calls) == 2


def test_colors_of_a_camera_do_not_count_for_fitted_psnr() -> None:
    """The gains are those of the whole image, so that a masked part cannot hide its own errors."""
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32) * 0.8
    image = truth * np.array([0.8, 0.9, 1.1], np.float32)
    upper = np.arange(40)[:, None].repeat(40, 1) < 20
    found = ImageComparison(image, truth, {}).quality(upper)
    assert found.psnr < 25
    assert float(found.psnr_color_fitted or 0) > 80
    image[:20] *= 0.5
    assert float(ImageComparison(image, truth, {}).quality(upper).psnr_color_fitted or 0) < 20
    assert ImageComparison(image, truth, {}, upper).quality(upper).psnr_color_fitted > 80  # the masks of a subject
    within = ImageComparison(np.zeros_like(truth), truth, {}).quality()
    assert within.psnr_color_fitted == within.psnr  # a black image has no gain
