import pytest
from baselines.budget import Budget, Spent


def spend_all(budget: Budget, pace: list[float]) -> list[int]:
    """Spend a budget on machines of changing speed, in seconds per iteration."""
    iterations = []
    for seconds in pace:
        iterations.append(budget.iterations())
        budget.spend(seconds * iterations[-1], iterations[-1])
    return iterations


def test_frames_share_the_time_evenly() -> None:
    budget = Budget(100, 4, 0.5, [])
    assert spend_all(budget, [0.5] * 4) == [50] * 4
    assert budget.left == 0


def test_iterations_follow_the_measured_speed() -> None:
    budget = Budget(100, 4, 0.5, [])
    assert spend_all(budget, [0.25] * 4) == [50, 116, 117, 117]  # 12.5 s of the first share were left for the others
    assert budget.left == pytest.approx(0, abs=0.25)


def test_a_slow_machine_exceeds_the_time_by_a_frame_at_most() -> None:
    budget = Budget(100, 4, 0.1, [])
    assert spend_all(budget, [0.3] * 4)[:2] == [250, 27]
    assert sum(frame.seconds for frame in budget.spent) == pytest.approx(100, abs=1)


def test_a_spent_budget_allows_one_iteration() -> None:
    assert Budget(10, 3, 0.1, [Spent(11.0, 100)]).iterations() == 1


def test_a_continued_budget_goes_on_as_before() -> None:
    budget = Budget(100, 4, 0.5, [])
    spend_all(budget, [0.3, 0.4])
    assert Budget(100, 4, 0.5, budget.spent).iterations() == budget.iterations()
