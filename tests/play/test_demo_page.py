"""The sample reel of the package is complete and is the built-in film of two seconds."""

from pathlib import Path

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.play import demo_page


def test_the_sample_is_a_whole_reel_with_sound_and_poster() -> None:
    folder = demo_page.sample_reel()
    verify_reel(folder)
    reel = ReelReader(folder)
    assert (reel.frames, reel.duration, reel.manifest.live) == (60, 2.0, False)
    shown = reel.manifest.presentation
    assert (shown.title, shown.sound is None, shown.poster is None) == ("A toy room", False, False)
    assert sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) < 1_500_000


def test_a_missing_sample_is_reported_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_page, "SAMPLE", tmp_path)
    assert not demo_page.has_sample()
    with pytest.raises(ReelError, match="has no sample reel"):
        demo_page.sample_reel()
