import numpy as np

from splatreel.recon.schedule import FrameSchedule


def test_frames_come_in_from_near_to_far():
    schedule = FrameSchedule(frames=10, iterations=1000, progressive=0.5, seed=0)
    assert [schedule.frontier(i) for i in (0, 49, 50, 250, 499, 500, 999)] == [0, 0, 1, 5, 9, 9, 9]
    for i in range(0, 500, 7):
        assert schedule.draw(i) <= schedule.frontier(i)


def test_after_the_warm_up_all_frames_are_drawn_evenly():
    schedule = FrameSchedule(frames=5, iterations=100, progressive=0.5, seed=1)
    counts = np.bincount([schedule.draw(99) for _ in range(5000)], minlength=5)
    assert counts.min() > 850
    assert counts.max() < 1150


def test_without_progressive_sampling_every_frame_is_drawn_from_the_start():
    schedule = FrameSchedule(frames=8, iterations=100, progressive=0.0, seed=0)
    assert {schedule.draw(0) for _ in range(300)} == set(range(8))
