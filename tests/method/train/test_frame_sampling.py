"""Order of training images."""

import numpy as np
import pytest

from splatreel.method.train.frame_sampling import FrameSchedule


def test_frontier_moves_from_first_to_last_frame():
    schedule = FrameSchedule(np.ones((10, 3), bool), iterations=1000, progressive=0.5, seed=0)
    assert [schedule.frontier(i) for i in (0, 49, 50, 250, 499, 500, 999)] == [0, 0, 1, 5, 9, 9, 9]
    for i in range(0, 500, 7):
        frame, camera = schedule.draw(i)
        assert frame <= schedule.frontier(i)
        assert 0 <= camera < 3


def test_warm_up_prefers_newest_frames():
    schedule = FrameSchedule(np.ones((10, 3), bool), iterations=1000, progressive=0.5, seed=0)
    drawn = [schedule.draw(250) for _ in range(600)]  # the frontier is frame 5
    assert set(drawn) == {(frame, camera) for frame in range(6) for camera in range(3)}
    newest = np.mean([frame > 5 - FrameSchedule.FRONTIER_FRAMES for frame, _ in drawn])
    share = FrameSchedule.FRONTIER_SHARE
    assert newest == pytest.approx(share + (1 - share) / 2, abs=0.06)


@pytest.mark.parametrize("progressive", [0.0, 0.5])
def test_round_contains_every_image_once(progressive):
    schedule = FrameSchedule(np.ones((5, 4), bool), iterations=100, progressive=progressive, seed=1)
    for _ in range(3):
        assert sorted(schedule.draw(99) for _ in range(20)) == [(f, c) for f in range(5) for c in range(4)]
    orders = [[schedule.draw(99) for _ in range(20)] for _ in range(2)]
    assert orders[0] != orders[1]


def test_frame_with_larger_loss_is_drawn_more_often():
    schedule = FrameSchedule(np.ones((6, 8), bool), iterations=100, progressive=0.0, seed=0)
    for frame in range(6):
        for camera in range(8):  # some cameras have larger errors in every frame
            schedule.record_loss(frame, camera, (2.0 if frame == 4 else 1.0) * (1 + camera))
    wanted = schedule.draws_per_round()
    assert wanted.mean() == pytest.approx(1)
    assert wanted[4] == pytest.approx(2 * wanted[0])
    np.testing.assert_allclose(wanted[[0, 1, 2, 3, 5]], wanted[0])
    drawn = np.bincount([schedule.draw(99)[0] for _ in range(48 * 40)], minlength=6)
    assert drawn[4] == pytest.approx(2 * drawn[[0, 1, 2, 3, 5]].mean(), rel=0.1)


def test_draws_per_round_are_limited():
    schedule = FrameSchedule(np.ones((4, 1), bool), iterations=10, progressive=0.0, seed=0)
    for frame, loss in enumerate((1e-9, 1.0, 1.0, 1e3)):
        schedule.record_loss(frame, 0, loss)
    wanted = schedule.draws_per_round()
    assert wanted.max() / wanted.min() <= 6
    assert {schedule.draw(0)[0] for _ in range(60)} == {0, 1, 2, 3}


def test_frames_without_loss_have_mean_draws():
    schedule = FrameSchedule(np.ones((3, 2), bool), iterations=10, progressive=0.0, seed=0)
    schedule.record_loss(0, 0, 0.5)
    np.testing.assert_allclose(schedule.draws_per_round(), 1)


@pytest.mark.parametrize("progressive", [0.0, 0.5])
def test_missing_images_are_never_drawn(progressive):
    available = np.ones((4, 3), bool)
    available[0, 1] = available[2, :2] = False
    schedule = FrameSchedule(available, iterations=200, progressive=progressive, seed=0)
    drawn = {schedule.draw(iteration) for iteration in range(200)}
    assert drawn == {(frame, camera) for frame, camera in np.argwhere(available).tolist()}
