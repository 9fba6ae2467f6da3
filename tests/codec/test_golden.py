"""The golden reels decode to the numbers they always decoded to."""

import json

import numpy as np
import pytest

from splatreel.codec.reader import ReelReader
from splatreel.codec.verify import verify_reel
from tests import golden


@pytest.fixture(scope="module", params=[golden.GOLDEN, golden.PREDICTIVE], ids=["h265", "predictive"])
def path(request):
    return request.param


@pytest.fixture(scope="module")
def arrays(path):
    return golden.decoded(path)


def test_arrays(arrays, path):
    expected = np.load(path / "expected.npz")
    assert len(expected.files) == len([name for name in arrays if not name.startswith("at")])
    for name in expected.files:
        assert arrays[name].dtype == expected[name].dtype, name
        np.testing.assert_allclose(arrays[name], expected[name], rtol=1e-6, atol=1e-6, err_msg=name)


def test_samples(arrays, path):
    """The numbers the TypeScript decoder is tested against are the ones Python decodes."""
    expected = json.loads((path / "expected.json").read_text())
    assert set(expected["arrays"]) == set(arrays)
    for name, sample in expected["arrays"].items():
        assert list(arrays[name].shape) == sample["shape"], name
        found = arrays[name].ravel()[sample["index"]]
        tolerance = expected["tolerance"]
        np.testing.assert_allclose(found, sample["value"], rtol=tolerance, atol=tolerance, err_msg=name)


def test_is_valid_and_complete(path):
    assert verify_reel(path).groups == 2
    manifest = ReelReader(path).manifest
    assert (manifest.frames, manifest.overlap, manifest.live) == (14, 2, False)
    assert [layer.group for layer in manifest.layers] == [0, 1]
