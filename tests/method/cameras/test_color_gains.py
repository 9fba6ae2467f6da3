import torch

from splatreel.method.cameras.color_gains import CameraGains


def test_gains_are_learned_with_a_mean_of_one():
    gains = CameraGains(3, torch.device("cpu"), rate=0.01)
    truth = torch.tensor([0.9, 1.0, 1.1])
    image = torch.full((4, 4, 3), 0.5)
    for i in range(600):
        camera = i % 3
        (image * gains.of(camera) - truth[camera] * image).square().mean().backward()  # pyright: ignore[reportOperatorIssue]
        gains.step()
    torch.testing.assert_close(gains.values.mean(0), torch.ones(3))
    torch.testing.assert_close(gains.values[:, 0].detach(), truth, atol=0.02, rtol=0)


def test_disabled_gains_are_none():
    gains = CameraGains(2, torch.device("cpu"), enabled=False)
    assert gains.of(1) is None
    gains.step()
    assert (gains.values == 1).all()
