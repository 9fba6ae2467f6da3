import pytest

from splatreel.evaluation.page.findings import Moment, failing_moments, findings
from tests.evaluation.test_report import report


def cameras(*values: float) -> list[dict]:
    return [{"name": f"cam{index:02d}", "psnr": value} for index, value in enumerate(values)]


def frames(*values: float) -> list[dict]:
    return [{"frame": 10 + index, "psnr": value} for index, value in enumerate(values)]


def test_the_first_sentence_rates_the_reel() -> None:
    assert findings(report(held_out=["cam00"]), 30)[0] == "Held-out cameras are rendered with 31.5 dB, which is good."
    text = " ".join(findings(report(held_out=[]), 30))
    assert "Training cameras are rendered" in text
    assert "novel views was not measured" in text


def test_a_good_reel_has_nothing_else_to_say() -> None:
    even = report(held_out=["cam00"], cameras=cameras(31, 31.5, 30), per_frame=frames(31, 31.2, 30.9, 31))
    assert len(findings(even, 30)) == 1


@pytest.mark.parametrize("values", [(31.0, 27.0), (31.0, 31.5, 27.0, 32.0)])
def test_a_camera_that_stands_out_is_named(values: tuple[float, ...]) -> None:
    found = [text for text in findings(report(cameras=cameras(*values)), 30) if text.startswith("Camera ")]
    assert len(found) == 1
    assert f"cam{values.index(27.0):02d} is 4" in found[0]


def test_moments_that_fail_are_joined_and_named_with_their_time() -> None:
    low = report(per_frame=frames(31, 31, 28, 30.9, 27, 31, 31, 31, 31, 31, 31, 31, 28.5, 31, 31))
    assert failing_moments(low) == [Moment(12, 14, 4.0), Moment(22, 22, 2.5)]
    texts = findings(low, 30)
    assert any("Frames 12 to 14 (from 0.40 s) are up to 4.0 dB below" in text for text in texts)
    assert any("Frame 22 (from 0.73 s) is 2.5 dB below" in text for text in texts)
    assert failing_moments(report(per_frame=frames(31, 20))) == []


def test_motion_flicker_and_compression_are_named_with_their_numbers() -> None:
    bad = report(moving={"psnr": 21.0}, flicker=0.8, flicker_borders=1.6, psnr_undecoded=32.0)
    text = " ".join(findings(bad, 30))
    assert "Moving parts are rendered with 21.0 dB, which is poor" in text
    assert "flicker by 1.60 gray levels there, otherwise by 0.80" in text
    assert "Compression costs 0.50 dB" in text


def test_the_lowest_cameras_are_named() -> None:
    first = findings(report(cameras=cameras(31, 30.2, 30.5, 31, 32)), 30)[0]
    assert first.endswith("; lowest: cam01 (30.2 dB), cam02 (30.5 dB).")
    assert "lowest" not in findings(report(cameras=cameras(31)), 30)[0]


def test_a_fall_over_time_is_named() -> None:
    falling = [32.5 - 2.4 * i / 59 + 0.1 * (i % 3) for i in range(60)]
    text = " ".join(findings(report(per_frame=frames(*falling)), 30))
    assert (
        "The PSNR falls over time: the median is 32.3 dB in the first quarter of the frames and 30.5 dB in the last"
        in text
    )
    for even in (falling[::-1], [31 + 0.5 * (i % 2) for i in range(60)], [32.0] * 30 + [30.0] * 10 + [32.0] * 20):
        assert "falls over time" not in " ".join(findings(report(per_frame=frames(*even)), 30))
