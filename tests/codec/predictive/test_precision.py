"""Classes of importance, and their savings."""

import dataclasses

import numpy as np

from splatreel.codec.group_file import decode_layer, encode_group, encode_layer
from splatreel.codec.predictive.precision import STEPS, classes_of
from tests.codec.predictive.groups import CONFIG, group, points


def test_coarser_steps_and_importance_reduce_bytes():
    whole = len(encode_group(group(), CONFIG)[0])
    coarse = len(encode_group(group(), dataclasses.replace(CONFIG, coarseness=4.0))[0])
    importance = np.full((300, 3), 1e-3)
    importance[:60] = 1.0
    unequal = len(encode_group(group(), CONFIG, importance=importance)[0])
    assert coarse < 0.8 * whole
    assert unequal < 0.85 * whole


def test_coarse_steps_limit_the_largest_class():
    importance = np.geomspace(1, 1e-5, 60)[:, None].repeat(3, 1)
    fine, coarse = (classes_of(importance, 60, coarseness) for coarseness in (0.6, 2.5))
    assert (fine.max(), coarse.max()) == (3, 2)
    assert (coarse == np.minimum(fine, 2)).all()


def test_important_points_keep_their_precision():
    importance = np.full((300, 3), 1e-3)
    importance[:60] = 1.0
    data, order = encode_layer(0, 0, points(), CONFIG, importance=importance)
    error = np.abs(decode_layer(data, "a layer")[1].sh[:, 0] - points().sh[order, 0]).max(1)
    assert error[order < 60].max() <= 1.1 * STEPS.color < error.max()
