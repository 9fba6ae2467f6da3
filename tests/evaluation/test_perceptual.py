import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.evaluation import perceptual

torch = pytest.importorskip("torch")


@pytest.fixture
def lpips(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Install a stand-in for the package and return the path of its backbone's weights."""
    module = types.ModuleType("lpips")
    module.__spec__ = importlib.util.spec_from_loader("lpips", None)

    class LPIPS:
        def __init__(self, net: str, verbose: bool) -> None:
            assert (net, verbose) == ("vgg", False)

        def eval(self) -> "LPIPS":
            return self

        def __call__(self, a: Any, b: Any) -> Any:
            assert a.shape == (1, 3, 4, 5)
            return ((a - b) ** 2).mean()

    monkeypatch.setattr(module, "LPIPS", LPIPS, raising=False)
    monkeypatch.setitem(sys.modules, "lpips", module)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    return tmp_path / "checkpoints" / perceptual.BACKBONE


def test_lpips_downloads_nothing(lpips: Path) -> None:
    assert not perceptual.available()
    assert perceptual.load() is None


def test_lpips_receives_images_from_minus_one_to_one(lpips: Path) -> None:
    lpips.parent.mkdir()
    lpips.touch()
    distance = perceptual.load()
    assert distance is not None
    white, black = np.ones((4, 5, 3)), np.zeros((4, 5, 3))
    assert distance(white, black) == pytest.approx(4.0)
    assert distance(white, white) == 0.0
