"""Adam compared with its formula, over steps with and without gradients."""

import numpy as np
import pytest

from splatreel.kernels import adam

RATE, EPS = 0.02, 1e-15
ONCE = np.ones(1, np.float32)


class Plain:
    """Adam in float64, for one array and one gradient of the same shape a step.

    Source: Kingma and Ba 2015, "Adam: A method for stochastic optimization", algorithm 1.
    """

    def __init__(self, parameter: np.ndarray, number: int = 0) -> None:
        self.parameter, self.number = parameter.astype(np.float64), number
        self.mean, self.square = np.zeros_like(self.parameter), np.zeros_like(self.parameter)

    def step(self, gradient: np.ndarray | float) -> None:
        self.number += 1
        self.mean = 0.9 * self.mean + 0.1 * gradient
        self.square = 0.999 * self.square + 0.001 * np.square(gradient)
        mean, square = self.mean / (1 - 0.9**self.number), self.square / (1 - 0.999**self.number)
        self.parameter = self.parameter - RATE * mean / (np.sqrt(square) + EPS)


def begin(values: np.ndarray) -> adam.Trained:
    return adam.Trained(values, np.zeros_like(values), np.zeros_like(values))


def normal(state: np.random.Generator, *shape: int) -> np.ndarray:
    return state.normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(1,), (7, 3), (90, 45, 3), (25, 300, 7), (3, 0, 3)])
def test_adam_equals_formula(shape):
    state = np.random.default_rng(0)
    ours = normal(state, *shape)
    theirs, trained = Plain(ours), begin(ours)
    for number in range(1, 9):
        first = number % len(ours)
        gradient = normal(state, min(4, len(ours) - first), *shape[1:])
        whole = np.zeros(shape)
        whole[first : first + len(gradient)] = gradient
        theirs.step(whole)
        adam.adam([adam.Step(trained, gradient, ONCE, first, len(ours), (RATE, 0.9, 0.999, EPS, number))])
        np.testing.assert_allclose(ours, theirs.parameter, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(trained.mean, theirs.mean, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(trained.square, theirs.square, rtol=1e-4, atol=1e-7)


def test_adam_steps_many_arrays_and_shared_gradients():
    """One call steps a whole array and knots that share one gradient times factors, across chunks and past the end."""
    state = np.random.default_rng(0)
    factors = np.array([0.1, 0.5, -0.3, 0.2], np.float32)
    ours = [normal(state, 5000, 3), normal(state, 9, 700, 4), normal(state, 0, 3)]
    theirs, trained = [Plain(array) for array in ours], [begin(array) for array in ours]
    for number, first in enumerate((0, 3, 5, 7), 1):
        whole, shared, spread = normal(state, 5000, 3), normal(state, 1, 700, 4), np.zeros((9, 700, 4))
        for k, factor in enumerate(factors):
            if first + k < 9:
                spread[first + k] = factor * shared[0]
        nothing = np.zeros((0, 3), np.float32)
        for plain, gradient in zip(theirs, (whole, spread, nothing), strict=True):
            plain.step(gradient)
        parts = zip(trained, (whole, shared, nothing), (ONCE, factors, ONCE), (0, first, 0), strict=True)
        moment = RATE, 0.9, 0.999, EPS, number
        adam.adam([adam.Step(t, g, f, start, len(t.mean), moment) for t, g, f, start in parts])
        for array, plain in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(array, plain.parameter, rtol=1e-5, atol=1e-5)


def test_adam_changes_only_the_rows_of_a_step():
    state = np.random.default_rng(1)
    ours = normal(state, 9, 40, 3)
    before, trained, plain = ours.copy(), begin(ours), Plain(ours[2:6])
    gradient = normal(state, 1, 40, 3)
    plain.step(np.concatenate([np.zeros((1, 40, 3)), gradient, np.zeros((2, 40, 3))]))
    adam.adam([adam.Step(trained, gradient, ONCE, 3, 6, (RATE, 0.9, 0.999, EPS, 1), begin=2)])
    np.testing.assert_allclose(ours[2:6], plain.parameter, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(ours[[0, 1, 6, 7, 8]], before[[0, 1, 6, 7, 8]])


def test_adam_refuses_arrays_that_are_not_contiguous():
    """A flat copy of them would be trained in their place."""
    strided = np.zeros((4, 6), np.float32)[:, ::2]
    with pytest.raises(AssertionError):
        adam.adam([adam.Step(begin(strided), np.ones((4, 3), np.float32), ONCE, 0, 4, (RATE, 0.9, 0.999, EPS, 1))])


def test_catch_up_takes_missed_steps():
    """Rows that missed 0, 1 and 20 steps end where Adam without gradient takes them; other rows are left alone."""
    state = np.random.default_rng(0)
    start, mean = normal(state, 5, 40, 3), normal(state, 5, 40, 3)
    square = mean**2 + np.float32(1e-3)
    ours = [value.copy() for value in (start, mean, square)]
    counts, lengths, expected = np.array([0, 1, 20]), np.zeros(3), []
    for row, count in enumerate(counts):
        plain = Plain(start[1 + row], number=50)
        plain.mean, plain.square = mean[1 + row].astype(np.float64), square[1 + row].astype(np.float64)
        for number in range(51, 51 + count):
            plain.step(0.0)
            lengths[row] += RATE * np.sqrt(1 - 0.999**number) / (1 - 0.9**number) * (0.9 / 0.999**0.5) ** (number - 50)
        expected.append((plain.parameter, plain.mean, plain.square))
    columns = lengths, np.full(3, EPS), 0.9**counts, 0.999**counts
    adam.catch_up(adam.Missed(adam.Trained(*ours), 1, *(column.astype(np.float32) for column in columns)))
    for value, wanted, before in zip(ours, zip(*expected, strict=True), (start, mean, square), strict=True):
        np.testing.assert_allclose(value[1:4], wanted, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(value[[0, 4]], before[[0, 4]])


def test_signs_are_the_gradient_of_an_absolute_sum():
    values, slopes = np.array([[2.0, -3, 0], [-1, 0, 5]], np.float32), np.ones((2, 3), np.float32)
    adam.add_signs(values, np.array([0.1, 0.2, 0.3], np.float32), slopes)
    np.testing.assert_allclose(slopes, [[1.1, 0.8, 1], [0.9, 1, 1.3]])


@pytest.mark.oracle
def test_formula_equals_torch():
    torch = pytest.importorskip("torch")
    state = np.random.default_rng(0)
    plain = Plain(normal(state, 20, 3))
    theirs = torch.from_numpy(plain.parameter.copy()).requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=RATE, eps=EPS)
    for _ in range(5):
        gradient = state.normal(size=(20, 3))
        theirs.grad = torch.from_numpy(gradient)
        plain.step(gradient)
        optimizer.step()
    np.testing.assert_allclose(plain.parameter, theirs.detach().numpy(), rtol=1e-12)
