import pytest

from splatreel.run.machines.scaling import SERIAL_CHAPTER, Division, chapters_time, divide, job_time, run_time


def test_threads_speed_up_only_the_parallel_share() -> None:
    assert job_time(100.0, 0.2, 1) == 100.0
    assert job_time(100.0, 0.2, 4) == pytest.approx(20 + 80 / 4)


def test_chapters_are_made_in_rounds() -> None:
    one = job_time(1.0, SERIAL_CHAPTER, 4)
    assert chapters_time(1.0, 8, Division(4, 4)) == pytest.approx(2 * one)
    assert chapters_time(1.0, 9, Division(4, 4)) == pytest.approx(3 * one)
    assert chapters_time(1.0, 9, Division(4, 4), machines=3) == pytest.approx(one)


def test_machine_is_divided_by_its_cores_its_memory_and_the_chapters() -> None:
    assert divide(1, 20) == Division(1, 1)
    assert divide(16, 1) == Division(1, 16)
    assert divide(16, 20, most=3).workers <= 3
    for cores in range(1, 33):
        for chapters in range(1, 12):
            found = divide(cores, chapters)
            assert found.workers * found.threads <= cores
            assert found.workers <= chapters
            times = [chapters_time(1.0, chapters, Division(w, cores // w)) for w in range(1, min(cores, chapters) + 1)]
            assert chapters_time(1.0, chapters, found) <= 1.15 * min(times)


def test_scene_and_finish_limit_the_speedup() -> None:
    parts = {"scene": 60.0, "chapter": 1000.0, "finish": 5.0, "chapters": 20}
    times = [run_time(**parts, cores=cores, machines=machines) for cores, machines in ((1, 1), (16, 1), (16, 8))]
    assert times[0] == pytest.approx(20065)
    assert times[0] / 16 < times[1] < times[0] / 6
    assert times[2] < times[1] / 4
