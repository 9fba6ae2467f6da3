"""The page of `capture check`: verdict, notes, drawings, table and images."""

import re
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.opening import open_capture
from splatreel.capture.sidecar import SyncEvidence, write_starts
from splatreel.cli.main import main
from splatreel.evaluation.page.check_page import CheckFacts, check_page
from splatreel.method.prediction.quality import Coverage
from splatreel.scene.camera import facing
from tests.capture import folders
from tests.evaluation.page.test_report_page import parse


def facts(folder: Path, **changes: object) -> CheckFacts:
    with_held_out = open_capture(folders.neu3dv(folder / "a <b> capture"))
    images = with_held_out.read(0, 1, [camera.name for camera in with_held_out.cameras])[0]
    names = [camera.name for camera in with_held_out.training_cameras]
    pairs = np.array([[1200, 300, 0], [300, 1200, 7], [0, 7, 1200]])
    coverage = Coverage(names, [12.5 + c for c in range(3)], [900 + c for c in range(3)], 1234, pairs=pairs)
    given = {
        "capture": with_held_out,
        "images": images,
        "sentences": ["a <doubt>"],
        "verdict": "It can be. Run\n  splatreel x",
    }
    return CheckFacts(**(given | {"coverage": coverage} | changes))  # pyright: ignore[reportArgumentType]


def test_page_shows_verdict_rig_table_and_all_images(tmp_path: Path) -> None:
    found = facts(tmp_path)
    page = check_page(found)
    parse(page)
    assert "<li>It can be. Run</li><li><code>splatreel x</code></li>" in page
    assert "a &lt;doubt&gt;" in page
    assert "a &lt;b&gt; capture" in page
    assert page.count("<svg") == 2
    assert page.count("data:image/jpeg") == len(found.capture.cameras)
    assert "<td>12.5</td><td>900</td><td>cam02 300</td>" in page
    assert "<td>cam01 300, cam03 7</td>" in page
    assert "<li>the cameras with the fewest points" not in page, "of three cameras"
    assert page.count('class="link" opacity="1.00"') == 2, "in plan and elevation"
    assert page.count('class="link" opacity="0.07"') == 2
    assert "Synchronization" not in page
    held_out = found.capture.held_out[0]
    assert re.search(rf"{held_out}</th><td>held out</td><td></td><td></td><td></td>", page)


def test_plan_has_two_lines_a_camera_and_the_weakest_cameras_are_named(tmp_path: Path) -> None:
    cameras = [facing(f"c{i:02d}", np.array([i, 0.0, 0]), np.array([0.0, 0, 1]), 50.0, 64, 48) for i in range(12)]
    apart = np.abs(np.arange(12)[:, None] - np.arange(12))
    coverage = Coverage(
        [camera.name for camera in cameras], [5.0] * 12, [500 - 10 * c for c in range(12)], 900, pairs=1000 - 50 * apart
    )
    capture = copy(facts(tmp_path).capture)
    capture.cameras, capture.held_out = cameras, []
    page = check_page(CheckFacts(capture, np.full((12, 48, 64, 3), 100, np.uint8), [], "It can be.", coverage))
    assert page.count('class="link"') <= 2 * 2 * 12
    assert "the cameras with the fewest points in common with others: c11 (390), c10 (400), c09 (410)" in page


def test_masks_are_shown_with_the_share_of_the_subject(tmp_path: Path) -> None:
    found = facts(tmp_path)
    assert 'id="masks"' not in check_page(found)
    cameras, height, width = found.images.shape[:3]
    masks = np.zeros((cameras, height, width), np.uint8)
    masks[1, :, : width // 2] = 255
    page = check_page(replace(found, masks=masks))
    parse(page)
    assert page.count("data:image/jpeg") == 2 * len(masks)
    assert "cam01: 50.0%" in page
    assert "cam02: 0.0%" in page


def test_cameras_of_other_brightness_are_named(tmp_path: Path) -> None:
    images = np.full((4, 48, 64, 3), 100, np.uint8)
    images[2] = 150
    page = check_page(facts(tmp_path, images=images, coverage=None))
    assert "brighter or darker than most cameras by 25% or more: cam02<" in page


def test_start_times_are_shown_with_their_evidence(tmp_path: Path) -> None:
    found = facts(tmp_path)
    starts = {"cam00": 0.0, "cam01": 0.4567, "cam02": 1.0, "cam03": 2.0}
    evidence = {"cam01": SyncEvidence("cam00", "sound", 5.25, 2.0), "cam02": SyncEvidence("cam00", "timecode")}
    write_starts(found.capture.path, starts, evidence)
    page = check_page(found)
    assert "cam01</th><td>0.457</td><td>cam00</td><td>sound</td><td>5.2 times (2.0 is needed)</td>" in page
    assert "cam02</th><td>1.000</td><td>cam00</td><td>timecode</td><td></td>" in page
    assert "cam03</th><td>2.000</td><td></td><td></td><td></td>" in page


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
