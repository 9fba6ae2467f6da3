"""Cuts, reversal, other frame rates and joins: what is shown at which time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.codec.inspection import verify_reel
from splatreel.edit.operations import apply_operations
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import Timeline, open_reel
from tests.codec.reels import new_group, new_writer, points, write_chapters
from tests.edit.clips import edit, make_image, psnr, worst, write_reel

NOT_FADING = 45.0
"""PSNR, dB, of images whose motion was encoded once more."""


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel")


def test_untouched_reel_is_the_same(reel: Path, tmp_path: Path) -> None:
    same = edit(reel, tmp_path / "same")
    original = open_reel(reel)
    assert worst(same, original, [(frame, frame) for frame in (0, 3.5, 6, 7, 13, 17)]) > 90
    for folder in ("layers", "sound"):
        for file in (reel / folder).iterdir():
            assert (tmp_path / "same" / folder / file.name).read_bytes() == file.read_bytes()
    assert same.manifest.presentation.title == "Balls"
    assert same.manifest.presentation.limits == original.manifest.presentation.limits
    assert same.manifest.presentation.poster is not None
    verify_reel(tmp_path / "same")


@pytest.mark.parametrize(("first", "end"), [(0, 6), (2, 18), (5, 9), (6, 12), (9, 10), (14, 18)])
def test_cut_shows_the_frames(reel: Path, tmp_path: Path, first: int, end: int) -> None:
    part, original = edit(reel, tmp_path / "part", f"cut={first}:{end}"), open_reel(reel)
    assert part.frames == end - first
    clear = [f for f in range(first, end) if f not in (6, 7, 12, 13) or f - first > 2]
    assert worst(part, original, [(frame - first, frame) for frame in clear]) > NOT_FADING


def test_cut_shifts_the_sound(reel: Path, tmp_path: Path) -> None:
    part, original = edit(reel, tmp_path / "part", "cut=0.5s:1.5s"), open_reel(reel)
    assert part.sound is not None
    assert original.sound is not None
    assert part.sound.position == (1.0, 0.0, 0.0)
    heard, truth = part.sound.samples(0, 1.0), original.sound.samples(0.5, 1.0)
    assert np.abs(heard - truth).max() < 0.3
    assert np.corrcoef(heard[:, 0], truth[:, 0])[0, 1] > 0.95


@pytest.mark.parametrize("at", [3, 6, 9, 11])
def test_cut_and_join_equal_the_original(reel: Path, tmp_path: Path, at: int) -> None:
    edit(reel, tmp_path / "a", f"cut=0:{at}")
    edit(reel, tmp_path / "b", f"cut={at}:18")
    joined, original = edit(tmp_path / "a", tmp_path / "c", f"join={tmp_path / 'b'}"), open_reel(reel)
    assert joined.frames == 18
    fading = {6: (6, 7)}.get(at, ())
    assert worst(joined, original, [(frame, frame) for frame in range(18) if frame not in fading]) > 40
    verify_reel(tmp_path / "c")


def test_join_has_a_hard_cut(reel: Path, tmp_path: Path) -> None:
    other = write_reel(tmp_path / "other", seed=9)
    joined = edit(reel, tmp_path / "joined", f"join={other}")
    groups = joined.manifest.groups
    assert [group.overlap for group in groups] == [None, None, None, 0, None, None]
    assert psnr(make_image(joined, 18), make_image(open_reel(other), 0)) > 90
    assert psnr(make_image(joined, 17), make_image(open_reel(reel), 17)) > 90
    assert joined.sound is not None
    assert joined.sound.duration == pytest.approx(3.6, abs=0.03)


def test_join_of_other_frame_rates_is_refused(reel: Path, tmp_path: Path) -> None:
    edit(reel, tmp_path / "slow", "fps=5")
    with pytest.raises(UsageError, match="fps=5 before join"):
        apply_operations(ReelClip(reel), [f"join={tmp_path / 'slow'}"])


def test_reverse_shows_everything_backwards(reel: Path, tmp_path: Path) -> None:
    back, original = edit(reel, tmp_path / "back", "reverse"), open_reel(reel)
    assert back.frames == 18
    assert worst(back, original, [(17 - frame, frame) for frame in range(18)]) > 40
    assert back.sound is not None
    assert original.sound is not None
    heard, truth = back.sound.samples(0, 1.8), original.sound.samples(0, 1.8)[::-1]
    assert np.corrcoef(heard[:, 0], truth[:, 0])[0, 1] > 0.9


def test_reverse_twice_is_the_original(reel: Path, tmp_path: Path) -> None:
    twice, original = edit(reel, tmp_path / "twice", "reverse", "reverse"), open_reel(reel)
    assert [group.first_frame for group in twice.manifest.groups] == [0, 6, 12]
    assert [layer.until for layer in twice.manifest.layers] == [2, None]
    assert worst(twice, original, [(frame, frame) for frame in range(18)]) > NOT_FADING


@pytest.mark.parametrize("fps", [5, 20, 24, 7.5])
def test_other_frame_rate_keeps_positions_at_seconds(reel: Path, tmp_path: Path, fps: float) -> None:
    other, original = edit(reel, tmp_path / "other", f"fps={fps}"), open_reel(reel)
    assert other.fps == fps
    assert other.duration == pytest.approx(original.duration, abs=0.5 / fps)
    for seconds in (0.0, 0.4, 1.0, 1.6):
        a, b = (reel_.at(seconds) for reel_ in (other, original))
        assert len(a) == len(b)
        center = np.abs(np.average(a.means, 0, a.opacities) - np.average(b.means, 0, b.opacities))
        assert center.max() < 0.01
    if fps == 20:
        assert worst(other, original, [(2 * frame, frame) for frame in range(18)]) > NOT_FADING


def test_reels_of_version_2_can_be_edited(tmp_path: Path) -> None:
    reel = write_chapters(tmp_path / "long")
    original = open_reel(reel)
    assert original.manifest.pages
    part = edit(reel, tmp_path / "part", "cut=5:19")
    assert worst(part, original, [(frame - 5, frame) for frame in range(5, 19)]) > 30
    twice = edit(reel, tmp_path / "twice", "reverse", "reverse")
    assert worst(twice, original, [(frame, frame) for frame in range(0, 25, 3)]) > 30


def test_window_of_a_live_reel_starts_at_zero(tmp_path: Path) -> None:
    writer = new_writer(tmp_path / "reel", first_group=3)
    writer.add_layer(1, 2, points(20))
    for index in (3, 4):
        writer.add_group(new_group(index, 5, 20, first_frame=2 * index))
    with pytest.raises(UsageError, match="still being written"):
        ReelClip(tmp_path / "reel")
    writer.finish()
    same = edit(tmp_path / "reel", tmp_path / "same")
    assert same.manifest.first_group == same.manifest.first_frame == 0
    assert same.frames == open_reel(tmp_path / "reel").frames - 6
    assert psnr(make_image(same, 2), make_image(open_reel(tmp_path / "reel"), 8)) > 30


def test_renditions_are_edited_alike(tmp_path: Path) -> None:
    reel = write_reel(tmp_path / "reel", 2, ("high", "low"))
    part = edit(reel, tmp_path / "part", "cut=2:12")
    assert part.manifest.renditions == ("high", "low")
    for name in part.manifest.renditions:
        a, b = (open_reel(folder, name) for folder in (tmp_path / "part", reel))
        assert worst(a, b, [(0, 2), (9, 11)]) > 35


def test_per_group_overlap_survives_a_rendition(tmp_path: Path) -> None:
    reel = write_reel(tmp_path / "reel", 2, ("high", "low"))
    joined = edit(reel, tmp_path / "joined", f"join={reel}")
    assert [group.overlap for group in joined.manifest.select_rendition("low").groups] == [None, None, 0, None]


def fade_of(reel: Timeline, frame: float) -> float | None:
    """Return the weight of the newer group at a frame, None outside of cross-fades."""
    fade = reel.at(frame / reel.fps).fade
    return None if fade is None else fade[2]


def test_overlap_of_a_group_overrides_that_of_the_reel(tmp_path: Path) -> None:
    writer = new_writer(tmp_path / "reel", overlap=2)
    for index, overlap in enumerate((None, 0, 1)):
        writer.add_group(replace(new_group(index, 5, 0), first_frame=2 * index), overlap=overlap)
    writer.finish()
    reel = open_reel(tmp_path / "reel")
    assert fade_of(reel, 2.0) is None
    assert fade_of(reel, 4.0) == 0
    assert fade_of(reel, 4.5) == 0.5
    assert fade_of(reel, 5.0) is None
