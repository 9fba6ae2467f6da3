import pytest

from bench import step_timings
from bench.microbenchmarks import bench_codec, bench_kernels, cloud, front_camera
from bench.step_timings import step_rows
from splatreel.kernels.image import render_image


def test_cloud_fills_the_image() -> None:
    image = render_image(cloud(2000), front_camera(64, 48))
    lit = image.max(-1) > 0.02
    assert lit.mean() > 0.5


def test_timing_rows_state_their_subject() -> None:
    rows = bench_kernels(points=50, width=32, height=24, repeats=1)
    assert [row["what"] for row in rows] == ["render_image", "keyframe step", "group step"]
    assert all(float(rows[k][ratio]) > 0 for k, ratio in ((1, "one_thread"), (2, "undivided")))
    assert all(isinstance(row["ms"], float) and row["ms"] > 0 for row in rows)
    rows = bench_codec(points=40, frames=3, repeats=1)
    assert [row["what"] for row in rows] == ["encode a group", "decode a group"] * 2
    assert [row["codec"] for row in rows] == ["predictive"] * 2 + ["h265"] * 2
    assert all(isinstance(row["bytes"], int) and row["bytes"] > 40 for row in rows)


def test_ratios_compare_the_right_timings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_timings, "medians_ms", lambda works, repeats: [2.0, 7.0])
    keyframe, group = step_rows(cloud(40), front_camera(32, 24), 1)
    assert (keyframe["ms"], keyframe["one_thread"]) == (2.0, 3.5)
    assert (group["ms"], group["undivided"], group["points"], group["still"]) == (2.0, 3.5, 10, 30)
