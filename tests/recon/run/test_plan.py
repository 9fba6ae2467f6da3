from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.config import Config, preset
from splatreel.config.settings import changed
from splatreel.recon.run.plan import Plan
from splatreel.scene.spans import GroupSpan


def spans(counts: list[int], first: int = 0) -> list[GroupSpan]:
    """Groups of so many frames, overlap included, one frame of which is shared."""
    return [GroupSpan(first + place, 0, count - 1, count) for place, count in enumerate(counts)]


@given(st.lists(st.integers(1, 400), min_size=1, max_size=8), st.sampled_from(["draft", "standard", "paper"]))
def test_stages_follow_each_other_and_fill_the_job(counts, quality):
    plan = Plan(spans(counts), preset(quality))
    order = [plan.points()]
    for group in range(len(counts)):
        order += [plan.keyframe(group), plan.layering(group), plan.tracking(group), plan.motion(group)]
    assert order[0][0] == 0
    assert order[-1][1] == pytest.approx(1)
    for before, after in pairwise(order):
        assert before[0] <= before[1] == pytest.approx(after[0])


def test_more_iterations_are_a_larger_share():
    def share(iterations):
        config = changed(Config(), {"group.iterations_per_frame": iterations})
        begin, end = Plan(spans([30]), config).motion(0)
        return end - begin

    assert share(100) < share(200) < share(400)


def test_a_group_that_is_not_there():
    with pytest.raises(KeyError):
        Plan(spans([30]), Config()).motion(1)
