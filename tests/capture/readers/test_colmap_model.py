"""Reading of COLMAP models."""

import os
from pathlib import Path

import pytest

from splatreel.capture.opening import open_capture
from splatreel.capture.readers.colmap_model import write_model
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


@pytest.mark.parametrize(("file", "bytes_kept"), [("cameras.bin", 10), ("images.bin", 0), ("points3D.bin", 4)])
def test_a_model_that_a_full_disk_cut_is_noticed(tmp_path: Path, file: str, bytes_kept: int) -> None:
    """COLMAP itself says nothing."""
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=8, height=8, params=[8, 8, 4, 4], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    model.add_image_with_trivial_frame(pycolmap.Image(name="a.png", camera_id=1, image_id=1), pycolmap.Rigid3d())
    write_model(model, tmp_path / "whole")
    assert pycolmap.Reconstruction(str(tmp_path / "whole")).num_images() == 1

    class Cut:
        def __getattr__(self, name: str) -> object:
            return getattr(model, name)

        def write_binary(self, folder: str) -> None:
            model.write_binary(folder)
            os.truncate(Path(folder) / file, bytes_kept)

    with pytest.raises(OSError, match="No space left"):
        write_model(Cut(), tmp_path / "cut")
