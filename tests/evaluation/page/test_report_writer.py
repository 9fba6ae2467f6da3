from pathlib import Path
from types import SimpleNamespace
from typing import Any

from splatreel.base.progress import Silent
from splatreel.evaluation.page.report_writer import LEAST_SECONDS, ReportWriter
from tests.evaluation import scenes

WRITER: Any = SimpleNamespace()


class Notes(Silent):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def note(self, text: str) -> None:
        self.texts.append(text)


def test_page_follows_the_run_at_a_limited_pace(tmp_path: Path) -> None:
    out, calls, now = scenes.write_run(tmp_path), [], [0.0]
    report = ReportWriter(out, lambda _, group: calls.append(group), Silent(), lambda: now[0])
    page = out / "report.html"
    report(WRITER, 0)
    assert "<iframe" not in page.read_text()
    page.unlink()
    report(WRITER, 1)
    assert not page.exists()  # too early
    now[0] = LEAST_SECONDS
    report(WRITER, 2)
    assert page.exists()
    page.unlink()
    report(WRITER, None)
    assert not page.exists()
    report.finish()
    assert "<iframe" in page.read_text()
    assert calls == [0, 1, 2, None]


def test_a_page_that_cannot_be_written_does_not_stop_the_run(tmp_path: Path) -> None:
    out, notes = scenes.write_run(tmp_path), Notes()
    (out / "report.html").mkdir()
    report = ReportWriter(out, lambda *_: None, notes)
    report(WRITER, 0)
    report.finish()
    assert len(notes.texts) == 1
    assert "report.html cannot be written" in notes.texts[0]


def test_without_a_reel_there_is_no_page(tmp_path: Path) -> None:
    ReportWriter(tmp_path, lambda *_: None, Silent()).finish()
    assert list(tmp_path.iterdir()) == []
