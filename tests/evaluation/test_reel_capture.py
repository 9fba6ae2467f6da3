"""The frames and cameras that a reel is compared with."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import UsageError
from splatreel.capture import opening
from splatreel.codec.reader import ReelReader
from splatreel.edit.clip_writer import write_clip
from splatreel.edit.operations import apply_operations
from splatreel.edit.reel_clip import ReelClip
from splatreel.evaluation.evaluate import evaluate
from splatreel.evaluation.reel_capture import open_reel_capture, work_of
from splatreel.scene.reel_source import ReelSource
from tests.evaluation import scenes

BEGIN = 20
"""Frame of the capture that the reel begins with."""
SOURCE = ReelSource(BEGIN, ("cam03",), ("cam09",))


class LaterCapture(scenes.FilmedCapture):
    begin = BEGIN


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Open captures of 60 frames whose default held-out cameras are others than those of the reel."""
    found = []

    def open_capture(path: Path, **request: Any) -> LaterCapture:
        found.append(request)
        held_out = request["held_out"] if request["held_out"] is not None else ["cam01"]
        frames = request["frames"] or (0, 60)
        return LaterCapture(path, scenes.cameras(), held_out=held_out, frame_range=frames, fps=30)

    monkeypatch.setattr(opening, "open_capture", open_capture)
    return found


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scenes.write_reel(tmp_path_factory.mktemp("source") / "reel", SOURCE)


def edited(reel: Path, out: Path, *operations: str) -> Path:
    write_clip(apply_operations(ReelClip(reel), operations), out)
    return out


def without_source(reel: Path, folder: Path) -> Path:
    """Return a copy of a reel as earlier versions wrote it."""
    shutil.copytree(reel, folder)
    manifest = replace(ReelReader(reel).manifest, source=None)
    write_bytes(folder / "manifest.json", manifest.to_json().encode())
    return folder


def test_frames_and_cameras_are_those_of_the_run(reel: Path, tmp_path: Path, requests: list[dict]) -> None:
    """Wherever the reel was copied to: the manifest knows them."""
    moved = shutil.copytree(reel, tmp_path / "elsewhere")
    capture, frames = open_reel_capture(moved, tmp_path)
    assert (requests[0]["frames"], requests[0]["width"]) == ((BEGIN, BEGIN + scenes.FRAMES), scenes.WIDTH)
    assert (requests[0]["held_out"], requests[0]["leave_out"]) == (["cam03"], ["cam09"])
    report = evaluate(moved, capture, frames=frames)
    assert report.psnr > 40
    assert ([camera["name"] for camera in report.cameras], report.held_out) == (["cam03"], ["cam03"])


def test_cut_reel_is_compared_with_its_part(reel: Path, tmp_path: Path, requests: list[dict]) -> None:
    part = edited(reel, tmp_path / "part", "cut=1:4", "cut=1:3")
    capture, frames = open_reel_capture(part, tmp_path)
    assert (capture.first_frame, capture.frames, frames) == (BEGIN + 2, 2, [0, 1])
    assert evaluate(part, capture, frames=frames).psnr > 40
    (tmp_path / "work").mkdir()
    assert work_of(part, ReelReader(part).manifest) is None  # the run's checkpoints are of other frames
    assert ReelReader(edited(reel, tmp_path / "color", "exposure=0.5")).manifest.source == replace(SOURCE, edited=True)


@pytest.mark.parametrize("operation", ["reverse", "fps=15"])
def test_reel_of_other_frames_is_not_compared_without_frames(
    reel: Path, tmp_path: Path, requests: list[dict], operation: str
) -> None:
    other = edited(reel, tmp_path / "other", operation)
    with pytest.raises(UsageError, match=r"is not known: it was reversed, joined or retimed.*--frames A:B"):
        open_reel_capture(other, tmp_path)


def test_join_keeps_cameras_but_no_frame(reel: Path, tmp_path: Path) -> None:
    twice = ReelReader(edited(reel, tmp_path / "twice", f"join={reel}")).manifest.source
    assert twice == replace(SOURCE, frame=None, edited=True)
    old = without_source(reel, tmp_path / "old")
    assert ReelReader(edited(reel, tmp_path / "mixed", f"join={old}")).manifest.source is None


def test_some_of_the_frames_can_be_chosen(reel: Path, tmp_path: Path, requests: list[dict]) -> None:
    capture, frames = open_reel_capture(reel, tmp_path, frames=(BEGIN + 2, BEGIN + 4))
    assert (capture.first_frame, frames) == (BEGIN, [2, 3])
    with pytest.raises(UsageError, match=r"shows frames 20:25 of its capture, and --frames 0:5 are not among these"):
        open_reel_capture(reel, tmp_path, frames=(0, 5))


def test_run_of_an_earlier_version_is_known_by_its_record(reel: Path, tmp_path: Path, requests: list[dict]) -> None:
    old = without_source(reel, tmp_path / "reel")
    (tmp_path / "work").mkdir()
    record = {"capture": {"frames": "20:25", "held_out": ["cam03"]}, "config": {}}
    (tmp_path / "work" / "run.json").write_text(json.dumps(record))
    capture, frames = open_reel_capture(old, tmp_path)
    assert (capture.first_frame, capture.held_out, frames) == (BEGIN, ["cam03"], [0, 1, 2, 3, 4])


def test_unknown_frames_and_cameras_are_asked_for(reel: Path, tmp_path: Path, requests: list[dict]) -> None:
    old = without_source(reel, tmp_path / "imported")
    with pytest.raises(UsageError, match=r"is not known: it was imported.*its 5 frames.*--frames A:B"):
        open_reel_capture(old, tmp_path)
    with pytest.raises(UsageError, match=r"trained on cam01\. Name cameras with --cameras.* cam00, cam03"):
        open_reel_capture(old, tmp_path, frames=(20, 25))
    capture, _ = open_reel_capture(old, tmp_path, frames=(20, 25), names=["cam00"])
    assert evaluate(old, capture, cameras=["cam03"]).psnr > 40


@pytest.mark.parametrize(("part", "cause"), [("masks", "reconstructed with --masks"), ("region", "with --region")])
def test_copied_reel_of_a_part_is_not_compared_with_whole_images(
    tmp_path: Path, requests: list[dict], part: Any, cause: str
) -> None:
    reel = scenes.write_reel(tmp_path / "copy", replace(SOURCE, part=part))
    with pytest.raises(UsageError, match=rf"was .*{cause}, so whole images cannot be compared"):
        open_reel_capture(reel, tmp_path)
    open_reel_capture(reel, tmp_path, masks="masks")
    assert requests[0]["masks"] == "masks"


def test_cropped_reel_is_not_compared_with_whole_images(reel: Path, tmp_path: Path) -> None:
    part = edited(reel, tmp_path / "part", "crop=sphere:0,0,0,1.5")
    with pytest.raises(UsageError, match=r"was cut out by `edit crop=`, so whole images cannot be compared"):
        open_reel_capture(part, tmp_path)


def test_capture_opened_at_other_frames_is_refused(reel: Path, tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"shows frames 20:25 .* opened from frame 0 on\. Open it with frames=\(20, 25\)"
    ):
        evaluate(reel, scenes.capture(tmp_path))


def test_only_compared_cameras_need_masks_and_left_out_ones_may_be_compared(
    reel: Path, tmp_path: Path, requests: list[dict]
) -> None:
    open_reel_capture(reel, tmp_path, masks=tmp_path, names=["cam09", "cam02"])
    assert requests[0]["masked"] == ["cam09", "cam02"]
    assert "leave_out" not in requests[0]
    open_reel_capture(reel, tmp_path, masks=tmp_path)
    assert requests[1]["masked"] == ["cam03"]


def test_masks_that_the_run_made_are_found(tmp_path: Path, requests: list[dict]) -> None:
    reel = scenes.write_reel(tmp_path / "run" / "reel", replace(SOURCE, part="masks"))
    with pytest.raises(UsageError, match="was reconstructed with --masks"):
        open_reel_capture(reel, tmp_path)
    (tmp_path / "run" / "masks").mkdir()
    (tmp_path / "run" / "masks" / "splatreel-masks.json").write_text("{}")
    open_reel_capture(reel, tmp_path)
    assert requests[-1]["masks"] == tmp_path / "run" / "masks"
