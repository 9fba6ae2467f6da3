"""Live reels of tiny captures that are written while they are followed: the recorder writes when it is told that all is shown."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.capture.follower import Follower, open_growing
from splatreel.capture.growing.growth import Growth
from splatreel.capture.opening import open_capture
from splatreel.codec.opus_sound import decode_sound
from splatreel.codec.reader import ReelReader
from splatreel.codec.verify import verify_reel
from splatreel.config import Config
from splatreel.progress import Silent, Span
from splatreel.recon.live.following import Live, reconstruct_following
from splatreel.recon.pipeline import reconstruct
from tests.capture.growing.recorder import Recorder
from tests.capture.growing.test_sound import FPS, clicks, heard
from tests.capture.test_follower import BEGUN
from tests.files import contents
from tests.recon.captures import WallCapture
from tests.recon.small import small

CONFIG = small()
LENGTH, OVERLAP = CONFIG.group.length, CONFIG.group.overlap
WALL = WallCapture(1000, speed=0.1)


def recorder(folder: Path, kind: str = "pictures", sound: Callable[[int], np.ndarray] | None = None) -> Recorder:
    def picture(camera: int, frame: int) -> np.ndarray:
        return WALL.read(frame, 1, [WALL.cameras[camera].name])[0, 0]

    return Recorder(folder, kind, picture, cameras=WALL.cameras, fps=FPS, sound=sound)


class Director(Silent):
    """Remembers what is told, and acts on it. acts: by the beginning of what is told, what is done once."""

    def __init__(self, acts: dict[str, Callable[[], object]] | None = None) -> None:
        self.told: list[str] = []
        self.stages: list[tuple[str, int]] = []
        self.acts = dict(acts or {})

    def note(self, text: str) -> None:
        self.told.append(text)
        self._act(text)

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        assert span is None or not name.startswith("group"), "nobody knows how long it will be"
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
    """The files of nine frames that were there before."""
    folder = tmp_path_factory.mktemp("whole")
    source = recorder(folder / "show")
    source.write(9)
    return groups(reconstruct(open_capture(source.folder, held_out=[]), folder / "out", CONFIG).reel)


def interrupt() -> None:
    raise KeyboardInterrupt


def test_groups_are_shown_as_they_are_filmed_and_are_those_of_a_capture_that_was_complete(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
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
    director = Director({"Group 1 shown": more, "Group 2 shown": more, "Group 3 shown": end})
    assert follow(source, tmp_path / "out", director) == reel
    assert seen == [(True, 1), (True, 2)]
    assert groups(reel) == whole
    assert not ReelReader(reel).manifest.live
    assert verify_reel(reel).groups == 4
    shown = [text for text in director.told if text.startswith("Group") and "shown" in text]
    assert shown[0] == "Group 1 shown; waiting for frames."  # its frames were there before
    assert " s after its last frame was filmed; waiting for frames." in shown[2]
    assert shown[3].endswith("; all is shown.")


@pytest.mark.parametrize("where", ["group 2: learning how it moves", "Group 2 shown", "group 1: building"])
def test_a_run_that_was_stopped_goes_on_with_the_frames_that_came_since(
    where: str, tmp_path: Path, whole: dict[str, bytes]
) -> None:
    source = recorder(tmp_path / "show")
    source.write(6)
    with pytest.raises(KeyboardInterrupt):
        follow(source, tmp_path / "out", Director({where: interrupt}))
    source.write(3)
    source.end()
    assert groups(follow(source, tmp_path / "out", Director())) == whole


def test_a_capture_that_went_on_after_it_was_taken_for_ended_is_followed_again(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    source = recorder(tmp_path / "show")
    source.write(6)
    first = Director()
    reel = follow(source, tmp_path / "out", first, timeout=0.2)
    assert not ReelReader(reel).manifest.live
    assert ReelReader(reel).manifest.frames == 6
    source.write(3)
    source.end()
    assert groups(follow(source, tmp_path / "out", Director())) == whole


def test_who_is_late_hears_of_it_and_of_catching_up(tmp_path: Path, whole: dict[str, bytes]) -> None:
    source = recorder(tmp_path / "show")
    source.write(9)
    source.end()
    director = Director()
    assert groups(follow(source, tmp_path / "out", director)) == whole  # in order
    late = [text for text in director.told if text.startswith("Cannot keep up")]
    assert late == ["Cannot keep up: group 1 begins 0.2 s late; groups are shown later and later (--when-late wait)."]
    assert "Group 4: caught up." in director.told


def test_drafts_take_fewer_iterations_until_it_has_caught_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "splatreel.recon.live.lateness.DRAFT", {"keyframe.refine_iterations": 4, "group.iterations_per_frame": 1}
    )
    source = recorder(tmp_path / "show")
    source.write(9)
    source.end()
    director = Director()
    follow(source, tmp_path / "out", director, when_late="draft")
    iterations = [total for name, total in director.stages if "learning how it moves" in name]
    frames = LENGTH + OVERLAP
    assert iterations == [frames, frames, frames, frames * CONFIG.group.iterations_per_frame]


def test_what_is_left_out_stands_still_and_the_next_group_is_at_the_edge(tmp_path: Path) -> None:
    source = recorder(tmp_path / "show")
    source.write(LENGTH + OVERLAP + 1)

    def burst() -> None:
        source.write(4 * LENGTH)

    director = Director({"group 2: learning how it moves": burst, "Group 6 shown": source.end})
    source.write(LENGTH)
    reel = ReelReader(follow(source, tmp_path / "out", director, when_late="skip"))
    made = [name for name, _ in director.stages if "learning how it moves" in name]
    assert [name.split(":")[0] for name in made] == ["group 1", "group 2", "group 6", "group 7"]
    assert [text for text in director.told if "left out" in text and text.startswith("Group")] == [
        f"Group {number} is left out: nothing moves in it." for number in (3, 4, 5)
    ]
    assert reel.manifest.frames == source.written[0]
    before, held = reel.group(1), reel.group(3)
    assert len(held.dynamic) == len(before.dynamic) > 0
    assert np.abs(held.dx).max() < 1e-6
    np.testing.assert_allclose(held.at(0).means.mean(0), before.at(LENGTH).means.mean(0), atol=0.02)
    assert np.abs(before.dx).max() > 1e-3


@pytest.mark.slow
def test_a_reel_that_keeps_its_last_seconds_stays_small_and_goes_on_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("window", "renewal", "output"):
        monkeypatch.setattr(f"splatreel.recon.live.{module}.EPOCH", 3)
    source, out = recorder(tmp_path / "show"), tmp_path / "out"
    source.write(7 * LENGTH + 1)
    keep = 4 / 30 + 1e-6
    with pytest.raises(KeyboardInterrupt):
        follow(source, out, Director({"group 6: learning": interrupt}), keep=keep)
    assert ReelReader(out / "reel").manifest.first_group == 3
    source.end()
    reel = follow(source, out, Director(), keep=keep)
    manifest = ReelReader(reel).manifest
    assert (manifest.first_group, manifest.end_group, manifest.frames) == (5, 7, 15)
    assert [layer.until for layer in manifest.layers if layer.group == 6] == [9]
    assert all(layer.group >= 3 for layer in manifest.layers), "earlier ones are retired"
    assert verify_reel(reel).strangers == []
    assert set(groups(reel)) == {entry.uri for entry in manifest.files}
    kept = {name.split("/")[0] for name in contents(out / "work") if name.startswith("group")}
    assert {"group0005", "group0006"} < kept <= {f"group{index:04d}" for index in (0, 3, 4, 5, 6)}
    assert set(contents(out / "work" / "group0003")) <= {"layer.safetensors"}
    assert set(contents(out / "work" / "group0000")) == {"poses.safetensors"}
    other = tmp_path / "other"
    undisturbed = follow(source, other, Director(), keep=keep)
    assert groups(undisturbed) == groups(reel)
    for file in groups(reel):  # a reel that was lost is written again from what is kept
        (reel / file).unlink()
    (reel / "manifest.json").unlink()
    assert groups(follow(source, out, Director(), keep=keep)) == groups(undisturbed)


@pytest.mark.slow
def test_the_sound_grows_with_the_reel_and_goes_on_after_a_kill(tmp_path: Path) -> None:
    source, out = recorder(tmp_path / "show", "ts", clicks), tmp_path / "out"
    source.write(BEGUN)
    config = small({"group.length": 10, "group.iterations_per_frame": 1})
    director = Director({"Group 2 shown": lambda: source.write(18), "group 4: learning": interrupt})
    with pytest.raises(KeyboardInterrupt):
        follow(source, out, director, config=config)
    assert "Sound: camera cam00, as it is recorded" in director.told
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
    assert heard(samples) == pytest.approx(list(np.arange(5, frames, 5) / FPS), abs=0.003)  # Opus begins softly
