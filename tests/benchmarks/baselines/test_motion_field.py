import numpy as np

from baselines.motion_field import MotionField

BOX = np.array([[-1.0, -1, -1], [1, 1, 1]])


def places(count: int, reach: float = 1.0) -> np.ndarray:
    return np.random.default_rng(0).uniform(-reach, reach, (count, 3)).astype(np.float32)


def test_field_starts_as_no_motion() -> None:
    dx, dq = MotionField(BOX, 3.0, 100, 0).offsets(places(50, 2.0))
    assert (dx == 0).all()
    assert (dq == [1, 0, 0, 0]).all()


def test_gradient_is_that_of_finite_differences() -> None:
    rng, means = np.random.default_rng(1), places(6)
    field = MotionField(BOX, 3.0, 100, 0)
    for name in ("out", "out_bias", "grid"):
        field.adams[name].parameter[:] = rng.normal(0, 0.5, field.adams[name].parameter.shape)
    weights = [rng.normal(size=(6, size)).astype(np.float32) for size in (3, 4)]

    def loss() -> float:
        parts = zip(field.offsets(means), weights, strict=True)
        return sum(float((offset * weight).sum(dtype=np.float64)) for offset, weight in parts)

    found = field.gradient(means, *weights)
    assert sorted(found) == sorted(field.adams)
    for name, slope in found.items():
        value = field.adams[name].parameter
        assert value.shape == slope.shape
        for place in np.argsort(-np.abs(slope), axis=None)[:5]:  # the largest: most of the table is not read
            before, ends = value.flat[place], []
            for sign in (1, -1):
                value.flat[place] = before + sign * 1e-3
                ends.append(loss())
            value.flat[place] = before
            np.testing.assert_allclose((ends[0] - ends[1]) / 2e-3, slope.flat[place], rtol=1e-2, atol=1e-3)


def test_field_learns_different_motions_at_different_places() -> None:
    means = places(200)
    wanted = np.where(means[:, :1] > 0, np.array([[0.1, 0, 0]], np.float32), np.array([[0, -0.05, 0]], np.float32))
    field, still = MotionField(BOX, 3.0, 150, 0), np.zeros((200, 4), np.float32)
    for iteration in range(150):
        dx, _ = field.offsets(means)
        field.step(field.gradient(means, np.sign(dx - wanted) / np.float32(200), still), iteration / 150)
    field.check()
    assert np.median(np.linalg.norm(field.offsets(means)[0] - wanted, axis=1)) < 0.02
