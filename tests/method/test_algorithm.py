"""Steps of a group in the order of the paper's sections, for all kinds of groups and settings."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from splatreel.base.progress import Progress, Silent
from splatreel.codec.encoder import ReelEncoder
from splatreel.config import Config
from splatreel.method.algorithm import ChapterStart, FirstGroup, NextGroup, Start, reconstruct_group, renew_static
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.compression import Coding
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.method.train.single_frame import lay_out
from splatreel.run.output.group_writer import header_of
from splatreel.run.steps import STEPS
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import GroupSpan
from tests.method.captures import WallCapture
from tests.method.small import small

FRAMES = 3
CAPTURE = WallCapture(FRAMES, drift=0.05)
CAMERAS = ["exposure", "even exposures", "poses"]
REST = ["layering", "layer", "tracking", "motion", "encode"]


class Recorder:
    """Run that executes steps and records their names and results."""

    def __init__(self) -> None:
        self.progress: Progress = Silent()
        self.found: dict[str, Any] = {}

    def __call__(self, step: str, compute: Callable[..., Any], *arguments: Any) -> Any:
        assert step in STEPS
        self.found[step] = compute(*arguments)
        return self.found[step]


class Watch:
    """Receiver of keyframes that ignores them."""

    def show(self, gaussians: Callable[[], Gaussians]) -> None: ...

    def finish(self, points: Gaussians) -> None: ...


def reconstruct(
    config: Config, start: Start | None = None, frames: int = FRAMES, subject_only: bool = False
) -> tuple[Recorder, NextGroup]:
    """Reconstruct the first frames of the wall.

    start: state before them; None for the first group of a video. subject_only: the images are those of a capture with masks.
    """
    rig, images = Rig.of(CAPTURE.training_cameras), CAPTURE.read(0, frames, [camera.name for camera in CAPTURE.cameras])
    seeds, layout = lay_out(rig.cameras, images[0], config)
    if subject_only:
        layout = replace(layout, backgrounds={camera.name: (0.0, 0.0, 0.0) for camera in rig.cameras})
    start = start or FirstGroup(rig, StaticPoints.none(1), (seeds.points, seeds.colors))
    header = header_of(rig.cameras, 30, config, layout, None)
    coding = Coding(ReelEncoder(config.encode, rig.cameras), header, None)
    span = GroupSpan(0, 0, max(frames - 1, 1), frames)
    data = GroupInput(span, images, start.rig, None, layout, 0, config.antialias)
    run = Recorder()
    return run, reconstruct_group(data, start, config, coding, run, Watch())


def test_exposures_are_not_measured_on_a_subject_alone() -> None:
    """A subject that comes closer or turns is no change of exposure, and its surroundings are not in the images."""
    run, after = reconstruct(small(), subject_only=True)
    assert list(run.found) == ["poses", "first keyframe", *REST]
    assert not np.any(after.rig.exposure)


def test_steps_of_video_and_next_group_follow_the_sections_of_the_paper() -> None:
    run, after = reconstruct(small())
    assert list(run.found) == [*CAMERAS, "first keyframe", *REST]
    group = run.found["encode"].group
    np.testing.assert_array_equal(after.dynamic.means, group.at(FRAMES - 1).means)
    np.testing.assert_array_equal(after.static.alive, group.alive)
    np.testing.assert_array_equal(after.static.points.means, run.found["layer"].decoded.means)
    np.testing.assert_array_equal(after.rig.exposure, run.found["exposure"].change[FRAMES - 1])
    np.testing.assert_array_equal(after.rig.gains, run.found["first keyframe"].gains)
    np.testing.assert_array_equal(after.rig.time_offsets, run.found["motion"].time_offsets.values)
    assert after.velocity is not None
    later, _ = reconstruct(small(), after)
    assert [step for step in later.found if step != "layer"] == [*CAMERAS, "keyframe", *(REST[:1] + REST[2:])]


def test_chapter_starts_in_front_of_shared_points() -> None:
    run, _ = reconstruct(small(), ChapterStart(Rig.of(CAPTURE.training_cameras), StaticPoints.none(1)))
    assert list(run.found)[:4] == [*CAMERAS, "chapter keyframe"]


def test_settings_turn_steps_off() -> None:
    off = {"even_exposure": False, "check_poses": False, "group.tracks": False, "group.time_offsets": False}
    run, after = reconstruct(small(off))
    assert list(run.found) == ["first keyframe", "layering", "layer", "motion", "encode"]
    assert after.rig.ends == ()


def test_group_without_dynamic_points_trains_no_keyframe() -> None:
    static = StaticPoints.none(1)
    run, _ = reconstruct(small(), NextGroup(Rig.of(CAPTURE.training_cameras), static, Gaussians.empty(1)), frames=1)
    assert list(run.found) == [*CAMERAS, "layering", "motion", "encode"]


def test_retired_static_points_become_new_ones() -> None:
    rng = np.random.default_rng(0)
    trained, new_static, decoded = (points(rng, count) for count in (3, 2, 3))
    none = Gaussians.empty(0)
    layers = Layers(np.array([True, False, True]), new_static, none, RelitPoints(none, np.zeros((1, 0))))
    renewed, static = renew_static(layers, StaticPoints(decoded, np.ones(3, bool)), trained)
    np.testing.assert_array_equal(renewed.new_static.means, np.concatenate([trained.means[[0, 2]], new_static.means]))
    assert len(static.alive) == len(static.points) == 0
    kept, static = renew_static(layers, StaticPoints(decoded, np.ones(3, bool)), None)
    assert kept is layers
    assert static.alive.tolist() == [True, False, True]
    assert static.points is decoded


def points(rng: np.random.Generator, count: int) -> Gaussians:
    """Random Gaussians."""
    quats = np.tile(np.array([1.0, 0, 0, 0], np.float32), (count, 1))
    means, scales = rng.random((count, 3)), rng.random((count, 3))
    return Gaussians(means, quats, scales, rng.random(count), rng.random((count, 1, 3)))
