"""Live reels of tiny captures that grow while they are followed. The recorder writes frames upon progress messages."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.progress import Silent, Span
from splatreel.capture.follower import Follower, open_growing
from splatreel.capture.growth import Growth
from splatreel.capture.opening import open_capture
from splatreel.codec.inspection import verify_reel
from splatreel.codec.opus_sound import decode_sound
from splatreel.codec.reader import ReelReader
from splatreel.config import Config
from splatreel.run.live.following import Live, reconstruct_following
from splatreel.run.pipeline import reconstruct
from tests.capture.recorder import Recorder
from tests.capture.test_follower import BEGUN
from tests.capture.test_growing_video import FPS, clicks, heard
from tests.files import contents
from tests.method.captures import WallCapture
from tests.method.small import small

CONFIG = small()
LENGTH, OVERLAP = CONFIG.group.length, CONFIG.group.overlap
WALL = WallCapture(1000, speed=0.1)


def recorder(folder: Path, kind: str = "pictures", sound: Callable[[int], np.ndarray] | None = None) -> Recorder:
    def make_image(camera: int, frame: int) -> np.ndarray:
        return WALL.read(frame, 1, [WALL.cameras[camera].name])[0, 0]

    return Recorder(folder, kind, make_image, cameras=WALL.cameras, fps=FPS, sound=sound)


class Director(Silent):
    """Progress that records messages and reacts to them. acts: by the first words of a message, an action that runs once."""

    def __init__(self, acts: dict[str, Callable[[], object]] | None = None) -> None:
        self.told: list[str] = []
        self.stages: list[tuple[str, int]] = []
        self.acts = dict(acts or {})

    def note(self, text: str) -> None:
        self.told.append(text)
        self._act(text)

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        assert span is None or not name.startswith("group"), "the number of groups is unknown"
        self.stages.append((name, total))
        self._act(name)

    def _act(self, text: str) -> None:
        for begin in [begin for begin in self.acts if text.startswith(begin)]:
            self.acts.pop(begin)()


def follow(
    source: Recorder, out: Path, director: Director, timeout: float = 60, config: Config = CONFIG, **live: Any
) -> Path:
    growth = Growth(source.folder, timeout)
    with (
        closing(open_growing(source.folder, growth, director.note, held_out=[])) as capture,
        Follower(capture, growth, director.note) as follower,
    ):
        return reconstruct_following(follower, out, config, Live(**live), progress=director).reel


def groups(reel: Path) -> dict[str, bytes]:
    return {name: data for name, data in contents(reel).items() if name.startswith(("groups", "layers"))}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the files of a capture of nine frames that was complete."""
    folder = tmp_path_factory.mktemp("whole")
    source = recorder(folder / "show")
    source.write(9)
    return groups(reconstruct(open_capture(source.folder, held_out=[]), folder / "out", CONFIG).reel)


def interrupt() -> None:
    raise KeyboardInterrupt


def test_live_groups_equal_those_of_complete_capture(tmp_path: Path, whole: dict[str, bytes]) -> None:
    source, seen = recorder(tmp_path / "show"), []
    reel = tmp_path / "out" / "reel"

    def more() -> None:
        manifest = ReelReader(reel).manifest
        seen.append((manifest.live, len(manifest.groups)))
        source.write(LENGTH)

    def end() -> None:
        source.write(1)
        source.end()

    source.write(LENGTH + OVERLAP + 1)
    director = Director({"Group 1 written": more, "Group 2 written": more, "Group 3 written": end})
    assert follow(source, tmp_path / "out", director) == reel
    assert seen == [(True, 1), (True, 2)]
    assert groups(reel) == whole
    assert not ReelReader(reel).manifest.live
    assert verify_reel(reel).groups == 4
    written = [text for text in director.told if text.startswith("Group") and "written" in text]
    assert written[0] == "Group 1 written; waiting for frames."  # its frames existed before
    assert " s after its last frame was filmed; waiting for frames." in written[2]
    assert written[3].endswith("; the capture has ended.")


@pytest.mark.parametrize(
    "where", ["group 2: training the motion", "Group 2 written", "group 1: training the first keyframe"]
)
def test_stopped_live_run_resumes_with_new_frames(where: str, tmp_path: Path, whole: dict[str, bytes]) -> None:
    source = recorder(tmp_path / "show")
    source.write(6)
    with pytest.raises(KeyboardInterrupt):
        follow(source, tmp_path / "out", Director({where: interrupt}))
    source.write(3)
    source.end()
    assert groups(follow(source, tmp_path / "out", Director())) == whole


def test_live_run_resumes_after_capture_grows_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    source = recorder(tmp_path / "show")
    source.write(6)
    first = Director()
    reel = follow(source, tmp_path / "out", first, timeout=0.2)
    assert not ReelReader(reel).manifest.live
    assert ReelReader(reel).manifest.frames == 6
    source.write(3)
    source.end()
    assert groups(follow(source, tmp_path / "out", Director())) == whole


def test_lateness_is_reported(tmp_path: Path, whole: dict[str, bytes]) -> None:
    source = recorder(tmp_path / "show")
    source.write(9)
    source.end()
    director = Director()
    assert groups(follow(source, tmp_path / "out", director)) == whole  # in order
    late = [text for text in director.told if text.startswith("Too slow")]
    assert late == ["Too slow: group 1 starts 0.2 s late; latency grows (--when-late wait)."]
    assert "Group 4: caught up." in director.told


def test_draft_lowers_iterations_until_caught_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "splatreel.run.live.following.DRAFT", {"keyframe.refine_iterations": 4, "group.iterations_per_frame": 1}
    )
    source = recorder(tmp_path / "show")
    source.write(9)
    source.end()
    director = Director()
    follow(source, tmp_path / "out", director, when_late="draft")
    iterations = [total for name, total in director.stages if "training the motion" in name]
    frames = LENGTH + OVERLAP
    assert iterations == [frames, frames, frames, frames * CONFIG.group.iterations_per_frame]


def test_skipped_groups_rest_and_next_group_is_newest(tmp_path: Path) -> None:
    source = recorder(tmp_path / "show")
    source.write(LENGTH + OVERLAP + 1)

    def burst() -> None:
        source.write(4 * LENGTH)

    director = Director({"group 2: training the motion": burst, "Group 6 written": source.end})
    source.write(LENGTH)
    reel = ReelReader(follow(source, tmp_path / "out", director, when_late="skip"))
    made = [name for name, _ in director.stages if "training the motion" in name]
    assert [name.split(":")[0] for name in made] == ["group 1", "group 2", "group 6", "group 7"]
    assert [text for text in director.told if "skipped" in text and text.startswith("Group")] == [
        f"Group {number} skipped: nothing moves in it." for number in (3, 4, 5)
    ]
    assert reel.manifest.frames == source.written[0]
    before, skipped = reel.group(1), reel.group(3)
    assert len(skipped.dynamic) == len(before.dynamic) > 0
    assert np.abs(skipped.dx).max() < 1e-6
    np.testing.assert_allclose(skipped.at(0).means.mean(0), before.at(LENGTH).means.mean(0), atol=0.02)
    assert np.abs(before.dx).max() > 1e-3


@pytest.mark.slow
def test_retention_deletes_old_groups_and_survives_a_kill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("retention", "following"):
        monkeypatch.setattr(f"splatreel.run.live.{module}.EPOCH", 3)
    source, out = recorder(tmp_path / "show"), tmp_path / "out"
    source.write(7 * LENGTH + 1)
    keep = 4 / 30 + 1e-6
    with pytest.raises(KeyboardInterrupt):
        follow(source, out, Director({"group 6: training the motion": interrupt}), keep=keep)
    assert ReelReader(out / "reel").manifest.first_group == 3
    source.end()
    reel = follow(source, out, Director(), keep=keep)
    manifest = ReelReader(reel).manifest
    assert (manifest.first_group, manifest.end_group, manifest.frames) == (5, 7, 15)
    assert [layer.until for layer in manifest.layers if layer.group == 6] == [9]
    assert all(layer.group >= 3 for layer in manifest.layers), "earlier layers are retired"
    assert verify_reel(reel).strangers == []
    assert set(groups(reel)) == {entry.uri for entry in manifest.files}
    kept = {name.split("/")[0] for name in contents(out / "work") if name.startswith("group")}
    assert {"group0005", "group0006"} < kept <= {f"group{index:04d}" for index in (0, 3, 4, 5, 6)}
    assert set(contents(out / "work" / "group0003")) <= {"layer.safetensors"}
    assert set(contents(out / "work" / "group0000")) == {"poses.safetensors"}
    other = tmp_path / "other"
    undisturbed = follow(source, other, Director(), keep=keep)
    assert groups(undisturbed) == groups(reel)
    for file in groups(reel):  # a lost reel is written again from the checkpoints
        (reel / file).unlink()
    (reel / "manifest.json").unlink()
    assert groups(follow(source, out, Director(), keep=keep)) == groups(undisturbed)


@pytest.mark.slow
def test_live_soundtrack_grows_and_survives_a_kill(tmp_path: Path) -> None:
    source, out = recorder(tmp_path / "show", "ts", clicks), tmp_path / "out"
    source.write(BEGUN)
    config = small({"group.length": 10, "group.iterations_per_frame": 1})
    director = Director({"Group 2 written": lambda: source.write(18), "group 4: training the motion": interrupt})
    with pytest.raises(KeyboardInterrupt):
        follow(source, out, director, config=config)
    assert "Sound: camera cam00, recorded live" in director.told
    early = ReelReader(out / "reel").manifest.presentation.sound
    assert early is not None
    assert [segment.start for segment in early.segments] == [0.0, 2.0]
    source.write(7)
    source.end()
    manifest = ReelReader(follow(source, out, Director(), config=config)).manifest
    assert verify_reel(out / "reel").groups == len(manifest.groups)
    sound = manifest.presentation.sound
    assert sound is not None
    assert [segment.start for segment in sound.segments] == [0.0, 2.0, 4.0]
    frames = source.written[0]
    assert manifest.frames == frames
    assert sound.segments[-1].start + sound.segments[-1].seconds == pytest.approx(frames / FPS, abs=0.02)
    assert sound.position == pytest.approx(WALL.cameras[0].center.tolist(), abs=1e-5)
    data = [(out / "reel" / segment.asset.uri).read_bytes() for segment in sound.segments]
    init = (out / "reel" / sound.init.uri).read_bytes()
    samples = np.concatenate([part for _, part in decode_sound(init, data, 1)])[:, 0]
    assert heard(samples) == pytest.approx(list(np.arange(5, frames, 5) / FPS), abs=0.003)  # Opus fades in
