"""Points with one attribute as decoded and all others as trained."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.codec.group_file import encode_group, encode_layer
from splatreel.config import EncodeConfig
from splatreel.recon.encode.attributes import SECTIONS, attribute_bytes, in_order, with_decoded, with_decoded_at
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.golden import random_gaussians, random_motion, random_shade

STATIC = ("position", "shape", "opacity", "color", "rest")


def group(seed: int) -> Group:
    rng = np.random.default_rng(seed)
    points = random_gaussians(rng, 40, 1, (0, 0, 0))
    return Group(0, 0, points, *random_motion(rng, points, 5), np.zeros(0, bool), random_shade(rng, 40, 5))


def differing(attribute: str, trained: Group, other: Group) -> Group:
    """Return `trained` with one attribute of another group."""
    points, theirs = trained.dynamic, other.dynamic
    if attribute == "motion":
        return replace(trained, dx=other.dx)
    if attribute == "turn":
        return replace(trained, dq=other.dq)
    if attribute == "shade":
        return replace(trained, shade=other.shade)
    sh = points.sh.copy()
    bands = {"color": slice(0, 1), "rest": slice(1, None)}.get(attribute, slice(0, 0))
    sh[:, bands] = theirs.sh[:, bands]
    changed = {"position": {"means": theirs.means}, "shape": {"scales": theirs.scales}}.get(attribute, {})
    if attribute == "opacity":
        changed = {"opacities": np.clip(theirs.opacities, 0.4, 0.6)}
    return replace(trained, dynamic=replace(points, sh=sh, **changed))


def assert_equal(one: Gaussians, other: Gaussians) -> None:
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-5)
    same = np.abs((one.quats * other.quats).sum(1))  # q and -q are the same rotation
    np.testing.assert_allclose(same, 1, atol=1e-5)


@pytest.mark.parametrize("attribute", SECTIONS)
def test_with_decoded_at_replaces_one_attribute(attribute: str) -> None:
    trained = group(0)
    assert trained.shade is not None
    trained = replace(trained, shade=None if attribute == "opacity" else 0.2 * trained.shade)
    decoded = differing(attribute, trained, group(1))
    assert_equal(with_decoded_at(attribute, trained, decoded, 2.0), decoded.at(2.0))
    for unlike in set(SECTIONS) - {attribute}:
        assert_equal(with_decoded_at(unlike, trained, decoded, 2.0), trained.at(2.0))


@pytest.mark.parametrize("attribute", STATIC)
def test_with_decoded_replaces_one_attribute(attribute: str) -> None:
    trained = group(0)
    decoded = differing(attribute, trained, group(1)).dynamic
    assert_equal(with_decoded(attribute, trained.dynamic, decoded), decoded)
    for unlike in set(STATIC) - {attribute}:
        assert_equal(with_decoded(unlike, trained.dynamic, decoded), trained.dynamic)


def test_decoded_shape_with_other_axes_keeps_rotation() -> None:
    """The codec may reorder axes. Rotation offsets refer to the axes of their own file."""
    trained, quarter = group(0), np.array([0.5**0.5, 0.5**0.5, 0, 0], np.float32)
    quats = rotations.multiply(trained.dynamic.quats, np.tile(quarter, (40, 1)))
    back = quarter * np.array([1, -1, -1, -1], np.float32)
    dq = rotations.multiply(
        rotations.multiply(np.broadcast_to(back, trained.dq.shape), trained.dq), quarter[None, None]
    )
    decoded = replace(trained, dynamic=replace(trained.dynamic, quats=quats), dq=dq.astype(np.float32))
    for attribute in ("shape", "turn"):
        seen = with_decoded_at(attribute, trained, decoded, 3.0)
        expected = decoded.at(3.0) if attribute == "shape" else trained.at(3.0)
        assert_equal(seen, expected)


def test_attribute_bytes_sum_sections() -> None:
    whole = group(0)
    file, order = encode_group(whole, EncodeConfig())
    assert set(attribute_bytes(file)) == set(SECTIONS)
    assert 0.5 * len(file) < sum(attribute_bytes(file).values()) < len(file)
    assert set(attribute_bytes(encode_layer(0, 0, whole.dynamic, EncodeConfig())[0])) == set(STATIC)
    np.testing.assert_array_equal(in_order(whole, order).at(1.0).means, whole.at(1.0).means[order])
