"""The golden reels decode to the same numbers as always."""

import json

import numpy as np
import pytest

from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from tests import golden, golden_long
from tests.files import contents


@pytest.fixture(scope="module", params=[golden.GOLDEN, golden.PREDICTIVE], ids=["h265", "predictive"])
def path(request):
    return request.param


@pytest.fixture(scope="module")
def arrays(path):
    return golden.decoded(path)


def test_golden_arrays_are_unchanged(arrays, path):
    expected = np.load(path / "expected.npz")
    assert len(expected.files) == len([name for name in arrays if not name.startswith("at")])
    for name in expected.files:
        assert arrays[name].dtype == expected[name].dtype, name
        np.testing.assert_allclose(arrays[name], expected[name], rtol=1e-6, atol=1e-6, err_msg=name)


def test_golden_samples_are_unchanged(arrays, path):
    """The numbers in the TypeScript decoder's tests are those that Python decodes."""
    expected = json.loads((path / "expected.json").read_text())
    assert set(expected["arrays"]) == set(arrays)
    for name, sample in expected["arrays"].items():
        assert list(arrays[name].shape) == sample["shape"], name
        found = arrays[name].ravel()[sample["index"]]
        tolerance = expected["tolerance"]
        np.testing.assert_allclose(found, sample["value"], rtol=tolerance, atol=tolerance, err_msg=name)


def test_golden_reel_is_valid_and_complete(path):
    assert verify_reel(path).groups == 2
    manifest = ReelReader(path).manifest
    assert (manifest.frames, manifest.overlap, manifest.live) == (14, 2, False)
    assert [layer.group for layer in manifest.layers] == [0, 1]


@pytest.mark.parametrize("path", [golden_long.LONG, golden_long.WINDOW], ids=["long", "window"])
def test_golden_version_2_reels_are_unchanged(path):
    said, found = json.loads((path / "expected.json").read_text()), golden_long.expected(path)
    assert {name: said[name] for name in ("living", "times")} == {name: found[name] for name in ("living", "times")}
    assert set(said["arrays"]) == set(found["arrays"])
    for name, sample in said["arrays"].items():
        assert sample["shape"] == found["arrays"][name]["shape"], name
        tolerance, values = said["tolerance"], found["arrays"][name]["value"]
        np.testing.assert_allclose(values, sample["value"], rtol=tolerance, atol=tolerance, err_msg=name)


def test_golden_version_2_reels_use_its_features():
    long, window = (ReelReader(path).manifest for path in (golden_long.LONG, golden_long.WINDOW))
    assert (len(long.pages), long.first_group, long.renditions, long.live) == (4, 0, ("high", "low"), False)
    assert (len(window.pages), window.first_group, window.renditions, window.live) == (2, 4, (), True)
    for path in (golden_long.LONG, golden_long.WINDOW):
        assert verify_reel(path).strangers == ["expected.json"]
        assert json.loads((path / "manifest.json").read_text())["version"] == 2


@pytest.mark.parametrize("name", ["manifest.json", "pages/000004.json"])
def test_writer_splits_pages_like_the_golden_reel(tmp_path, name):
    """Digests and lengths are excluded, because they depend on the machine's rounding."""
    golden_long.write_window(tmp_path)
    assert contents(tmp_path).keys() | {"expected.json"} == contents(golden_long.WINDOW).keys()

    def plain(path):
        document = json.loads((path / name).read_text())
        for entry in (x for kind in ("pages", "layers", "groups") for x in document.get(kind, [])):
            del entry["bytes"], entry["sha256"]
        return document | {"generator": ""}

    assert plain(tmp_path) == plain(golden_long.WINDOW)
