"""Files of captures and masks: names, and addresses whose server fails, cuts transfers, ignores ranges or refuses access."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError, StorageError, UsageError
from splatreel.capture.files import natural_key
from splatreel.capture.opening import open_capture
from tests.buckets import Bucket, Faults
from tests.capture import folders
from tests.capture.test_masks import write_masks


@pytest.mark.parametrize("fault", ["is_busy", "cuts", "ignores_ranges"])
@pytest.mark.parametrize("layout", [folders.neu3dv, folders.panoptic])
def test_capture_and_masks_are_read_though_each_first_request_fails(
    faulty: tuple[Bucket, Faults], tmp_path: Path, layout, fault: str
) -> None:
    bucket, faults = faulty
    local = layout(tmp_path / "capture")
    masks = write_masks(tmp_path / "masks") if layout is folders.panoptic else None
    address = bucket.upload(local, "capture")
    there_masks = None if masks is None else bucket.upload(masks, "masks")
    here = open_capture(local, masks=masks)
    faults.begin(fault, ("GET",))
    there = open_capture(address, masks=there_masks)
    names = [camera.name for camera in here.cameras]
    assert np.array_equal(there.read(0, here.frames, names), here.read(0, here.frames, names))
    assert there.describe() == here.describe()
    if masks is not None:
        found, expected = there.alpha(0, 2, names), here.alpha(0, 2, names)
        assert found is not None
        assert expected is not None
        assert np.array_equal(found, expected)
    assert faults.met > len(names)
    there.close()
    here.close()


def test_private_and_missing_captures_and_masks_are_explained(faulty: tuple[Bucket, Faults], tmp_path: Path) -> None:
    bucket, faults = faulty
    address = bucket.upload(folders.panoptic(tmp_path / "capture"), "capture")
    with pytest.raises(CaptureError, match=r"s3://.*/masks: there are no files"):
        open_capture(address, masks=bucket.url("masks"))
    faults.begin("is_private", ("GET",), 100)
    with pytest.raises(StorageError, match="is private"):
        open_capture(address)
    assert faults.met == 1
    with pytest.raises(UsageError, match="do not list their files"):
        open_capture("https://host.example/capture")


def test_names_are_sorted_by_their_decimal_digits_only() -> None:
    """Superscripts are digits to Python, but no numbers."""
    names = ["10", "9", "²", "³", "a10", "a9", "٣"]
    assert sorted(names, key=natural_key) == ["9", "10", "a9", "a10", "²", "³", "٣"]
