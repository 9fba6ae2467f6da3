"""The mean over the last iterations: less noise than where training ended."""

import torch

from splatreel.recon.train.average import EVERY, Average


def test_it_is_the_mean_of_what_counted() -> None:
    average, tensor = Average(0.5, 8 * EVERY), torch.zeros(3)
    for done in range(1, 8 * EVERY + 1):
        tensor.fill_(done)
        if average.runs(done):
            average.add(done, [tensor])
    average.settle([tensor])
    torch.testing.assert_close(tensor, torch.full((3,), (5 + 6 + 7 + 8) * EVERY / 4))


def test_it_is_nearer_than_where_noisy_steps_end() -> None:
    generator = torch.Generator().manual_seed(0)
    average, place = Average(0.5, 1000), torch.ones(100)
    for done in range(1, 1001):
        place -= 0.1 * (place + torch.randn(100, generator=generator))
        if average.runs(done):
            average.add(done, [place])
    ended = place.abs().mean()
    average.settle([place])
    assert place.abs().mean() < 0.5 * ended


def test_no_share_leaves_all_as_it_is() -> None:
    average, tensor = Average(0.0, 100), torch.ones(2)
    assert not average.runs(100)
    average.settle([tensor])
    torch.testing.assert_close(tensor, torch.ones(2))


def test_it_starts_anew_where_rows_go() -> None:
    average = Average(1.0, 100)
    average.add(EVERY, [torch.zeros(3)])
    average.add(2 * EVERY, [torch.ones(2)])
    average.add(3 * EVERY, [torch.full((2,), 2.0)])
    kept, gone = torch.zeros(2), torch.zeros(5)
    average.settle([kept])
    torch.testing.assert_close(kept, torch.full((2,), 1.5))
    average.settle([gone])
    torch.testing.assert_close(gone, torch.zeros(5))
