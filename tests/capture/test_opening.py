from pathlib import Path

import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture


@pytest.mark.parametrize("make", [True, False], ids=["empty folder", "no folder"])
def test_unknown_layout_lists_supported_ones(tmp_path: Path, make: bool) -> None:
    path = tmp_path / "nothing"
    if make:
        path.mkdir()
    with pytest.raises(CaptureError) as error:
        open_capture(path)
    for name in (
        str(path),
        "poses_bounds.npy",
        "train_meta.json",
        "cameras_parameters.txt",
        "intri.yml",
        "cameras.bin",
    ):
        assert name in str(error.value)
