"""Vector quantization of higher SH coefficients: k-means with a small codebook.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import numpy as np

_SAMPLE = 24_576
_ROUNDS = 8
_CHUNK = 2048


def kmeans(vectors: np.ndarray, entries: int, seed: int = 0, weights: np.ndarray | None = None) -> np.ndarray:
    """Return a codebook [K, D] float32 of vectors [N, D], K <= entries, by Lloyd's algorithm on a sample.

    The same input and seed give the same codebook. If there are at most `entries` distinct vectors, they are the
    codebook.

    Args:
        vectors: Vectors to quantize.
        entries: Maximum size of the codebook.
        seed: Seed of the sample and of the initial entries.
        weights: Weight of each vector, [N] > 0; None weighs all equally. The effect of a point's color on the images is
            a good weight; opacity is not (docs/experiments/README.md).
    """
    vectors = np.ascontiguousarray(vectors, np.float32)
    rng = np.random.default_rng(seed)
    masses = np.ones(len(vectors)) if weights is None else np.asarray(weights, np.float64)
    if len(vectors) > _SAMPLE:
        sample = np.sort(rng.choice(len(vectors), _SAMPLE, replace=False))
        vectors, masses = vectors[sample], masses[sample]
    different, which = np.unique(vectors, axis=0, return_inverse=True)
    if len(different) <= entries:
        return different
    share = None if weights is None else np.bincount(which.ravel(), masses) / masses.sum()
    codebook = different[np.sort(rng.choice(len(different), entries, replace=False, p=share))]
    for _ in range(_ROUNDS):
        nearest, distance = assign(vectors, codebook)
        codebook = _centers(vectors, masses, nearest, distance, entries)
    return codebook


def assign(vectors: np.ndarray, codebook: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest entry [N] int64 of each vector [N, D] and its squared distance [N] float32."""
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


def _centers(
    vectors: np.ndarray, masses: np.ndarray, nearest: np.ndarray, distance: np.ndarray, entries: int
) -> np.ndarray:
    """Return the weighted means of the clusters. An empty cluster moves to a vector with a large error."""
    mass = np.bincount(nearest, masses, entries)
    columns = [np.bincount(nearest, masses * column, entries) for column in vectors.T.astype(np.float64)]
    empty = np.flatnonzero(mass == 0)
    mass[empty] = 1
    centers = np.stack(columns, 1) / mass[:, None]
    centers[empty] = vectors[np.argsort(-distance * masses, kind="stable")[: len(empty)]]
    return centers.astype(np.float32)
