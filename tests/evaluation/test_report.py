import dataclasses
import json
from pathlib import Path

import pytest

from splatreel.errors import UsageError
from splatreel.evaluation.report import Quality, Report, megabytes

FIELDS = {
    "frames",
    "psnr_per_channel",
    "psnr",
    "psnr_undecoded",
    "flicker",
    "flicker_borders",
    "points_static",
    "peak_memory_bytes",
    "width",
    "device",
    "reel_bytes",
    "lpips",
    "first_view_bytes",
    "height",
    "ssim",
    "bytes_per_second",
    "points_dynamic",
    "seconds",
}


def report(**changes: object) -> Report:
    camera = {"name": "cam00", "psnr": 31.5, "psnr_per_channel": 31.6, "ssim": 0.95, "lpips": None}
    values = Report(
        psnr=31.5,
        psnr_per_channel=31.6,
        ssim=0.95,
        lpips=None,
        psnr_undecoded=31.52,
        flicker=0.8,
        flicker_borders=0.84,
        reel_bytes=2_500_000,
        first_view_bytes=900_000,
        bytes_per_second=1_250_000.0,
        seconds={"keyframe": 61.5, "group": 120.0},
        points_static=20_000.0,
        points_dynamic=4_000.0,
        peak_memory_bytes=1_600_000_000,
        device="cpu",
        frames=60,
        width=256,
        height=192,
        cameras=[camera],
        per_frame=[{"frame": 0, **{k: v for k, v in camera.items() if k != "name"}}],
    )
    return dataclasses.replace(values, **changes)


def test_report_round_trips_with_all_fields(tmp_path: Path) -> None:
    report().write(tmp_path)
    values = json.loads((tmp_path / "report.json").read_text())
    assert set(values) == FIELDS | {"cameras", "per_frame", "trained_on", "held_out", "coverage"}
    assert values["lpips"] is None
    assert Report.read(tmp_path / "report.json") == report()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.json", "report.md"]


def test_markdown_states_the_numbers() -> None:
    text = report().to_markdown()
    assert "31.50 dB (31.60 as the mean of channels)" in text
    assert "31.52 dB" in text
    assert "2.5 MB, 1.25 MB a second" in text
    assert "| cam00 | 31.50 | 0.9500 |  |  |" in text
    assert "off by 0.80 gray levels, 0.84 where groups meet" in text
    assert "0.80 gray levels |" in report(flicker_borders=None).to_markdown()
    assert "Flicker | not measured" in report(flicker=None).to_markdown()
    assert "before encoding | not measured" in report(psnr_undecoded=None).to_markdown()


def test_report_refuses_nan() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        report(psnr=float("nan")).to_json()


@pytest.mark.parametrize("content", ["{", "{}", '{"psnr": 1}', "[]"])
def test_foreign_report_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "report.json"
    path.write_text(content)
    with pytest.raises(UsageError, match=r"report\.json: .*not a report"):
        Report.read(path)


def test_quality_mean_averages_each_metric() -> None:
    a, b = Quality(30.0, 31.0, 0.9, 0.1), Quality(32.0, 33.0, 0.8, 0.3)
    mean = Quality.mean([a, b])
    assert dataclasses.astuple(mean) == pytest.approx((31.0, 32.0, 0.85, 0.2))
    assert Quality.mean([a, dataclasses.replace(b, lpips=None)]).lpips is None


def test_megabytes_formats_sizes() -> None:
    assert megabytes(2_500_000) == "2.5 MB"
    assert megabytes(1_234_567_890) == "1,235 MB"
