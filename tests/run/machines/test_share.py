import pytest

from splatreel.base.errors import UsageError
from splatreel.run.machines.share import Share, parse_share, share_of_task


def slurm(task: int, first: int, count: int, **more: str) -> dict[str, str]:
    names = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_MIN": first, "SLURM_ARRAY_TASK_COUNT": count}
    return {name: str(value) for name, value in names.items()} | more


def test_shares_hold_every_chapter_once() -> None:
    chapters = [chapter for index in range(4) for chapter in Share(index, 4).of(10)]
    assert sorted(chapters) == list(range(10))
    assert list(Share(3, 4).of(3)) == []
    assert parse_share(" 2/8") == Share(2, 8)


@pytest.mark.parametrize("text", ["", "8/8", "1", "-1/2", "1/0", "a/b", "1/2/3"])
def test_invalid_shares_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"is not a share of the chapters. Write I/N"):
        parse_share(text)


def test_task_of_a_slurm_array_finds_its_share() -> None:
    assert share_of_task(slurm(0, 0, 8)) == Share(0, 8)
    assert share_of_task(slurm(3, 1, 8)) == Share(2, 8)
    assert share_of_task(slurm(9, 1, 3, SLURM_ARRAY_TASK_STEP="4")) == Share(2, 3)


def test_chapter_job_outside_of_slurm_names_the_option() -> None:
    with pytest.raises(UsageError, match="--chapter I/N, or start a Slurm array task, which sets SLURM_ARRAY"):
        share_of_task({})
    with pytest.raises(UsageError, match="SLURM_ARRAY_TASK_ID 2 is not one of 3 tasks from 1 in steps of 4"):
        share_of_task(slurm(2, 1, 3, SLURM_ARRAY_TASK_STEP="4"))
    with pytest.raises(UsageError, match="is not one of 3 tasks"):
        share_of_task(slurm(7, 1, 3))
