"""The page of `capture check`: verdict, notes, drawings, table and pictures."""

import re
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.opening import open_capture
from splatreel.cli.main import main
from splatreel.evaluation.page.check_page import CheckFacts, check_page
from splatreel.recon.coverage.coverage import Coverage
from tests.capture import folders
from tests.evaluation.page.test_report_page import parse


def facts(folder: Path, **changes: object) -> CheckFacts:
    with_held_out = open_capture(folders.neu3dv(folder / "a <b> capture"))
    images = with_held_out.read(0, 1, [camera.name for camera in with_held_out.cameras])[0]
    names = [camera.name for camera in with_held_out.training_cameras]
    coverage = Coverage(names, [12.5 + c for c in range(len(names))], [900 + c for c in range(len(names))], 1234)
    given = {
        "capture": with_held_out,
        "images": images,
        "sentences": ["a <doubt>"],
        "verdict": "It can be. Run\n  splatreel x",
    }
    return CheckFacts(**(given | {"coverage": coverage} | changes))  # pyright: ignore[reportArgumentType]


def test_page_shows_verdict_rig_table_and_all_pictures(tmp_path: Path) -> None:
    found = facts(tmp_path)
    page = check_page(found)
    parse(page)
    assert "<li>It can be. Run</li><li><code>splatreel x</code></li>" in page
    assert "a &lt;doubt&gt;" in page
    assert "a &lt;b&gt; capture" in page
    assert page.count("<svg") == 2
    assert page.count("data:image/jpeg") == len(found.capture.cameras)
    assert "<td>12.5</td><td>900</td>" in page
    held_out = found.capture.held_out[0]
    assert re.search(rf"{held_out}</th><td>held out</td><td></td><td></td>", page)


def test_cameras_of_other_brightness_are_named(tmp_path: Path) -> None:
    images = np.full((4, 48, 64, 3), 100, np.uint8)
    images[2] = 150
    page = check_page(facts(tmp_path, images=images, coverage=None))
    assert "brighter or darker than most cameras by 25% or more: cam02<" in page


def test_check_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture, page = folders.neu3dv(tmp_path / "capture"), tmp_path / "check.html"
    main(["capture", "check", str(capture), "--quick", "--page", str(page)])
    said = capsys.readouterr()
    text = page.read_text()
    parse(text)
    assert f"page: {page}" in said.out
    sentence = next(line.strip() for line in said.out.splitlines() if "degrees from the nearest other one" in line)
    assert sentence in text
    assert "novel views" in text or "Do not reconstruct it as it is" in text
