"""Previews of a run: reels of one frame, of which the newest stays."""

from pathlib import Path

import numpy as np

from splatreel.codec.preview import FOLDER, newest_preview, remove_previews, write_preview
from splatreel.codec.reader import ReelReader
from tests.codec.reels import new_header, points


def test_the_newest_preview_stays_and_is_a_live_reel_of_one_frame(tmp_path: Path) -> None:
    assert newest_preview(tmp_path) is None
    head = new_header()
    first = write_preview(tmp_path, head, None, points(30))
    assert newest_preview(tmp_path) == first
    shown = points(40, seed=1)
    second = write_preview(tmp_path, head, None, shown)
    assert newest_preview(tmp_path) == second != first
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == [second.name]
    reel = ReelReader(second)
    assert (reel.manifest.live, reel.frames, len(reel.manifest.groups)) == (True, 1, 1)
    np.testing.assert_allclose(np.sort(reel.layer(0).means[:, 0]), np.sort(shown.means[:, 0]), atol=0.01)
    remove_previews(tmp_path)
    assert newest_preview(tmp_path) is None


def test_a_preview_that_a_killed_process_left_without_a_manifest_is_ignored_and_replaced(tmp_path: Path) -> None:
    unfinished = tmp_path / FOLDER / "0001" / "layers"
    unfinished.mkdir(parents=True)
    (unfinished / "0007.safetensors").write_bytes(b"half")
    assert newest_preview(tmp_path) is None
    made = write_preview(tmp_path, new_header(), None, points(30))
    assert not (made / "layers" / "0007.safetensors").exists()
