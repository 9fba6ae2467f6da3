"""Videos of several chapters: their shared scene, and equal results in any order and after interruptions."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Silent
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.run.jobs import ChapteredRun, chapter_job, reel_job, scene_job
from splatreel.run.output.group_writer import no_presentation
from splatreel.run.output.reencode import reencode
from splatreel.run.pipeline import Result, plan_run, reconstruct
from splatreel.run.steps import CHAPTER
from splatreel.run.store import Store
from tests.method.captures import WallCapture
from tests.method.small import small
from tests.run.test_pipeline import Stop, Trace, content, finish_despite

CONFIG = small({"chapter_frames": 4})
FRAMES = 11


def planned(out: Path) -> ChapteredRun:
    return plan_run(WallCapture(FRAMES), out, CONFIG, device="cpu")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return reconstruct(WallCapture(FRAMES), tmp_path_factory.mktemp("whole"), CONFIG)


def test_chapter_has_layers_of_its_own_beside_those_that_all_share(whole: Result) -> None:
    run = planned(whole.reel.parent)
    assert [chapter.first for chapter in run.chapters] == [0, 2, 3]
    verify_reel(whole.reel)
    manifest = ReelReader(whole.reel).manifest
    assert len(manifest.groups) == len(run.groups) == 5
    shared, *others = manifest.layers
    scene = Store(whole.work).scene.layer()
    assert scene is not None
    assert (shared.group, shared.until, shared.points) == (0, None, len(scene.decoded))
    for layer in others:
        ends = [chapter.until for chapter in run.chapters if chapter.first <= layer.group]
        assert layer.until == ends[-1]
    assert not manifest.live


def test_scene_holds_the_wall_and_chapters_the_moving_cluster(whole: Result) -> None:
    store = Store(whole.work)
    shared = store.scene.layer()
    assert shared is not None
    seen = shared.decoded.opacities > 0.5
    assert np.median(shared.decoded.means[seen, 2]) == pytest.approx(0.95, abs=0.2)
    for chapter in planned(whole.reel.parent).chapters:
        start = CHAPTER.load(store.group(chapter.first))
        assert start is not None
        assert start.alive is not None
        assert len(start.points) > 0
        assert start.alive.mean() > 0.5


def test_group_shows_only_layers_of_its_chapter(whole: Result) -> None:
    reel = ReelReader(whole.reel)
    for index in range(len(reel.manifest.groups)):
        points, _ = reel.static(index)
        assert len(points) == len(reel.group(index).alive) == reel.manifest.static_points(index)
    timeline = Timeline(reel)
    for frame in range(FRAMES):
        assert len(timeline.at(frame / reel.fps)) > 0


@pytest.mark.slow
def test_chapters_are_made_in_any_order_by_jobs_that_can_be_repeated(whole: Result, tmp_path: Path) -> None:
    scene_job(planned(tmp_path), Silent())
    for index in (2, 0, 2, 1):
        chapter_job(planned(tmp_path), index, Silent())
    scene_job(planned(tmp_path), Silent())
    for _ in range(2):
        reel_job(planned(tmp_path), Silent(), no_presentation)
        assert content(tmp_path / "reel") == content(whole.reel)


def test_missing_parts_are_named(tmp_path: Path) -> None:
    with pytest.raises(ReconstructionError, match="scene that chapters share is not finished"):
        chapter_job(planned(tmp_path), 1, Silent())
    scene_job(planned(tmp_path), Silent())
    chapter_job(planned(tmp_path), 1, Silent())
    with pytest.raises(ReconstructionError, match=r"2 of 3 chapters are not finished \(1, 3\)"):
        reel_job(planned(tmp_path), Silent(), no_presentation)


def test_chapter_belongs_to_one_process_at_a_time(tmp_path: Path) -> None:
    scene_job(planned(tmp_path), Silent())

    class Second(Silent):
        def note(self, text: str) -> None: ...

        def stage(self, name: str, total: int, span: object = None) -> None:
            with pytest.raises(ReconstructionError, match="another process is making chapter0001"):
                chapter_job(planned(tmp_path), 1, Silent())

    chapter_job(planned(tmp_path), 1, Second())


@pytest.mark.slow
def test_interrupted_run_ends_with_the_same_reel(whole: Result, tmp_path: Path) -> None:
    seen: set[object] = set()
    met = finish_despite(
        lambda: reconstruct(WallCapture(FRAMES), tmp_path, CONFIG, progress=Stop(seen)),
        KeyboardInterrupt,
        tmp_path / "reel",
    )
    assert len(met) > 20
    assert content(tmp_path / "reel") == content(whole.reel)


@pytest.mark.slow
def test_progress_shares_cover_the_whole_job(tmp_path: Path) -> None:
    trace = Trace()
    reconstruct(WallCapture(FRAMES), tmp_path, CONFIG, progress=trace)
    shares = [span for _, _, span in trace.stages if span is not None]
    assert len(shares) == len(trace.stages)
    assert shares[0][0] == 0
    assert shares[-1][1] == pytest.approx(1)
    assert all(a[1] <= b[0] + 1e-9 for a, b in pairwise(shares))


def test_run_of_chapters_is_encoded_again_from_its_checkpoints(whole: Result, tmp_path: Path) -> None:
    reel = reencode(whole.work, tmp_path / "reel", CONFIG.encode, Silent())
    assert content(reel) == content(whole.reel)


@pytest.mark.slow
def test_chapter_starts_without_shared_points(tmp_path: Path) -> None:
    """If every image changes all the time, no plate is known."""
    capture = WallCapture(FRAMES, dims=True)
    result = reconstruct(capture, tmp_path, small({"chapter_frames": 4, "even_exposure": False}))
    verify_reel(result.reel)


def test_chapter_frames_does_not_affect_short_videos(tmp_path: Path) -> None:
    first = reconstruct(WallCapture(4), tmp_path / "a", CONFIG)
    content_of = content(first.reel)
    assert content(reconstruct(WallCapture(4), tmp_path / "a", small({"chapter_frames": 300})).reel) == content_of
    shutil.rmtree(tmp_path / "a")


class DuskCapture(WallCapture):
    """A capture that darkens so slowly that hardly anything changes within a group."""

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        super()._read_into(out, first, cameras)
        for place in range(len(out)):
            out[place] = np.rint(out[place] * dusk(first + place))


def dusk(frame: int) -> float:
    return 1 - 0.006 * frame


@pytest.mark.slow
def test_light_that_changes_too_slowly_to_be_seen_within_a_group_is_found(tmp_path: Path) -> None:
    frames, config = 24, small({"chapter_frames": 12})
    reel = ReelReader(reconstruct(DuskCapture(frames, speed=0.1), tmp_path, config).reel)
    last = reel.group(len(reel.manifest.groups) - 1)
    assert last.light is not None
    assert last.light.mean() == pytest.approx(dusk(frames - 1), abs=0.02)
