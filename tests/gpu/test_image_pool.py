"""The cache of training images on the device."""

import numpy as np
import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu.image_pool import ImagePool
from tests.gpu.devices import software_gpu

WIDTH, HEIGHT = 8, 4


def image(number: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 4), number, np.uint8)


def content(pool: ImagePool, frame: int, loaded: list[int]) -> int:
    """Return the value that fills an image on the device. loaded: gets the frames that were copied there."""

    def load() -> np.ndarray:
        loaded.append(frame)
        return image(frame)

    buffer, first = pool.get(frame, 0, load)
    pixels = software_gpu().read(buffer, np.uint8, (4 * (first + WIDTH * HEIGHT),))[4 * first :]
    assert len(set(pixels.tolist())) == 1
    return int(pixels[0])


def test_the_image_that_was_not_used_for_the_longest_time_is_replaced() -> None:
    pool, loaded = ImagePool(software_gpu(), WIDTH, HEIGHT, 5, bound=3 * 4 * WIDTH * HEIGHT), list[int]()
    pool._in_buffer = 1  # each image in a buffer of its own
    for frame in (0, 1, 2, 0, 3, 0, 1):
        assert content(pool, frame, loaded) == frame
    assert loaded == [0, 1, 2, 3, 1]


@pytest.mark.parametrize("seed", range(5))
def test_images_are_spread_over_buffers_of_any_limit(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    gpu, rng, loaded = software_gpu(), np.random.default_rng(seed), list[int]()
    monkeypatch.setattr(gpu, "largest", 64 * int(rng.integers(2, 30)))
    pool = ImagePool(gpu, WIDTH, HEIGHT, 40)
    frames = [int(frame) for frame in rng.integers(0, 40, 60)]
    assert [content(pool, frame, loaded) for frame in frames] == frames
    assert sorted(loaded) == sorted(set(frames)), "all images stay on the device"
    assert all(buffer.size <= gpu.largest for buffer in pool._buffers)
    assert len(pool._buffers) > 1


def test_where_memory_is_short_fewer_images_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    gpu, loaded = software_gpu(), list[int]()
    pool = ImagePool(gpu, WIDTH, HEIGHT, 5)
    pool._in_buffer = 1
    assert content(pool, 0, loaded) == 0

    def full(nbytes: int, label: str = "") -> None:
        raise GpuError("no room")

    monkeypatch.setattr(gpu, "zeros", full)
    assert [content(pool, frame, loaded) for frame in (1, 0)] == [1, 0]
    assert loaded == [0, 1, 0]
    with pytest.raises(GpuError, match="no room"):
        ImagePool(gpu, WIDTH, HEIGHT, 5).get(0, 0, lambda: image(0))
