"""Entropy coding of whole numbers: rANS in many lanes, so that numpy and a browser both decode it fast (docs/format.md).

Numbers come in batches, each number with a context that both sides know before the batch. A context has its own frequencies, sent
in front. After Duda, "Asymmetric numeral systems", 2013; interleaved lanes after Giesen, "Interleaved entropy coders", 2014.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from splatreel.errors import ReelError

MAX_VALUE = (1 << 52) - 1
TOKENS = 128
_SCALE_BITS = 12
_SCALE = 1 << _SCALE_BITS
_LOW = 1 << 16
"""States stay in 2^16 .. 2^32 - 1 and are refilled by 16 bits."""
_DIRECT = 32
"""Numbers below it are their own token; larger ones are a token of their length and next bit, and plain bits."""
_HEADER = struct.Struct("<BBHII")
_MAX_LANES = 10
_SYMBOLS_PER_LANE = 1024


class Encoder:
    """Collects batches, then makes bytes of them. contexts: how many there are, at most 255."""

    def __init__(self, contexts: int) -> None:
        self._contexts = contexts
        self._batches: list[tuple[np.ndarray, np.ndarray]] = []

    def write(self, values: np.ndarray, contexts: np.ndarray | int) -> None:
        """A batch: values [n], 0 to 2^52 - 1, and their contexts [n], or one for all."""
        values = np.asarray(values, np.int64)
        self._batches.append((values, np.broadcast_to(np.asarray(contexts, np.int64), values.shape)))

    def finish(self) -> bytes:
        batches = [batch for batch in self._batches if len(batch[0])] or [(np.zeros(0, np.int64),) * 2]
        values, contexts = (np.concatenate([batch[i] for batch in batches]) for i in range(2))
        tokens, lengths = _tokens(values)
        counts = np.bincount(contexts * TOKENS + tokens, minlength=self._contexts * TOKENS)
        frequencies = np.stack([_normalised(row) for row in counts.reshape(self._contexts, TOKENS)])
        starts = np.cumsum(frequencies, 1) - frequencies
        shift = min(max(round(np.log2(max(len(values), 1) / _SYMBOLS_PER_LANE)), 0), _MAX_LANES)
        sizes = [len(batch[0]) for batch in batches]
        states, words = _rans(frequencies[contexts, tokens], starts[contexts, tokens], sizes, 1 << shift)
        tables, raw = zlib.compress(_table_bytes(frequencies), 9), _pack_bits(values, lengths)
        head = _HEADER.pack(shift, self._contexts, len(tables), len(words), len(raw))
        return b"".join([head, tables, states.astype("<u4").tobytes(), words.astype("<u2").tobytes(), raw])


class Decoder:
    """Reads the batches of `Encoder` in their order. Raises `ReelError` for damaged data; memory is bounded by its length."""

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
        self._lookup = _lookup(data[ends[0] : ends[1]], contexts)
        self._states = np.frombuffer(data, "<u4", lanes, ends[1]).astype(np.int64)
        # Past the end there are zeros: a lying stream is found out at the end, not by running over.
        self._words = np.concatenate([np.frombuffer(data, "<u2", words, ends[2]), np.zeros(lanes, np.uint16)])
        self._word, self._word_count = 0, words
        self._raw = np.frombuffer(data[ends[3] :] + bytes(8), np.uint8)
        self._bit = 0

    def read(self, contexts: np.ndarray) -> np.ndarray:
        """The values [n] int64 of the next batch, whose contexts [n] are given."""
        base = np.asarray(contexts, np.int64) << _SCALE_BITS
        entries = np.empty(len(base), np.int64)
        lanes = len(self._states)
        for begin in range(0, len(base), lanes):
            part = base[begin : begin + lanes]
            state = self._states[: len(part)]
            entry = self._lookup[part | (state & (_SCALE - 1))]
            entries[begin : begin + lanes] = entry
            state = (entry >> 12 & 0x1FFF) * (state >> _SCALE_BITS) + (entry & 0xFFF)
            low = (state < _LOW).nonzero()[0]
            if len(low):
                if self._word + len(low) > self._word_count:
                    raise ReelError("ends before all of its numbers are read.")
                state[low] = (state[low] << 16) | self._words[self._word : self._word + len(low)]
                self._word += len(low)
            self._states[: len(part)] = state
        return self._values(entries >> 25)

    def finish(self) -> None:
        """Raise `ReelError` unless everything was read and came out as it went in."""
        left = self._word != self._word_count or (self._bit + 7) // 8 != len(self._raw) - 8
        if left or (self._states != _LOW).any():
            raise ReelError("is damaged: its entropy coder does not end as it began.")

    def _values(self, tokens: np.ndarray) -> np.ndarray:
        long = np.flatnonzero(tokens >= _DIRECT)
        if not len(long):
            return tokens
        bits = (tokens[long] - _DIRECT >> 1) + 4
        starts = self._bit + np.cumsum(bits) - bits
        self._bit = int(starts[-1] + bits[-1])
        if self._bit > 8 * (len(self._raw) - 8):
            raise ReelError("ends before all of its bits are read.")
        window = np.zeros(len(long), np.uint64)
        for byte in range(8):
            window |= self._raw[(starts >> 3) + byte].astype(np.uint64) << np.uint64(8 * byte)
        rest = (window >> (starts & 7).astype(np.uint64)).astype(np.int64) & ((1 << bits) - 1)
        tokens[long] = ((2 | (tokens[long] & 1)) << bits) | rest
        return tokens


def zigzag(values: np.ndarray) -> np.ndarray:
    """Signed to unsigned: 0, -1, 1, -2 become 0, 1, 2, 3."""
    return (values << 1) ^ (values >> 63)


def unzigzag(values: np.ndarray) -> np.ndarray:
    return (values >> 1) ^ -(values & 1)


def _tokens(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(tokens [n], how many plain bits follow each [n]); a number of b + 2 bits whose top bit is 1 keeps its low b bits plain."""
    if len(values) and not 0 <= values.min() <= values.max() <= MAX_VALUE:
        raise ReelError("Numbers are too large for the entropy coder. Use a coarser step.")
    lengths = np.frexp(values.astype(np.float64))[1].astype(np.int64) - 2
    direct = values < _DIRECT
    lengths[direct] = 0
    return np.where(direct, values, _DIRECT + 2 * (lengths - 4) + (values >> lengths & 1)), lengths


def _normalised(counts: np.ndarray) -> np.ndarray:
    """Frequencies [TOKENS] that sum to 4096 (or are all 0), none that occurs below 1."""
    total = int(counts.sum())
    if not total:
        return counts
    result = np.where(counts > 0, np.maximum(counts * _SCALE // total, 1), 0)
    while (excess := int(result.sum()) - _SCALE) != 0:
        top = int(result.argmax())
        result[top] -= excess if excess < result[top] // 2 else result[top] // 2
    return result


def _table_bytes(frequencies: np.ndarray) -> bytes:
    """For each context how many tokens have a frequency, and these as 16 bits."""
    parts = []
    for row in frequencies:
        used = int(np.flatnonzero(row)[-1]) + 1 if row.any() else 0
        parts.append(struct.pack("<B", used) + row[:used].astype("<u2").tobytes())
    return b"".join(parts)


def _lookup(tables: bytes, contexts: int) -> np.ndarray:
    """[contexts * 4096]: for each place in the scale the token << 25 | frequency << 12 | place in the token's own interval."""
    limit = contexts * (1 + 2 * TOKENS)
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(tables, limit)
    except zlib.error as error:
        raise ReelError(f"has frequencies that are no zlib stream ({error}).") from error
    result = np.zeros((contexts, _SCALE), np.int64)
    at = 0
    for context in range(contexts):
        used = plain[at] if at < len(plain) else TOKENS + 1
        if used > TOKENS or at + 1 + 2 * used > len(plain):
            raise ReelError("has frequencies that are cut off.")
        frequencies = np.frombuffer(plain, "<u2", used, at + 1).astype(np.int64)
        at += 1 + 2 * used
        if frequencies.sum() not in (0, _SCALE):
            raise ReelError(f"has frequencies that sum to {frequencies.sum()}, not {_SCALE}.")
        token = np.repeat(np.arange(used), frequencies)
        inside = np.arange(len(token)) - (np.cumsum(frequencies) - frequencies)[token]
        result[context, : len(token)] = token << 25 | frequencies[token] << 12 | inside
    if at != len(plain):
        raise ReelError("has more frequencies than contexts.")
    return result.ravel()


def _rans(frequencies: np.ndarray, starts: np.ndarray, sizes: list[int], lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """(states [lanes], words) after encoding from the last number to the first; a batch begins at lane 0."""
    states = np.full(lanes, _LOW, np.int64)
    words: list[np.ndarray] = []
    end = sum(sizes)
    for size in reversed(sizes):
        first = end - size
        for begin in range(first + (max(size - 1, 0) // lanes) * lanes, first - 1, -lanes):
            part = slice(begin, min(begin + lanes, end))
            frequency, state = frequencies[part], states[: part.stop - begin]
            full = state >= frequency << 20
            if full.any():
                words.append(state[full] & 0xFFFF)
                state = np.where(full, state >> 16, state)
            whole, rest = np.divmod(state, np.maximum(frequency, 1))
            states[: part.stop - begin] = (whole << _SCALE_BITS) + rest + starts[part]
        end = first
    return states, np.concatenate(words[::-1]) if words else np.zeros(0, np.int64)


def _pack_bits(values: np.ndarray, lengths: np.ndarray) -> bytes:
    """The low `lengths` bits of the values, lowest first, without gaps."""
    long = np.flatnonzero(lengths)
    values, lengths = values[long], lengths[long]
    planes = []
    for begin in range(0, len(values), 1 << 16):
        repeats = lengths[begin : begin + (1 << 16)]
        place = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        planes.append((np.repeat(values[begin : begin + (1 << 16)], repeats) >> place & 1).astype(np.uint8))
    return np.packbits(np.concatenate(planes), bitorder="little").tobytes() if planes else b""
