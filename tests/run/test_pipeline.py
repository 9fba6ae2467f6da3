"""Whole reconstructions of tiny captures: their results, also after interruptions and for invalid input."""

import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from splatreel.base import atomic
from splatreel.base.errors import CaptureError, ReconstructionError, SplatreelError, StorageError, UsageError
from splatreel.base.progress import Silent, Span
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.config import Config
from splatreel.config.settings import ADDED_SETTINGS
from splatreel.evaluation.evaluate import uncompressed_frames
from splatreel.kernels.image import render_image
from splatreel.run.pipeline import Result, reconstruct
from splatreel.scene.reel_source import ReelSource
from tests.method.captures import WallCapture
from tests.method.small import small

CONFIG = small()
FRAMES = 4


def content(reel: Path) -> dict[str, str]:
    """Every file of a reel and its digest."""
    files = sorted(file for file in reel.rglob("*") if file.is_file())
    return {str(file.relative_to(reel)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """An undisturbed run."""
    return reconstruct(WallCapture(FRAMES), tmp_path_factory.mktemp("whole"), CONFIG)


@pytest.fixture
def copy(whole: Result, tmp_path: Path) -> Path:
    """A copy of a finished run, to be damaged."""
    return shutil.copytree(whole.reel.parent, tmp_path / "copy")


class Trace(Silent):
    """Progress that records the stages."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, int, Span | None]] = []
        self.done: dict[str, int] = {}

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self.stages.append((name, total, span))

    def update(self, done: int, **numbers: float) -> None:
        self.done[self.stages[-1][0]] = done


def test_groups_are_written_with_their_moving_points(whole: Result) -> None:
    reel = ReelReader(whole.reel)
    assert verify_reel(whole.reel).groups == 2
    assert not reel.manifest.live
    assert [(g.first_frame, g.frames) for g in reel.manifest.groups] == [(0, 3), (2, 2)]
    group = reel.group(0)
    assert 0 < len(group.dynamic) < group.alive.sum()
    assert np.abs(group.dx).max() > 0
    stages = {"points", "exposure", "poses", "keyframe", "layering", "tracking", "group", "encode"}
    assert set(whole.seconds) == stages
    assert whole.device in ("cpu", "cuda")


def test_same_run_gives_the_same_reel(whole: Result, tmp_path: Path) -> None:
    assert content(reconstruct(WallCapture(FRAMES), tmp_path, CONFIG).reel) == content(whole.reel)


def test_finished_run_does_no_work(whole: Result, copy: Path) -> None:
    before, trace = content(copy / "reel"), Trace()
    again = reconstruct(WallCapture(FRAMES), copy, CONFIG, progress=trace)
    assert trace.stages == []
    assert content(copy / "reel") == before
    assert again.seconds == whole.seconds


def test_progress_shares_cover_the_whole_job(tmp_path: Path) -> None:
    trace = Trace()
    reconstruct(WallCapture(FRAMES), tmp_path, CONFIG, progress=trace)
    shares = [span for _, _, span in trace.stages if span is not None]
    assert len(shares) == len(trace.stages) == 14
    assert shares[0][0] == 0
    assert shares[-1][1] == pytest.approx(1)
    assert all(a[1] == pytest.approx(b[0]) for a, b in pairwise(shares))
    assert trace.done == {name: total for name, total, _ in trace.stages}  # no bar is left half way


class Stop(Silent):
    """Progress that raises at the first new report, so that each run gets one step further."""

    def __init__(self, seen: set[object]) -> None:
        self.seen = seen

    def _meet(self, event: object) -> None:
        if event not in self.seen:
            self.seen.add(event)
            raise KeyboardInterrupt

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self.name = name
        self._meet(name)

    def update(self, done: int, **numbers: float) -> None:
        self._meet((self.name, done))


def finish_despite(attempt: Callable[[], object], trouble: type[BaseException], reel: Path) -> list[BaseException]:
    """Repeat until nothing is raised; what is published must be whole each time, and never shrink."""
    met: list[BaseException] = []
    groups = 0
    while True:
        try:
            attempt()
            return met
        except trouble as error:
            met.append(error)
        if (reel / "manifest.json").exists():
            now = verify_reel(reel).groups
            assert now >= groups
            groups = now
        else:
            assert groups == 0
        assert len(met) < 100


@pytest.mark.slow
def test_interrupted_run_ends_with_the_same_reel(whole: Result, tmp_path: Path) -> None:
    seen: set[object] = set()
    met = finish_despite(
        lambda: reconstruct(WallCapture(FRAMES), tmp_path, CONFIG, progress=Stop(seen)),
        KeyboardInterrupt,
        tmp_path / "reel",
    )
    assert len(met) > 12
    assert content(tmp_path / "reel") == content(whole.reel)


@pytest.mark.slow
@pytest.mark.kill
@pytest.mark.parametrize("when", ["before", "after"])
def test_run_killed_at_any_write_ends_with_the_same_reel(
    whole: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """A process that is killed leaves its temporary files; those must be gone in the end, too."""
    seen: set[tuple[Path, bytes]] = set()
    really = os.replace

    def replace_once(source: Path, target: Path) -> None:
        write = target, source.read_bytes()
        killed = write not in seen and target.name != "seconds.json"
        seen.add(write)
        if killed and when == "before":
            shutil.copy(source, source.parent / re.sub("[0-9a-f]{16}", "0" * 16, source.name))
            raise KeyboardInterrupt
        really(source, target)
        if killed:
            raise KeyboardInterrupt

    monkeypatch.setattr(atomic.os, "replace", replace_once)
    run = tmp_path / "run"
    met = finish_despite(lambda: reconstruct(WallCapture(FRAMES), run, CONFIG), KeyboardInterrupt, run / "reel")
    assert len(met) == 27  # 4 for the run, 21 for the two groups, and the manifest twice more
    assert content(run / "reel") == content(whole.reel)
    assert [file for file in run.rglob("*") if ".tmp" in file.name] == []


@pytest.mark.parametrize("uri", ["groups/0000.safetensors", "layers/0000.safetensors"])
def test_files_of_the_reel_that_were_damaged_are_written_again(whole: Result, copy: Path, uri: str) -> None:
    """The file keeps its length and gets other bytes, as from a failing disk."""
    file = copy / "reel" / uri
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    reconstruct(WallCapture(FRAMES), copy, CONFIG)
    verify_reel(copy / "reel")
    assert content(copy / "reel") == content(whole.reel)


@pytest.mark.slow
def test_full_disk_is_reported_and_loses_nothing(
    whole: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full: list[str] = []
    really = os.fsync

    def fsync(number: int) -> None:
        name = re.sub(r"\.[0-9a-f]{16}\.tmp$", "", os.readlink(f"/proc/self/fd/{number}"))
        if name not in full:
            full.append(name)
            raise OSError(errno.ENOSPC, "No space left on device")
        really(number)

    if not Path("/proc/self/fd").exists():
        pytest.skip("needs /proc to know which file is written")
    monkeypatch.setattr(atomic.os, "fsync", fsync)
    met = finish_despite(lambda: reconstruct(WallCapture(FRAMES), tmp_path, CONFIG), SplatreelError, tmp_path / "reel")
    assert len(met) == len(full)
    files = r"/(run\.json|seconds\.json|header\.json|layout\.json|manifest\.json|\w+\.safetensors)"
    for error in met:
        assert isinstance(error, StorageError)
        assert re.search(f"{files}: could not write \\d+ bytes .No space left on device.*[Ff]ree space", str(error)), (
            error
        )
    assert content(tmp_path / "reel") == content(whole.reel)


def test_deleted_checkpoints_are_computed_again(whole: Result, copy: Path) -> None:
    for part in ("work/group0001/group.safetensors", "reel/groups/0001.safetensors"):
        (copy / part).unlink()
        reconstruct(WallCapture(FRAMES), copy, CONFIG)
        assert content(copy / "reel") == content(whole.reel), part
    trace = Trace()
    shutil.rmtree(copy / "reel")
    reconstruct(WallCapture(FRAMES), copy, CONFIG, progress=trace)
    assert content(copy / "reel") == content(whole.reel)
    assert trace.stages == []  # encoded again, not trained


def test_published_file_that_was_cut_is_written_again(whole: Result, copy: Path) -> None:
    file = copy / "reel" / "layers" / "0000.safetensors"
    file.write_bytes(file.read_bytes()[:-10])
    reconstruct(WallCapture(FRAMES), copy, CONFIG)
    assert content(copy / "reel") == content(whole.reel)


@pytest.mark.parametrize("part", ["group0000/group.safetensors", "run.json", "layout.json"])
def test_damaged_checkpoint_is_named_and_nothing_else_is_touched(copy: Path, part: str) -> None:
    file = copy / "work" / part
    file.write_bytes(b"{damaged")
    before = content(copy)
    with pytest.raises(ReconstructionError, match=rf"{re.escape(str(file))}: .*[Dd]elete it and run again"):
        reconstruct(WallCapture(FRAMES), copy, CONFIG)
    assert content(copy) == before


REFUSED = [
    (WallCapture(3), CONFIG, 'capture.frames is "0:4" there, "0:3" now'),
    (WallCapture(FRAMES, cameras=5), CONFIG, "capture.cameras is "),
    (WallCapture(FRAMES, fps=25), CONFIG, "capture.fps is 30.0 there, 25.0 now"),
    (WallCapture(FRAMES), replace(CONFIG, seed=7), "config.seed is 0 there, 7 now"),
    (
        WallCapture(FRAMES),
        replace(CONFIG, group=replace(CONFIG.group, deformation="hashgrid")),
        'config.group.deformation is "trajectory" there, "hashgrid" now',
    ),
]


@pytest.mark.parametrize(("capture", "config", "difference"), REFUSED)
def test_folder_of_another_run_is_refused(copy: Path, capture: WallCapture, config: Config, difference: str) -> None:
    before = content(copy)
    with pytest.raises(ReconstructionError, match=re.escape(difference)) as raised:
        reconstruct(capture, copy, config)
    assert str(copy / "work" / "run.json") in str(raised.value)
    assert "Choose another --out" in str(raised.value)
    assert content(copy) == before


def test_run_without_an_added_setting_continues_with_it_turned_off(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ADDED_SETTINGS, "keyframe.average_share", 0.0)
    path = copy / "work" / "run.json"
    record = json.loads(path.read_text())
    assert record["config"]["keyframe"].pop("average_share") == CONFIG.keyframe.average_share
    path.write_text(json.dumps(record))
    before = content(copy / "reel")
    with pytest.raises(ReconstructionError, match=re.escape("config.keyframe.average_share is 0.0 there, 0.1 now")):
        reconstruct(WallCapture(FRAMES), copy, CONFIG)
    reconstruct(WallCapture(FRAMES), copy, small({"keyframe.average_share": 0.0}))
    assert content(copy / "reel") == before


def test_reel_without_its_checkpoints_is_not_overwritten(copy: Path) -> None:
    shutil.rmtree(copy / "work")
    before = content(copy / "reel")
    with pytest.raises(ReconstructionError, match="holds a reel already"):
        reconstruct(WallCapture(FRAMES), copy, CONFIG)
    assert content(copy / "reel") == before


def test_failed_start_does_not_claim_the_folder(tmp_path: Path) -> None:
    """The capture may be repaired, or another one may be reconstructed into the folder."""

    class Damaged(WallCapture):
        def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
            raise CaptureError("cam02.mp4: frame 0 is damaged")

    with pytest.raises(CaptureError, match=r"cam02\.mp4"):
        reconstruct(Damaged(3), tmp_path, CONFIG)
    assert not (tmp_path / "work" / "run.json").exists()
    assert reconstruct(WallCapture(1), tmp_path, CONFIG).reel.exists()


def test_two_runs_at_once_do_not_mix(tmp_path: Path) -> None:
    class Second(Silent):
        def stage(self, name: str, total: int, span: Span | None = None) -> None:
            with pytest.raises(ReconstructionError, match="another process"):
                reconstruct(WallCapture(1), tmp_path, CONFIG)

    reconstruct(WallCapture(1), tmp_path, CONFIG, progress=Second())


def test_one_frame(tmp_path: Path) -> None:
    result = reconstruct(WallCapture(1), tmp_path, CONFIG)
    assert verify_reel(result.reel).groups == 1
    assert ReelReader(result.reel).frames == 1


def test_nothing_moves(tmp_path: Path) -> None:
    result = reconstruct(WallCapture(FRAMES, speed=0), tmp_path, CONFIG)
    reel = ReelReader(result.reel)
    assert verify_reel(result.reel).groups == 2
    assert [entry.points for entry in reel.manifest.groups] == [0, 0]
    assert len(reel.manifest.layers) == 1


def test_everything_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "splatreel.method.layering.labels.motion_masks", lambda frames, *_: np.ones(frames.shape[1:4], bool)
    )
    result = reconstruct(WallCapture(FRAMES), tmp_path, CONFIG)
    assert verify_reel(result.reel).groups == 2
    dynamic = [entry.points for entry in ReelReader(result.reel).manifest.groups]
    assert min(dynamic) > 1000


def test_light_changes_everywhere(tmp_path: Path) -> None:
    capture = WallCapture(3, speed=0, dims=True)
    assert verify_reel(reconstruct(capture, tmp_path / "a", small({"even_exposure": False})).reel).groups == 1
    result = reconstruct(capture, tmp_path / "b", CONFIG)
    group = ReelReader(result.reel).group(0)
    assert len(group.dynamic) == 0
    assert group.light is not None
    np.testing.assert_allclose(group.light[:, 0], [1, 0.5, 1], atol=0.02)
    undecoded = uncompressed_frames(result.work, result.reel)
    bright, dark = (render_image(undecoded(frame), capture.cameras[0]).mean() for frame in (0, 1))
    assert dark == pytest.approx(0.5 * bright, rel=0.03)


def test_images_that_do_not_fit_into_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = WallCapture(FRAMES)
    monkeypatch.setattr("splatreel.run.requirements.physical_memory", lambda: 60_000)
    with pytest.raises(ReconstructionError, match=r"wall: images of 48x32 by 4 cameras, .* Use a machine with more"):
        reconstruct(capture, tmp_path / "a", CONFIG)
    assert not (tmp_path / "a").exists()


def test_captures_that_cannot_be_reconstructed(tmp_path: Path) -> None:
    capture = WallCapture(2)
    capture.held_out = ["cam00", "cam01"]
    with pytest.raises(ReconstructionError, match=r"wall: only 2 cameras .* held-out cam00, cam01; at least 3"):
        reconstruct(capture, tmp_path / "a", CONFIG)
    capture = WallCapture(2)
    capture.cameras = [camera.resized(9, 6) for camera in capture.cameras]
    with pytest.raises(ReconstructionError, match="wall: images of 9x6 pixels are too small"):
        reconstruct(capture, tmp_path / "a", CONFIG)
    assert not (tmp_path / "a").exists()


def test_unusable_output_folder_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ReconstructionError, match=f"{re.escape(str(file))}.*Choose another --out"):
        reconstruct(WallCapture(1), file, CONFIG)
    assert file.read_text() == "mine"


def test_unknown_device(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="Unknown device 'tpu'"):
        reconstruct(WallCapture(1), tmp_path, CONFIG, device="tpu")


def test_record_is_readable(whole: Result) -> None:
    record = json.loads((whole.work / "run.json").read_text())
    assert record["capture"]["name"] == "wall"
    assert record["config"]["group"]["length"] == 2


def test_reel_says_what_it_was_made_from(whole: Result) -> None:
    assert ReelReader(whole.reel).manifest.source == WallCapture(1).reel_source() == ReelSource(0)
