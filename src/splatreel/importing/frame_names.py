"""Order and time of the frames of a sequence, from the numbers in their names."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from splatreel.base.errors import GaussiansError

Gaps = Literal["refuse", "hold"]
"""Treatment of missing frame numbers: refuse the sequence, or hold the previous frame."""
MOST_FRAMES = 1_000_000
"""Maximum number of frames, including held ones."""
MOST_DIGITS = 18
"""Maximum digits of a number that counts frames, which fits into 64 bits."""
SECONDS = 0.1, 1000.0
"""Frame rates at which numbers with a decimal point are seconds."""
COMMON_RATES = (15, 24000 / 1001, 24, 25, 30000 / 1001, 30, 48, 50, 60000 / 1001, 60, 90, 100, 120, 240)
TICK = 10
"""Numbers at least this far apart may be times in some unit, whose steps differ by rounding."""
ROUNDING = 0.2
"""Maximum deviation of such a step from a multiple of the usual step, as a share of it."""


@dataclass(frozen=True)
class Order:
    """Frames in order.

    Attributes:
        names: Names by frame; a held frame repeats the name before it.
        fps: Frames per second, if the names hold seconds.
        step: Difference of the numbers of consecutive frames.
    """

    names: list[str]
    fps: float | None = None
    step: float = 1.0


def order_frames(names: Sequence[str], place: str, gaps: Gaps) -> Order:
    """Sort names by the number that differs between them, which may stand anywhere and may be a time in seconds.

    Args:
        names: Names without suffixes, one per frame.
        place: Folder or archive, for messages.
        gaps: Treatment of missing numbers.

    Raises:
        GaussiansError: The order is unclear, or frames are missing and `gaps` is "refuse".
    """
    if len(names) == 1:
        return Order(list(names))
    fields = {name: re.findall(r"[0-9]+", name) for name in names}
    _check_alike(fields, place)
    columns = list(zip(*fields.values(), strict=True))
    varying = [i for i, column in enumerate(columns) if len({number.lstrip("0") for number in column}) > 1]
    times = _seconds(fields, varying)
    if times is not None:
        return _by_time(times, place, gaps)
    if not varying:
        raise GaussiansError(f"{place}: holds frame {columns[-1][0].lstrip('0') or '0':.40} twice. Remove one of them.")
    _check_lengths(columns, varying, place)
    chosen = _choose_field(columns, varying, place, next(iter(names)))
    numbers = {name: int(numbers[chosen]) for name, numbers in fields.items()}
    return _without_gaps(numbers, place, gaps)


def _check_alike(fields: dict[str, list[str]], place: str) -> None:
    """Raise `GaussiansError` for a name without a number, or for names that differ in more than numbers."""
    bare = next((name for name, numbers in fields.items() if not numbers), None)
    if bare is not None:
        raise GaussiansError(
            f"{place}: the name {bare} has no number that says which frame it is. Remove the file, or number it."
        )
    shapes = Counter(re.sub(r"[0-9]+", "N", name) for name in fields)
    if len(shapes) > 1:
        (usual, _), *_, (odd, _) = shapes.most_common()
        raise GaussiansError(
            f"{place}: holds files called {usual} and files called {odd}. Put each sequence into its own folder."
        )


def _check_lengths(columns: list[tuple[str, ...]], varying: list[int], place: str) -> None:
    """Raise `GaussiansError` for a number that is too long to count frames."""
    long = next((word for i in varying for word in columns[i] if len(word.lstrip("0")) > MOST_DIGITS), None)
    if long is not None:
        raise GaussiansError(
            f"{place}: the number {long:.40} in a name has more than {MOST_DIGITS} digits, expected one that counts frames. Rename "
            "the files."
        )


def _choose_field(columns: list[tuple[str, ...]], varying: list[int], place: str, example: str) -> int:
    """Return the field that numbers the frames. Several fields may vary if they give the same order."""
    values = [np.array([int(number) for number in columns[i]], np.int64) for i in varying]
    orders = {tuple(np.argsort(value, kind="stable").tolist()) for value in values}
    unique = [i for i, value in zip(varying, values, strict=True) if len(np.unique(value)) == len(value)]
    if len(varying) > 1 and (len(orders) > 1 or not unique):
        raise GaussiansError(
            f"{place}: names such as {example} hold {len(varying)} numbers that differ between files, so the order is unclear. Keep "
            "one number that counts frames, and put each sequence into its own folder."
        )
    if not unique:
        counts = Counter(map(int, columns[varying[0]]))
        raise GaussiansError(f"{place}: holds frame {counts.most_common(1)[0][0]} twice. Remove one of them.")
    return min(unique, key=lambda i: np.ptp([int(number) for number in columns[i]]))


def _seconds(fields: dict[str, list[str]], varying: list[int]) -> dict[str, float] | None:
    """Return times by name if the varying numbers are seconds with a decimal point, otherwise None."""
    example = next(iter(fields))
    separators = re.split(r"[0-9]+", example)[1:-1]
    decimals = [i for i, separator in enumerate(separators) if separator == "." and {i, i + 1} & set(varying)]
    if len(decimals) != 1 or not set(varying) <= {decimals[0], decimals[0] + 1}:
        return None
    whole = decimals[0]
    if max(len(numbers[whole]) for numbers in fields.values()) > MOST_DIGITS:
        return None
    if whole not in varying and int(fields[example][whole]) != 0:
        return None
    times = {name: float(f"{numbers[whole]}.{numbers[whole + 1]}") for name, numbers in fields.items()}
    steps = np.diff(np.sort(list(times.values())))
    if steps.min() <= 0 or not SECONDS[0] <= 1 / _usual_step(steps) <= SECONDS[1]:
        return None
    return times


def _usual_step(steps: np.ndarray) -> float:
    """Return the step between consecutive frames: the mean of the shortest ones, which rounding makes differ a little."""
    return float(np.mean(steps[steps <= (1 + 2 * ROUNDING) * steps.min()]))


def _by_time(times: dict[str, float], place: str, gaps: Gaps) -> Order:
    """Order names by time, and derive the frame rate."""
    ordered = sorted(times, key=lambda name: times[name])
    values = np.array([times[name] for name in ordered])
    step = _usual_step(np.diff(values))
    counts = np.maximum(np.rint(np.diff(values) / step), 1)
    odd = np.abs(np.diff(values) / step - counts) > ROUNDING * counts
    if odd.any():
        first = int(odd.argmax())
        raise GaussiansError(
            f"{place}: the times in the names are not evenly spaced: {ordered[first]} and {ordered[first + 1]} are "
            f"{values[first + 1] - values[first]:.3g} s apart, others {step:.3g} s. Export frames at a constant rate."
        )
    rate = float(counts.sum() / (values[-1] - values[0]))
    near = min(COMMON_RATES, key=lambda common: abs(common - rate))
    rate = near if abs(near - rate) < 0.005 * rate else round(rate, 3)
    numbers = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    order = _without_gaps(dict(zip(ordered, numbers.tolist(), strict=True)), place, gaps)
    return Order(order.names, rate)


def _without_gaps(numbers: dict[str, int], place: str, gaps: Gaps) -> Order:
    """Order names by number, with the previous name repeated for each missing number. A constant step is not a gap."""
    names = sorted(numbers, key=lambda name: numbers[name])
    steps = [numbers[after] - numbers[before] for before, after in pairwise(names)]
    if len(set(steps)) <= 1:
        return Order(names, step=steps[0])
    step = float(math.gcd(*steps))
    usual = _usual_step(np.array(steps))
    multiples = np.array(steps) / usual
    if usual >= TICK and np.abs(multiples - np.maximum(np.rint(multiples), 1)).max() <= ROUNDING:
        step = usual
    lengths = [round(length / step) for length in steps]
    missing = sum(lengths) - len(lengths)
    if not missing:
        return Order(names, step=step)
    first = next(i for i, length in enumerate(lengths) if length > 1)
    count = f"{missing:,} frames are" if missing > 1 else "1 frame is"
    if gaps != "hold":
        raise GaussiansError(
            f"{place}: {count} missing, the first after {names[first]}: the next one is "
            f"{names[first + 1]}. Add them, or import with --gaps hold, which repeats the previous frame."
        )
    if len(names) + missing > MOST_FRAMES:
        raise GaussiansError(
            f"{place}: with {missing:,} frames held it would have more than {MOST_FRAMES:,}. Renumber its files."
        )
    return Order([name for name, length in zip(names, [*lengths, 1], strict=True) for _ in range(length)], step=step)
