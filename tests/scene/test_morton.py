"""Morton codes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.scene import morton

coordinate = st.integers(0, (1 << morton.MAX_BITS) - 1)


def test_morton_known_answers():
    q = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [3, 3, 3], [(1 << 21) - 1] * 3])
    assert morton.encode(q).tolist() == [1, 2, 4, 8, 63, (1 << 63) - 1]


@settings(deadline=None)
@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1))
def test_morton_round_trip(points):
    q = np.array(points)
    np.testing.assert_array_equal(morton.decode(morton.encode(q)), q)


@settings(deadline=None)
@given(coordinate, coordinate, coordinate)
def test_morton_code_interleaves_bits(x, y, z):
    digits = "".join(f"{z >> b & 1}{y >> b & 1}{x >> b & 1}" for b in reversed(range(morton.MAX_BITS)))
    assert int(morton.encode(np.array([[x, y, z]]))[0]) == int(digits, 2)
