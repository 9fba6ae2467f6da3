"""Reading of COLMAP models."""

from pathlib import Path

import pytest

from splatreel.capture.opening import open_capture
from tests.capture import folders


def test_model_without_points_is_copied_where_links_are_not_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows allows links in developer mode only."""
    pytest.importorskip("pycolmap")

    def refuse(self: Path, target: Path, target_is_directory: bool = False) -> None:
        raise OSError(1314, "A required privilege is not held by the client")

    scene = folders.colmap(tmp_path / "scene")
    (scene / "sparse" / "0" / "points3D.txt").unlink()
    monkeypatch.setattr(Path, "symlink_to", refuse)
    assert open_capture(scene).points is None
