import dataclasses

import pytest

from bench.oracle_report import OracleReport, Score, SingleFrame
from splatreel.evaluation.evaluate import Quality

FRAMES = [
    SingleFrame(0, Score(Quality(30, 31, 0.9), None), Quality(29, 30, 0.89), 100, 2_000_000, 10.0, "cpu"),
    SingleFrame(
        15, Score(Quality(34, 35, 0.94), Quality(28, 29, 0.8)), Quality(33, 34, 0.93), 300, 4_000_000, 20.0, "cpu"
    ),
]
REEL = [Score(Quality(29.5, 30, 0.88), None), Score(Quality(31, 32, 0.9), Quality(23, 24, 0.7))]


def test_single_frame_round_trips_through_json() -> None:
    assert [SingleFrame.from_dict(dataclasses.asdict(frame)) for frame in FRAMES] == FRAMES


def test_report_computes_known_means_and_distances() -> None:
    report = OracleReport(FRAMES, REEL)
    assert report.mean() == Score(Quality(32, 33, pytest.approx(0.92)), Quality(28, 29, 0.8))  # pyright: ignore[reportArgumentType]
    assert report.decoded().psnr == 31
    assert report.distance() == {"whole": pytest.approx(1.75), "moving": pytest.approx(5.0)}
    record = report.reel_dict("a reel")
    assert record["distance"] == report.distance()
    assert [frame["distance"] for frame in record["frames"]] == [
        {"whole": 0.5, "moving": None},
        {"whole": 3, "moving": 5},
    ]


def test_report_tables_match_the_numbers() -> None:
    text = OracleReport(FRAMES, REEL).to_markdown()
    assert "| 0 | 30.00 | 31.00 |  | 0.9000 |  |  | 29.00 | 100 | 2.000 MB | 10.0 s |" in text
    assert "| mean | 32.00 | 33.00 |  | 0.9200 | 28.00 | 0.8000 | 31.00 | 200 | 3.000 MB | 15.0 s |" in text
    assert "| 15 | 34.00 | 31.00 | 3.00 | 0.9400 | 0.9000 | 28.00 | 23.00 | 5.00 |" in text
    assert "| mean | 32.00 | 30.25 | 1.75 | 0.9200 | 0.8900 | 28.00 | 23.00 | 5.00 |" in text
    assert "reel" not in OracleReport(FRAMES, []).to_markdown()
