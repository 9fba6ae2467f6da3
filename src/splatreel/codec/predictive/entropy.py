"""Entropy coding of integers by rANS in interleaved lanes, which a processor decodes in parallel (docs/format.md).

Encoder and decoder know the context of each integer beforehand. The stream starts with the frequencies of every
context.

Source:
    Duda, "Asymmetric numeral systems", 2013; Giesen, "Interleaved entropy coders", 2014.
"""

from __future__ import annotations

import struct

import numpy as np
from numba import njit

from splatreel.base.errors import ReelError
from splatreel.base.jit import EXACT

MAX_VALUE = (1 << 52) - 1
_TOKENS = 128
_SCALE_BITS = 12
_SCALE = 1 << _SCALE_BITS
_LOW = 1 << 16
"""States stay in 2^16 .. 2^32 - 1 and are refilled by 16 bits."""
_DIRECT = 32
"""Smaller integers are their own token. Larger ones have a token of their length and next bit, followed by plain bits."""
_HEADER = struct.Struct("<BBHII")
_MAX_LANES = 10
_LANES = 2
"""Logarithm of the number of lanes. More lanes do not decode faster and cost four bytes each."""
_SPARE = 8
"""Zeros appended to words and bits, so that reading past the end of a damaged stream stays in bounds until `finish` detects it."""


def entropy_encode(values: np.ndarray, contexts: np.ndarray, count: int) -> bytes:
    """Encode values [n], 0 to 2^52 - 1, with contexts [n], 0 to count - 1 (at most 255)."""
    values, contexts = np.asarray(values, np.int64), np.asarray(contexts, np.int64)
    tokens, lengths = _tokens(values)
    counts = np.bincount(contexts * _TOKENS + tokens, minlength=count * _TOKENS)
    frequencies = np.stack([_normalized(row) for row in counts.reshape(count, _TOKENS)])
    starts = np.cumsum(frequencies, 1) - frequencies
    shift = _LANES if len(values) >= 1000 else 0
    states = np.full(1 << shift, _LOW, np.int64)
    words = np.empty(len(values), np.uint16)
    used = _rans(frequencies[contexts, tokens], starts[contexts, tokens], states, words)
    tables, raw = _packed_tables(frequencies), _pack_bits(values, lengths)
    head = _HEADER.pack(shift, count, len(tables), used, len(raw))
    return b"".join([head, tables, states.astype("<u4").tobytes(), words[:used][::-1].astype("<u2").tobytes(), raw])


class Stream:
    """Decoder of the bytes of `entropy_encode`. Raises `ReelError` for damaged data; the memory is bounded by its length.

    Compiled loops read it with `take(context, *parts)`.
    """

    def __init__(self, data: bytes, contexts: int) -> None:
        if len(data) < _HEADER.size:
            raise ReelError("is too short for an entropy coded stream.")
        shift, found, table_size, words, raw = _HEADER.unpack_from(data)
        lanes = 1 << shift
        if shift > _MAX_LANES or found != contexts:
            raise ReelError(f"has an entropy coder of 2^{shift} lanes and {found} contexts, expected {contexts}.")
        ends = np.cumsum([_HEADER.size, table_size, 4 * lanes, 2 * words, raw]).tolist()
        if ends[-1] != len(data):
            raise ReelError(f"holds {len(data)} bytes where its stream needs {ends[-1]}.")
        lookup = _lookup(data[ends[0] : ends[1]], contexts)
        states = np.frombuffer(data, "<u4", lanes, ends[1]).astype(np.int64)
        plain = np.frombuffer(data[ends[2] : ends[3]] + bytes(2 * _SPARE), "<u2")
        self._cursor = np.zeros(3, np.int64)
        self._ends = words, raw
        self.parts = lookup, states, plain, np.frombuffer(data[ends[3] :] + bytes(_SPARE), np.uint8), self._cursor

    def read(self, count: int) -> np.ndarray:
        """Return the next values [count] int64, all of context 0."""
        return _take_many(count, *self.parts)

    def finish(self) -> None:
        """Raise `ReelError` unless everything was read and the states ended as they began."""
        _, word, bit = self._cursor.tolist()
        if (word, (bit + 7) // 8) != self._ends or (self.parts[1] != _LOW).any():
            raise ReelError("is damaged: its entropy coder does not end as it began.")


@njit(**EXACT)
def take(context, lookup, states, words, raw, cursor):
    """Return the next integer. cursor [3] holds lane, word and bit. Past the ends, zeros are read."""
    lane = cursor[0]
    state = states[lane]
    entry = np.int64(lookup[(context << _SCALE_BITS) | (state & (_SCALE - 1))])
    state = (entry >> 12 & 0x1FFF) * (state >> _SCALE_BITS) + (entry & 0xFFF)
    if state < _LOW:
        state = (state << 16) | np.int64(words[min(cursor[1], len(words) - 1)])
        cursor[1] += 1
    states[lane] = state
    cursor[0] = (lane + 1) & (len(states) - 1)
    token = entry >> 25
    if token < _DIRECT:
        return token
    bits = (token - _DIRECT >> 1) + 4
    at, window = min(cursor[2] >> 3, len(raw) - _SPARE), np.uint64(0)
    for byte in range(_SPARE):
        window |= np.uint64(raw[at + byte]) << np.uint64(8 * byte)
    rest = np.int64(window >> np.uint64(cursor[2] & 7)) & ((1 << bits) - 1)
    cursor[2] += bits
    return ((2 | (token & 1)) << bits) | rest


@njit(**EXACT)
def _take_many(count, lookup, states, words, raw, cursor):
    values = np.empty(count, np.int64)
    for i in range(count):
        values[i] = take(0, lookup, states, words, raw, cursor)
    return values


@njit(**EXACT)
def _rans(frequencies, starts, states, words):
    """Encode from the last integer to the first into `states` and `words`. Return the number of words."""
    used, lanes = 0, len(states)
    for i in range(len(frequencies) - 1, -1, -1):
        frequency, state = frequencies[i], states[i % lanes]
        if state >= frequency << 20:
            words[used] = state & 0xFFFF
            used += 1
            state >>= 16
        states[i % lanes] = (state // frequency << _SCALE_BITS) + state % frequency + starts[i]
    return used


def zigzag(values: np.ndarray) -> np.ndarray:
    """Map signed to unsigned integers: 0, -1, 1, -2 become 0, 1, 2, 3."""
    return (values << 1) ^ (values >> 63)


def unzigzag(values: np.ndarray) -> np.ndarray:
    """Invert `zigzag`."""
    return (values >> 1) ^ -(values & 1)


def _tokens(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tokens [n] and the number of plain bits after each [n]. An integer of b + 2 bits keeps its low b bits plain."""
    if len(values) and not 0 <= values.min() <= values.max() <= MAX_VALUE:
        raise ReelError("Numbers are too large for the entropy coder. Use a coarser step.")
    lengths = np.frexp(values.astype(np.float64))[1].astype(np.int64) - 2
    direct = values < _DIRECT
    lengths[direct] = 0
    return np.where(direct, values, _DIRECT + 2 * (lengths - 4) + (values >> lengths & 1)), lengths


def _normalized(counts: np.ndarray) -> np.ndarray:
    """Scale counts to frequencies [TOKENS] with sum 4096 (or all 0). A token that occurs has at least 1."""
    total = int(counts.sum())
    if not total:
        return counts
    result = np.where(counts > 0, np.maximum(counts * _SCALE // total, 1), 0)
    while (excess := int(result.sum()) - _SCALE) != 0:
        top = int(result.argmax())
        result[top] -= excess if excess < result[top] // 2 else result[top] // 2
    return result


def _packed_tables(frequencies: np.ndarray) -> bytes:
    """Pack frequencies [contexts, TOKENS] as bits.

    Each context stores the number of tokens, then bit length and value of each frequency.
    """
    bits = np.zeros(frequencies.size * 32, np.uint8)
    used = _write_tables(frequencies, bits)
    return np.packbits(bits[:used], bitorder="little").tobytes()


@njit(**EXACT)
def _write_tables(frequencies, bits):
    at = 0
    for row in frequencies:
        used = _TOKENS
        while used > 0 and row[used - 1] == 0:
            used -= 1
        at, before = _write_gamma(used + 1, bits, at), 0
        for token in range(used):
            length = _bit_length(row[token])
            change = length - before
            at = _write_gamma((change << 1 ^ change >> 63) + 1, bits, at)
            for bit in range(length - 1):
                bits[at] = row[token] >> bit & 1
                at += 1
            before = length
    return at


@njit(**EXACT)
def _bit_length(number):
    length = 0
    while number >> length:
        length += 1
    return length


@njit(**EXACT)
def _write_gamma(number, bits, at):
    """Write an integer of b + 1 bits, at least 1, as b zeros, a one, and its low b bits. Return the position after it."""
    low = _bit_length(number) - 1
    bits[at + low] = 1
    for bit in range(low):
        bits[at + low + 1 + bit] = number >> bit & 1
    return at + 2 * low + 1


def _lookup(tables: bytes, contexts: int) -> np.ndarray:
    """Return [contexts * 4096]: token << 25 | frequency << 12 | position in the token's interval, for each position in the scale."""
    bits = np.unpackbits(np.frombuffer(tables, np.uint8), bitorder="little")
    result = np.zeros((contexts, _SCALE), np.uint32)
    read = _read_tables(bits, result)
    if read < 0 or (read + 7) // 8 != len(tables):
        raise ReelError("has frequencies that are truncated or do not sum to 4096.")
    return result.ravel()


@njit(**EXACT)
def _read_tables(bits, result):
    """Fill the table of `_lookup`. Return the number of bits read, or -1 for damaged data."""
    at = 0
    for context in range(len(result)):
        used, at = _read_gamma(bits, at)
        place, before = 0, 0
        for token in range(used - 1):
            change, at = _read_gamma(bits, at)
            length = before + (change - 1 >> 1 ^ -(change - 1 & 1))
            if at < 0 or token >= _TOKENS or not 0 <= length <= _SCALE_BITS + 1 or at + length > len(bits) + 1:
                return -1
            before, frequency = length, 1 << length >> 1
            for bit in range(length - 1):
                frequency |= np.int64(bits[at]) << bit
                at += 1
            if place + frequency > _SCALE:
                return -1
            for inside in range(frequency):
                result[context, place + inside] = token << 25 | frequency << 12 | inside
            place += frequency
        if at < 0 or (place != 0 and place != _SCALE):
            return -1
    return at


@njit(**EXACT)
def _read_gamma(bits, at):
    """Return an integer and the position after it. The position is -1 if the bits end or the integer is too long."""
    low = 0
    while 0 <= at + low < len(bits) and bits[at + low] == 0:
        low += 1
    if at < 0 or low > 8 or at + 2 * low + 1 > len(bits):
        return 1, -1
    number = 1 << low
    for bit in range(low):
        number |= np.int64(bits[at + low + 1 + bit]) << bit
    return number, at + 2 * low + 1


def _pack_bits(values: np.ndarray, lengths: np.ndarray) -> bytes:
    """Pack the low `lengths` bits of the values, lowest first, without gaps."""
    long = np.flatnonzero(lengths)
    values, lengths = values[long], lengths[long]
    planes = []
    for begin in range(0, len(values), 1 << 16):
        repeats = lengths[begin : begin + (1 << 16)]
        place = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        planes.append((np.repeat(values[begin : begin + (1 << 16)], repeats) >> place & 1).astype(np.uint8))
    return np.packbits(np.concatenate(planes), bitorder="little").tobytes() if planes else b""
