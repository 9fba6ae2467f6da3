import pickle

import pytest

from splatreel.base.errors import CaptureError
from splatreel.run.machines.reports import INTERVAL, Noted, Reached, Reporter, describe_error


def test_progress_reports_are_limited_in_rate() -> None:
    now, sent = [0.0], []
    reporter = Reporter(3, sent.append, lambda: now[0])
    reporter.stage("first", 10, (0.2, 0.6))
    reporter.update(5)
    now[0] += INTERVAL
    reporter.update(5, psnr=29.0)
    reporter.note("a doubt")
    now[0] += INTERVAL
    reporter.stage("without a share", 4)
    assert [report for report in sent if isinstance(report, Noted)] == [Noted(3, "a doubt")]
    reached = [report for report in sent if isinstance(report, Reached)]
    assert [report.chapter for report in reached] == 3 * [3]
    assert [report.share for report in reached] == [0.2, pytest.approx(0.4), 0.6]
    assert pickle.loads(pickle.dumps(sent)) == sent


def test_unexpected_error_is_described_with_its_place() -> None:
    assert describe_error(CaptureError("cam00.mp4: is\n  damaged.")) == "cam00.mp4: is damaged."
    with pytest.raises(ZeroDivisionError) as caught:
        _ = 1 / 0
    assert describe_error(caught.value).startswith("ZeroDivisionError at test_reports.py:")
