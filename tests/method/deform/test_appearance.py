"""Colors and opacities that change within a group."""

import torch

from splatreel.method.deform.appearance import Appearance, detect_cuts

CPU = torch.device("cpu")


def learn(shade: Appearance, wanted, iterations: int, frames: int) -> None:
    for i in range(iterations):
        frame = i % frames
        now = shade.at(frame)
        (100 * (now - wanted(frame)).square().mean()).backward()
        shade.step(i / iterations)


def test_appearance_starts_at_zero_and_learns():
    frames = 20
    shade = Appearance(frames, 2, CPU)
    assert not shade.at(7.3).any()

    def wanted(frame: float) -> torch.Tensor:
        u = frame / (frames - 1)
        return torch.tensor([[0.5 * u, 0, -0.5 * u, -3 * u], [0, 0, 0, 0]])

    learn(shade, wanted, 600, frames)
    for frame in (0, 8, 19, 12.5):
        torch.testing.assert_close(shade.at(frame), wanted(frame), atol=0.08, rtol=0.1)


def test_appearance_without_gradient_decays_to_zero():
    shade = Appearance(10, 3, CPU)
    with torch.no_grad():
        shade.controls.add_(2.0)
    for i in range(200):
        (0 * shade.at(i % 10)).sum().backward()
        shade.step(i / 200)
    assert shade.at(5).abs().max() < 0.01


def test_appearance_rows_follow_points():
    shade = Appearance(10, 3, CPU)
    learn(shade, lambda frame: torch.tensor([[0.1], [0.2], [0.3]]).expand(3, 4), 20, 10)
    before = shade.at(4.0).detach().clone()
    shade.append(2, torch.tensor([2, 0]))
    shade.append(1, None)
    torch.testing.assert_close(shade.at(4.0)[:5], before[[0, 1, 2, 2, 0]])
    assert not shade.at(4.0)[5].any()
    shade.keep(torch.tensor([5, 3, 1]))
    torch.testing.assert_close(shade.at(4.0)[1:], before[[2, 1]])
    assert shade.highest.shape == (3,)
    assert (shade.highest >= shade.at(4.0)[:, 3]).all()
    learn(shade, lambda frame: torch.full((3, 4), 0.2), 100, 10)
    torch.testing.assert_close(shade.at(3), torch.full((3, 4), 0.2), atol=0.1, rtol=0)


def test_appearance_starts_from_given_shades():
    wanted = torch.zeros(20, 3, 3)
    wanted[:, 1] = torch.sin(torch.arange(20) / 4)[:, None] * torch.tensor([0.5, 0.2, -0.5])
    shade = Appearance(20, 3, CPU, wanted)
    for frame in range(20):
        torch.testing.assert_close(shade.at(frame)[:, :3], wanted[frame], atol=0.08, rtol=0)
        assert not shade.at(frame)[:, 3].any(), "opacities start as they are"


def make_images(frames: int = 20) -> torch.Tensor:
    """Return images [T, 2, 40, 60, 3] uint8 of a bar that moves by a pixel per frame over gray noise."""
    rng = torch.Generator().manual_seed(0)
    images = torch.randint(100, 120, (frames, 2, 40, 60, 3), generator=rng, dtype=torch.uint8)
    for t in range(frames):
        images[t, :, 5:35, 2 * t : 2 * t + 8] = 220
    return images


def test_detect_cuts_ignores_motion():
    assert detect_cuts(make_images()) == []
    cut = make_images()
    cut[9:, :, 30:, 40:] = 20  # a screen turns dark, and stays dark
    assert detect_cuts(cut) == [9]
    assert detect_cuts(cut[:1]) == []
    assert detect_cuts(cut[:2]) == []


def test_appearance_keeps_cuts_sharp():
    def wanted(frame: float) -> torch.Tensor:
        return torch.full((1, 4), 0.4 if frame >= 9 else 0.0) * torch.tensor([1.0, -1, 1, 0])

    off = {}
    for cuts in ((), (9,)):
        shade = Appearance(20, 1, CPU, cuts=cuts)
        learn(shade, wanted, 1500, 20)
        off[cuts] = max(float((shade.at(frame).detach() - wanted(frame)).abs().max()) for frame in range(20))
    assert off[9,] < 0.06
    assert off[()] > 2.5 * off[9,]
