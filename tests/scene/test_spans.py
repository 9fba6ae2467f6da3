import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.base.errors import UsageError
from splatreel.scene.spans import group_spans


def test_consecutive_groups_overlap():
    assert [(s.first, s.own, s.count) for s in group_spans(60, 30, 5)] == [(0, 30, 35), (30, 30, 30)]


def test_short_remainder_joins_the_previous_group():
    assert [(s.first, s.count) for s in group_spans(33, 30, 5)] == [(0, 33)]
    assert [(s.first, s.count) for s in group_spans(36, 30, 5)] == [(0, 35), (30, 6)]


def test_one_frame_is_one_group():
    assert [(s.first, s.own, s.count) for s in group_spans(1, 30, 5)] == [(0, 1, 1)]


def test_overlap_longer_than_a_group_is_refused():
    with pytest.raises(UsageError, match="overlap of 30"):
        group_spans(60, 30, 30)


@given(st.integers(1, 400), st.integers(2, 60), st.data())
def test_groups_cover_every_frame_once(frames, length, data):
    overlap = data.draw(st.integers(0, length - 1))
    cut = group_spans(frames, length, overlap)
    assert sum(s.own for s in cut) == frames
    assert cut[-1].first + cut[-1].count == frames
    for a, b in itertools.pairwise(cut):
        assert b.first == a.first + a.own
        assert a.count == min(a.own + overlap, frames - a.first)
