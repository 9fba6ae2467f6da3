"""The mean over the last iterations: less noise than where training ended."""

import torch

from splatreel.recon.train.keyframe import AVERAGE_EVERY, Average


def test_it_is_the_mean_of_what_counted() -> None:
    average, tensor = Average(0.5, 8 * AVERAGE_EVERY), torch.zeros(3)
    for done in range(1, 8 * AVERAGE_EVERY + 1):
        tensor.fill_(done)
        if average.has_begun(done):
            average.add(done, [tensor])
    average.write_to([tensor])
    torch.testing.assert_close(tensor, torch.full((3,), (5 + 6 + 7 + 8) * AVERAGE_EVERY / 4))


def test_it_is_nearer_than_where_noisy_steps_end() -> None:
    generator = torch.Generator().manual_seed(0)
    average, place = Average(0.5, 1000), torch.ones(100)
    for done in range(1, 1001):
        place -= 0.1 * (place + torch.randn(100, generator=generator))
        if average.has_begun(done):
            average.add(done, [place])
    ended = place.abs().mean()
    average.write_to([place])
    assert place.abs().mean() < 0.5 * ended


def test_no_share_leaves_all_as_it_is() -> None:
    average, tensor = Average(0.0, 100), torch.ones(2)
    assert not average.has_begun(100)
    average.write_to([tensor])
    torch.testing.assert_close(tensor, torch.ones(2))


def test_it_starts_anew_where_rows_go() -> None:
    average = Average(1.0, 100)
    average.add(AVERAGE_EVERY, [torch.zeros(3)])
    average.add(2 * AVERAGE_EVERY, [torch.ones(2)])
    average.add(3 * AVERAGE_EVERY, [torch.full((2,), 2.0)])
    kept, gone = torch.zeros(2), torch.zeros(5)
    average.write_to([kept])
    torch.testing.assert_close(kept, torch.full((2,), 1.5))
    average.write_to([gone])
    torch.testing.assert_close(gone, torch.zeros(5))
