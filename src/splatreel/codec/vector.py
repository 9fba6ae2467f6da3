"""Vector quantisation of the higher SH coefficients (paper section 4.3): k-means with a small codebook."""

from __future__ import annotations

import numpy as np

_SAMPLE = 24_576
_ROUNDS = 8
_CHUNK = 2048


def kmeans(vectors: np.ndarray, entries: int, weights: np.ndarray | None = None, seed: int = 0) -> np.ndarray:
    """A codebook [K, D] float32 of vectors [N, D], K <= entries, by Lloyd's algorithm on a sample.

    weights: [N], how much a vector's error matters. The same input and seed give the same codebook. Where
    there are no more different vectors than entries, they are the codebook.
    """
    vectors = np.ascontiguousarray(vectors, np.float32)
    rng = np.random.default_rng(seed)
    weights = np.ones(len(vectors)) if weights is None else np.maximum(np.asarray(weights, np.float64), 1e-6)
    if len(vectors) > _SAMPLE:
        chosen = np.sort(rng.choice(len(vectors), _SAMPLE, replace=False))
        vectors, weights = vectors[chosen], weights[chosen]
    different, first = np.unique(vectors, axis=0, return_index=True)
    if len(different) <= entries:
        return different
    start = rng.choice(len(first), entries, replace=False, p=weights[first] / weights[first].sum())
    codebook = different[np.sort(start)]
    for _ in range(_ROUNDS):
        nearest, distance = assign(vectors, codebook)
        codebook = _centres(vectors, weights, nearest, distance, codebook)
    return codebook


def assign(vectors: np.ndarray, codebook: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest entry [N] int64 of each vector and its squared distance [N] float32. vectors: [N, D]."""
    vectors = np.ascontiguousarray(vectors, np.float32)
    norms = (codebook**2).sum(1)
    nearest = np.empty(len(vectors), np.int64)
    distance = np.empty(len(vectors), np.float32)
    for begin in range(0, len(vectors), _CHUNK):
        part = vectors[begin : begin + _CHUNK]
        score = norms - 2 * (part @ codebook.T)
        best = score.argmin(1)
        nearest[begin : begin + _CHUNK] = best
        distance[begin : begin + _CHUNK] = score[np.arange(len(part)), best] + (part**2).sum(1)
    return nearest, np.maximum(distance, 0)


def _centres(
    vectors: np.ndarray, weights: np.ndarray, nearest: np.ndarray, distance: np.ndarray, codebook: np.ndarray
) -> np.ndarray:
    """Weighted means of the clusters; an empty cluster moves to a vector that is served worst."""
    entries = len(codebook)
    mass = np.bincount(nearest, weights, entries)
    columns = [np.bincount(nearest, weights * column, entries) for column in vectors.T.astype(np.float64)]
    centres = np.stack(columns, 1) / np.maximum(mass, 1e-12)[:, None]
    empty = np.flatnonzero(mass == 0)
    centres[empty] = vectors[np.argsort(-weights * distance, kind="stable")[: len(empty)]]
    return centres.astype(np.float32)
