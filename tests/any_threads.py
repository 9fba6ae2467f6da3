"""Results that do not depend on the number of threads."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from splatreel.base import threads


def assert_same_on_any_threads(compute: Callable[[], Any]) -> None:
    """Compute a value on 1, 2 and 3 threads, and compare all bytes of its arrays."""
    found = []
    for number in (1, 2, 3):
        with threads.limited(number):
            found.append(_content(compute()))
    assert found[0] == found[1] == found[2]


def _content(value: Any) -> Any:
    """Return a value with its arrays as bytes."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, (list, tuple)):
        return [_content(part) for part in value]
    if is_dataclass(value):
        return [_content(getattr(value, field.name)) for field in fields(value)]
    return value
