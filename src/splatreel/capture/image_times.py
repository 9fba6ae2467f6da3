"""Moments of images, from the numbers in their names: numbers of frames, or times."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from splatreel.base.errors import CaptureError

NUMBER = re.compile("([0-9]+)")
TICK = 10
"""Minimum usual step of numbers that may be times, which differ a little between the cameras at the same moment."""
TOGETHER, SPREAD = 0.25, 0.5
"""Maximum difference of consecutive times of one moment, and of all of its times, as shares of the usual step."""
DENSE = 0.5
"""Share of the numbers up to the highest above which digits behind a point are a number of their own, not decimals."""

Keys = dict[str, list[tuple[int, ...]]]
"""Keys of the images by camera. Images of the same moment have the same key, and keys are in order of time."""


def moments(path: str, names: Mapping[str, list[str]], notes: list[str]) -> Keys | None:
    """Return the moments of images by camera, or None if names have no numbers that can be compared.

    Args:
        path: Folder of the capture, for messages.
        names: Names of each camera's images, without extension.
        notes: Sentences about choices, which are added to.

    Raises:
        CaptureError: Times of different moments cannot be told apart.
    """
    numbers = {name: [NUMBER.findall(own) for own in found] for name, found in names.items()}
    places = _varying(numbers)
    if places is None:
        return None
    keys = {name: [tuple(int(row[at]) for at in places[name]) for row in rows] for name, rows in numbers.items()}
    times = _decimals(names, numbers, places) or _best_column(keys)
    return keys if times is None else _merged(path, times, notes)


def _varying(numbers: Mapping[str, list[list[str]]]) -> dict[str, list[int]] | None:
    """Return by camera the places of the numbers that differ between its images; None where names cannot be compared so.

    Args:
        numbers: By camera, the numbers in the name of each image.
    """
    if any(len({len(row) for row in rows}) > 1 for rows in numbers.values()):
        return None
    own = {
        name: [at for at, column in enumerate(zip(*rows, strict=True)) if len(set(map(int, column))) > 1]
        for name, rows in numbers.items()
    }
    if len({len(rows[0]) for rows in numbers.values()}) == 1:
        together = sorted({at for places in own.values() for at in places})
        own = dict.fromkeys(own, together)
    return own if len({len(places) for places in own.values()}) == 1 and all(own.values()) else None


def _decimals(
    names: Mapping[str, list[str]], numbers: Mapping[str, list[list[str]]], places: Mapping[str, list[int]]
) -> dict[str, list[int]] | None:
    """Return numbers with decimals as multiples of their last digit; None if no point is in the names, or is not a decimal point."""
    digits: list[str] = []
    wholes: dict[str, int] = {}
    for name, rows in numbers.items():
        last, gaps = places[name][-1], NUMBER.split(names[name][0])[2:-1:2]
        if last == 0 or gaps[last - 1] != "." or not set(places[name]) <= {last - 1, last}:
            return None
        wholes[name] = last - 1
        digits += [row[last] for row in rows]
    values = {int(text) for text in digits}
    lengths = {len(text) for text in digits}
    if len(lengths) > 1 and len(values) >= DENSE * (max(values) + 1):
        return None  # such as 1.9, 1.10
    most = max(lengths)
    times = {
        name: [int(row[wholes[name]] + row[wholes[name] + 1].ljust(most, "0")) for row in rows]
        for name, rows in numbers.items()
    }
    return times if all(len(set(found)) == len(found) for found in times.values()) else None


def _best_column(keys: Keys) -> dict[str, list[int]] | None:
    """Return the numbers that most cameras have in common, of those that give the same order as all numbers of the names."""
    best, most = None, -1
    for at in range(len(next(iter(keys.values()))[0])):
        column = {name: [row[at] for row in rows] for name, rows in keys.items()}
        ordered = ([row[at] for row in sorted(rows)] for rows in keys.values())
        if all(one < other for found in ordered for one, other in pairwise(found)):
            shared = _shared(column.values())
            if shared > most:
                best, most = column, shared
    return best if most >= _shared(keys.values()) else None


def _shared(found: Iterable[Sequence[object]]) -> int:
    """Return the number of values that more than half of the cameras have."""
    cameras = [set(values) for values in found]
    counts = Counter(value for values in cameras for value in values)
    return sum(2 * count > len(cameras) for count in counts.values())


def _merged(path: str, times: Mapping[str, list[int]], notes: list[str]) -> Keys:
    """Return one key for times of the same moment, which differ between cameras by less than a frame."""
    distinct = sorted({time for found in times.values() for time in found})
    steps = [float(np.median(np.diff(sorted(found)))) for found in times.values() if len(found) > 1]
    step = float(np.median(steps)) if steps else 0.0
    if step < TICK or all(set(found) == set(distinct) for found in times.values()):
        return {name: [(time,) for time in found] for name, found in times.items()}
    groups = np.split(np.array(distinct), np.flatnonzero(np.diff(distinct) > TOGETHER * step) + 1)
    first = {int(time): int(group[0]) for group in groups for time in group}
    spread = max(int(group[-1] - group[0]) for group in groups)
    merged = {name: [(first[time],) for time in found] for name, found in times.items()}
    if spread > SPREAD * step or any(len(set(found)) < len(found) for found in merged.values()):
        raise CaptureError(
            f"{path}: the numbers of images are {step:g} apart and differ by up to {spread} between cameras, so that it is not "
            f"clear which images belong together. Give images of the same moment the same number."
        )
    if spread:
        notes.append(
            f"numbers of images of the same moment differ by up to {spread} between cameras, where images are {step:g} apart"
        )
    return merged
