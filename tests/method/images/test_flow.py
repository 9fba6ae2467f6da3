"""Optical flow by DIS and RAFT."""

import sys
import types
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.method.images.flow import RAFT, DisFlow, RaftFlow, make_flow
from splatreel.method.images.pretrained import cached_weights


def textured(height: int = 96, width: int = 128, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return (255 * (smooth - smooth.min()) / (smooth.max() - smooth.min())).astype(np.uint8)


def test_dis_measures_a_shift() -> None:
    a = textured()
    b = np.roll(a, (2, 3), (0, 1))
    flow = make_flow("dis")(a, b)
    assert flow.shape == (96, 128, 2)
    assert flow.dtype == np.float32
    np.testing.assert_allclose(np.median(flow[20:-20, 20:-20], (0, 1)), [3, 2], atol=0.2)


@pytest.mark.parametrize(("size", "closely"), [(8, False), (12, False), (12, True)])
def test_dis_finds_small_fast_content_from_guess(size: int, closely: bool) -> None:
    a, thing = textured() // 2, textured(size, size, seed=1)
    b = a.copy()
    a[40 : 40 + size, 30 : 30 + size], b[44 : 44 + size, 60 : 60 + size] = thing, thing
    guess = np.zeros((96, 128, 2), np.float32)
    guess[38 : 42 + size, 28 : 32 + size] = 28, 2
    wanted = (guess != 0).any(-1) if closely else None
    given, flow = guess.copy(), DisFlow()
    middle = slice(42, 38 + size), slice(32, 28 + size)
    alone, guided = (np.median(f[middle], (0, 1)) for f in (flow(a, b, None, wanted), flow(a, b, guess, wanted)))
    assert np.abs(alone - [30, 4]).max() > 10
    np.testing.assert_allclose(guided, [30, 4], atol=0.5)
    np.testing.assert_array_equal(guess, given, err_msg="the guess is only read")


def test_dis_looks_finely_only_in_wanted_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    a = textured(192, 256)
    b = np.roll(a, (2, 3), (0, 1))
    wanted, nothing = np.zeros((192, 256), bool), np.zeros((192, 256), bool)
    wanted[60:64, 100:104] = wanted[72:90, 110] = wanted[189:, 250:] = True
    looked: list[tuple[int, ...]] = []

    class Counted:
        def __init__(self, finest: int) -> None:
            self.finest, self.dis = finest, cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
            self.dis.setFinestScale(finest)

        def calc(self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
            looked.append((self.finest, *a.shape))
            return self.dis.calc(a, b, guess)  # pyright: ignore[reportArgumentType, reportCallIssue]

    monkeypatch.setattr("splatreel.method.images.flow._dis", Counted)
    flow = DisFlow()(a, b, None, wanted)
    inside = wanted & (np.arange(256) < 250)
    np.testing.assert_allclose(flow[inside], np.broadcast_to([3, 2], (inside.sum(), 2)), atol=0.3)
    whole_then_boxes = [(2, 192, 256), (1, 58, 39), (1, 29, 29)]
    assert looked == whole_then_boxes, "what lies close together shares a box, and only boxes are compared at half size"
    looked.clear()
    far = DisFlow()(a, b, None, nothing)
    np.testing.assert_allclose(np.median(far[20:-20, 20:-20], (0, 1)), [3, 2], atol=0.3)
    assert looked == [(2, 192, 256)]
    looked.clear()
    everything = DisFlow()(a, b, None, ~nothing)
    np.testing.assert_array_equal(everything, DisFlow()(a, b))
    assert looked == [(1, 192, 256)] * 2, "half size is enough for images of 200 pixels and more"
    looked.clear()
    DisFlow()(a[:, :160], b[:, :160])
    assert looked == [(0, 192, 160)]


@pytest.mark.parametrize("size", [(16, 40), (17, 17), (20, 300), (31, 200), (40, 2600)])
def test_dis_uses_full_size_for_small_images(size: tuple[int, int]) -> None:
    a, wanted = textured(*size), np.zeros(size, bool)
    wanted[0, 0] = wanted[-1, -1] = True
    flow = DisFlow()(a, a, None, wanted)
    assert flow.shape == (*size, 2)
    assert np.abs(flow).max() < 0.2


def test_dis_accepts_alternating_image_sizes() -> None:
    """An OpenCV object for a small image crashes the process if it is used for a larger one."""
    flow, sizes = DisFlow(), [(42, 68), (96, 128), (17, 30), (200, 260)]
    for height, width in sizes:
        a = textured(height, width)
        np.testing.assert_array_equal(flow(a, a[::-1]), DisFlow()(a, a[::-1]))


def test_dis_accepts_tiny_images() -> None:
    a = textured(9, 20)
    for guess in (None, np.zeros((9, 20, 2), np.float32)):
        flow = DisFlow()(a, a, guess)
        assert flow.shape == (9, 20, 2)
        assert np.abs(flow).max() < 0.2


def test_make_flow_refuses_unknown_name() -> None:
    with pytest.raises(UsageError, match="'farneback'"):
        make_flow("farneback")


class ConstantFlow:
    """Replacement of torchvision's RAFT. It checks its input, and returns worse flows before a known one."""

    def to(self, device: Any) -> "ConstantFlow":
        return self

    def eval(self) -> "ConstantFlow":
        return self

    def __call__(self, a: Any, b: Any, num_flow_updates: int) -> list[Any]:
        torch = pytest.importorskip("torch")
        assert a.shape == b.shape
        assert a.shape[2] % 8 == 0
        assert a.shape[3] % 8 == 0
        assert min(a.shape[2:]) >= 128
        assert a.min() >= -1
        assert a.max() <= 1
        rows = torch.arange(a.shape[2], dtype=torch.float32)[None, None, :, None]
        last = torch.cat([torch.full_like(a[:, :1], 4.0), torch.zeros_like(a[:, :1]) + rows], 1)
        return [torch.zeros_like(last)] * (num_flow_updates - 1) + [last]


def test_raft_pads_scales_and_crops() -> None:
    pytest.importorskip("torch")
    flow = RaftFlow(model=ConstantFlow(), device="cpu", updates=3)(textured(90, 131), textured(90, 131))
    assert flow.shape == (90, 131, 2)
    assert (flow[..., 0] == 4).all()
    np.testing.assert_array_equal(flow[:, 0, 1], np.arange(90))


def test_raft_network_runs_with_random_weights() -> None:
    torch = pytest.importorskip("torch")
    try:
        from torchvision.models.optical_flow import raft_small
    except (ImportError, RuntimeError):
        pytest.skip("torchvision that fits this torch is not installed")
    torch.manual_seed(0)
    flow = RaftFlow(model=raft_small(weights=None), device="cpu", updates=2)(textured(130, 140), textured(130, 140, 1))
    assert flow.shape == (130, 140, 2)
    assert np.isfinite(flow).all()


def fake_torchvision(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Replace torchvision by modules whose RAFT is a small network. Return torch, or skip the test."""
    torch = pytest.importorskip("torch")
    names = ("torchvision", "torchvision.models", "torchvision.models.optical_flow")
    modules = {name: types.ModuleType(name) for name in names}
    monkeypatch.setattr(modules[names[2]], "raft_large", lambda weights: torch.nn.Linear(2, 2), raising=False)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return torch


def test_raft_without_torchvision_names_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torchvision", None)
    monkeypatch.setitem(sys.modules, "torchvision.models.optical_flow", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[models\]"):
        make_flow("raft")


def test_raft_without_weights_names_path(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    fake_torchvision(monkeypatch)
    monkeypatch.setenv(RAFT.variable, str(tmp_path / "absent.pth"))
    with pytest.raises(MissingDependencyError, match=r"absent\.pth does not exist.*download\.pytorch\.org"):
        RaftFlow()


def test_weights_lie_in_the_cache_of_the_hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TORCH_HOME", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cached_weights("raft.pth") == tmp_path / "cache" / "torch" / "hub" / "checkpoints" / "raft.pth"
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "home"))
    assert cached_weights("raft.pth") == tmp_path / "home" / "hub" / "checkpoints" / "raft.pth"
    torch = pytest.importorskip("torch")
    assert cached_weights("raft.pth") == Path(torch.hub.get_dir()) / "checkpoints" / "raft.pth"
    for name in ("TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name)
    assert cached_weights("raft.pth") == Path(torch.hub.get_dir()) / "checkpoints" / "raft.pth"


def test_raft_refuses_other_weights_and_loads_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    torch = fake_torchvision(monkeypatch)
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(MissingDependencyError, match=r"text\.pth: not the weights"):
        RaftFlow(tmp_path / "text.pth")
    expected = torch.nn.Linear(2, 2)
    torch.save(expected.state_dict(), tmp_path / "good.pth")
    monkeypatch.setenv(RAFT.variable, str(tmp_path / "good.pth"))
    assert torch.equal(RaftFlow(device="cpu").model.weight, expected.weight)
