"""Codebook of the higher SH coefficients."""

import numpy as np

from splatreel.codec.paper import vector


def blobs(count=2000, centers=20, seed=0):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(centers, 45))
    return (middle[rng.integers(0, centers, count)] + 0.01 * rng.normal(size=(count, 45))).astype(np.float32), middle


def test_kmeans_finds_clusters():
    vectors, _ = blobs()
    codebook = vector.kmeans(vectors, 60)
    assert codebook.shape == (60, 45)
    _, distance = vector.assign(vectors, codebook)
    assert distance.mean() < 0.02  # against 45 when nothing fits, 0.0045 for the blobs' own centers


def test_assign_returns_the_nearest_entry():
    vectors, _ = blobs(300)
    codebook = vectors[:40] + 0.1
    nearest, distance = vector.assign(vectors, codebook)
    exact = ((vectors[:, None] - codebook) ** 2).sum(-1)
    np.testing.assert_allclose(exact[np.arange(300), nearest], exact.min(1), atol=1e-4)
    np.testing.assert_allclose(distance, exact.min(1), atol=1e-3)


def test_same_seed_same_codebook():
    vectors, _ = blobs()
    np.testing.assert_array_equal(vector.kmeans(vectors, 32, seed=3), vector.kmeans(vectors, 32, seed=3))


def test_few_vectors_are_kept_exactly():
    vectors = np.repeat(blobs(5)[0], 3, axis=0)
    codebook = vector.kmeans(vectors, 1024)
    assert codebook.shape == (5, 45)
    nearest, _ = vector.assign(vectors, codebook)
    np.testing.assert_array_equal(codebook[nearest], vectors)


def test_one_entry_is_the_mean():
    vectors = np.array([[0.0], [1.0], [5.0]], np.float32)
    np.testing.assert_allclose(vector.kmeans(vectors, 1), [[2.0]])


def test_kmeans_favors_larger_weights():
    """A cloud with a hundred times the weight of another gets most of the entries, and its error falls."""
    rng = np.random.default_rng(0)
    vectors = np.concatenate([rng.normal(0, 1, (500, 6)), rng.normal(20, 1, (500, 6))]).astype(np.float32)
    weights = np.repeat([100.0, 1.0], 500)
    errors = [vector.assign(vectors[:500], vector.kmeans(vectors, 40, weights=w))[1].mean() for w in (None, weights)]
    codebook = vector.kmeans(vectors, 40, weights=weights)
    assert (codebook.mean(1) < 10).sum() > 35
    assert errors[1] < 0.85 * errors[0]
    np.testing.assert_allclose(
        vector.kmeans(np.array([[0.0], [3.0]], np.float32), 1, weights=np.array([2, 1])), [[1.0]]
    )
