"""Motion of all points from one frame to the next, as a small hash grid with a network: the cache of 3DGStream."""

from __future__ import annotations

import numpy as np

from splatreel.kernels import adam, hashgrid, splat
from splatreel.method.deform.hashgrid import IDENTITY, geometric, linear, linear_gradient, random_layer
from splatreel.method.deform.knot_adam import Adam


class MotionField:
    """Offsets of position and rotation as a function of position. It starts as no motion.

    Attributes:
        adams: Optimizers of the table [L, T, F] of the grid, and of the weights and biases of the two layers `hidden` and `out`.

    Source:
        3DGStream, section 4.1 (neural transformation cache), with fewer levels.
    """

    LEVELS, FEATURES, LOG2_ENTRIES = 8, 2, 13
    RESOLUTIONS = (8, 256)
    """Coarsest and finest number of cells along an axis."""
    WIDTH = 32
    GRID_PATH, NETWORK_PATH, MAX_RATE = 4.0, 2.0, 0.1
    """Learning rates times iterations, so that few iterations take large steps; and the largest rate."""
    REACH = 0.05
    """Unit of the network's output, in viewing distances."""

    def __init__(self, bounds: np.ndarray, unit: float, iterations: int, seed: int) -> None:
        """Create a field.

        Args:
            bounds: Box [2, 3] of the scene that the grid covers. Points outside use the nearest cell.
            unit: Typical viewing distance, world units.
            iterations: Iterations of training.
            seed: Seed of the initial values.
        """
        self.unit = unit
        low, high = np.asarray(bounds, np.float32)
        self.low, self.extent = low - 0.1 * unit, (high - low).max() + 0.2 * unit
        self.cells = np.stack([geometric(*self.RESOLUTIONS, self.LEVELS)] * 3, 1)
        rng = np.random.default_rng(seed)
        start = {"grid": rng.uniform(-1e-2, 1e-2, (self.LEVELS, 2**self.LOG2_ENTRIES, self.FEATURES))}
        start |= random_layer("hidden", self.LEVELS * self.FEATURES, self.WIDTH, rng)
        start |= {"out": np.zeros((self.WIDTH, 7)), "out_bias": np.zeros(7)}
        paths = {name: self.GRID_PATH if name == "grid" else self.NETWORK_PATH for name in start}
        self.base_rates = {name: min(path / max(iterations, 1), self.MAX_RATE) for name, path in paths.items()}
        self.adams = {name: Adam(value, self.base_rates[name], eps=1e-15) for name, value in start.items()}

    def offsets(self, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return dx [N, 3], world units, and dq [N, 4], about the identity, of points at means [N, 3]."""
        found = linear(self._values, "out", self._hidden(self._features(self._places(means))))
        return found[:, :3] * (self.REACH * self.unit), 0.1 * found[:, 3:] + IDENTITY

    def gradient(self, means: np.ndarray, d_dx: np.ndarray, d_dq: np.ndarray) -> dict[str, np.ndarray]:
        """Return the gradients to all parameters by name, given those to `offsets`. Positions are constants."""
        values, found, places = self._values, dict[str, np.ndarray](), self._places(means)
        features = self._features(places)
        hidden = self._hidden(features)
        d_out = np.concatenate([d_dx * (self.REACH * self.unit), 0.1 * d_dq], 1)
        d_hidden = linear_gradient(found, values, "out", hidden, d_out) * (hidden > 0)
        d_features = np.ascontiguousarray(linear_gradient(found, values, "hidden", features, d_hidden))
        found["grid"] = hashgrid.table_gradient(places, values["grid"], d_features, self.cells)
        return found

    def step(self, gradients: dict[str, np.ndarray], share: float) -> None:
        """Follow the gradients to all parameters. share: share of training that is over, 0..1."""
        for name, one in self.adams.items():
            one.rate = self.base_rates[name] * 0.1**share
        adam.adam([one.follow(gradients[name]) for name, one in self.adams.items()])

    def check(self) -> None:
        """Raise `GaussiansError` if a value is NaN or infinite."""
        splat.check_finite(**self._values)

    @property
    def _values(self) -> dict[str, np.ndarray]:
        return {name: one.parameter for name, one in self.adams.items()}

    def _places(self, means: np.ndarray) -> np.ndarray:
        """Return positions in the unit cube of the grid."""
        return np.clip((means - self.low) / self.extent, 0, np.float32(1 - 1e-6))

    def _features(self, places: np.ndarray) -> np.ndarray:
        return hashgrid.forward(places, self._values["grid"], self.cells)

    def _hidden(self, features: np.ndarray) -> np.ndarray:
        return np.maximum(linear(self._values, "hidden", features), 0)
