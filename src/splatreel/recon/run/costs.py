"""What the stages of a reconstruction cost in seconds, on one thread of the machine that they were measured on.

The numbers are fitted to the timings of films 160 to 2576 pixels wide, most of them in `benchmarks/results.jsonl`. Totals come out
within 30 % of nearly all; one film's own timings differ by as much from day to day.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from splatreel.config import Config
from splatreel.recon.cameras.group_input import ENOUGH_SIDE
from splatreel.recon.train.keyframe import GAINS_EVERY
from splatreel.recon.train.pictures import size_ends
from splatreel.scene.spans import GroupSpan

COARSE = 0.25
"""Pixels of a picture of half size."""
USUAL = 0.0576
"""Megapixels (320x180) that the numbers of points are for."""
HASHGRID = 3.0
"""An iteration of a group by the hash grid over one by splines."""
LIFTING = 280.0
"""Labels of points by the paper's optimization, in iterations of a keyframe."""
GRABCUT = 6.0
"""Seconds a megapixel of masks that are completed by GrabCut; of SAM2 nothing is known."""
CHAPTER_START = 0.5
"""The first keyframe of a chapter over that of a sequence: it trains only what the shared static points lack."""
SCENE_POINTS = 2.0
"""Initial points of several moments, for the scene that chapters share, over those of one."""
READING = 0.015
"""Seconds a megapixel that is decoded."""


@dataclass(frozen=True)
class Shooting:
    """What costs depend on. megapixels: of a picture. cameras: trained on. moving: share of the pixels that change in a group.

    facing: from 0, cameras all around, to 1, cameras that look the same way, of which each sees all points.
    """

    megapixels: float
    cameras: int
    moving: float
    facing: float

    def dynamic(self, config: Config) -> float:
        """Thousands of points that are going to move. Where there are more than usual, more of them do."""
        size, crowd = self.megapixels / USUAL, max(1.0, self.points(config) / self._usual)
        return (1 + 24 * self.moving) * size**0.3 * crowd

    def points(self, config: Config) -> float:
        """Thousands of points of the first keyframe. Where no price is on opacities, as many as there may be."""
        keyframe = config.keyframe
        most = min(keyframe.max_points, keyframe.points_per_pixel * self.megapixels * 1e6) / 1e3
        if not keyframe.lambda_opacity:
            return max(self._usual, most)
        return min(self._usual, keyframe.max_points / 1e3)

    @property
    def _usual(self) -> float:
        return 22 * (self.megapixels / USUAL) ** 0.3

    def drawn(self, config: Config) -> float:
        """The same, in points as large as usual: the more there are for a picture, the smaller they are."""
        points = self.points(config)
        size = (self.megapixels / USUAL) / (points / 22)
        return points * min(1.0, math.sqrt(size))


Seconds = dict[str, float]
"""By stage."""


def sequence_seconds(shooting: Shooting, spans: Sequence[GroupSpan], config: Config) -> Seconds:
    """Of a video of one chapter."""
    first = {"points": _points(shooting, config), "keyframe": _first_keyframe(shooting, config)}
    return together([first, *_groups(shooting, spans, config)])


def scene_seconds(shooting: Shooting, config: Config) -> Seconds:
    """Of the scene that chapters share."""
    return {"points": SCENE_POINTS * _points(shooting, config), "keyframe": _first_keyframe(shooting, config)}


def chapter_seconds(shooting: Shooting, spans: Sequence[GroupSpan], config: Config) -> Seconds:
    """Of one chapter."""
    first = {"keyframe": CHAPTER_START * _first_keyframe(shooting, config)}
    return together([first, *_groups(shooting, spans, config)])


def together(parts: Iterable[Seconds]) -> Seconds:
    """Their sum, stage by stage."""
    found: Seconds = {}
    for part in parts:
        for stage, seconds in part.items():
            found[stage] = found.get(stage, 0.0) + seconds
    return found


def _groups(shooting: Shooting, spans: Sequence[GroupSpan], config: Config) -> list[Seconds]:
    """Of each group, and of all keyframes but the first."""
    later = {"keyframe": _later_keyframe(shooting, config)}
    return [*(_group(shooting, span, config) for span in spans), *(later for _ in spans[1:])]


def _points(shooting: Shooting, config: Config) -> float:
    cameras, megapixels = shooting.cameras, shooting.megapixels
    seconds = 1.0 + cameras * (0.07 + 0.45 * megapixels)
    if config.check_poses:
        seconds += cameras * (0.22 + 0.5 * megapixels)
    if config.check_coverage:
        seconds += 3.5
    return seconds


def _first_keyframe(shooting: Shooting, config: Config) -> float:
    keyframe = config.keyframe
    return keyframe.first_iterations * _step(shooting, config, _pixels(shooting, config, keyframe.coarse_share))


def _step(shooting: Shooting, config: Config, pixels: float = 1.0) -> float:
    """An iteration of a keyframe of all points. pixels: over those of the whole picture."""
    points = 0.0007 + 0.0005 * shooting.facing
    return 0.3 * shooting.megapixels * pixels + points * shooting.drawn(config)


def _later_keyframe(shooting: Shooting, config: Config) -> float:
    megapixels = shooting.megapixels * _pixels(shooting, config, 0.0)
    return config.keyframe.refine_iterations * (0.152 / GAINS_EVERY * megapixels + 0.0012 * shooting.dynamic(config))


def _group(shooting: Shooting, span: GroupSpan, config: Config) -> Seconds:
    """All of a group but its keyframe, and the decoding of its pictures."""
    frames, cameras, megapixels, dynamic = span.count, shooting.cameras, shooting.megapixels, shooting.dynamic(config)
    decoded, smaller = cameras * frames * megapixels, _smaller(megapixels)
    seconds = {
        "reading": READING * decoded,
        "cameras": (0.04 * cameras if config.check_poses else 0.0) + 0.007 * decoded * config.even_exposure,
        "keyframe": 0.02 * decoded if config.keyframe.temporal_mean else 0.0,
        "encode": 0.42 + 0.31 * cameras * smaller + 0.0097 * dynamic * frames,
    }
    if frames > 1:
        seconds["layering"] = _layering(shooting, frames, config)
        seconds["group"] = _motion(shooting, frames, config)
        if config.group.tracks:
            seconds["tracking"] = frames * (0.25 * cameras * smaller + (0.18 + 0.0022 * cameras) * dynamic)
    return seconds


def _layering(shooting: Shooting, frames: int, config: Config) -> float:
    """Large pictures are halved first, to no more than 640 pixels across for flow, and 0.1 megapixels for light."""
    layering, cameras, megapixels = config.layering, shooting.cameras, shooting.megapixels
    flow = 4.33 * cameras * min(megapixels, 0.115) * min(layering.flow_frames, frames - 1) / 7
    light = 0.165 * cameras * frames * min(megapixels, 0.077) if layering.relighting else 0.0
    lifting = LIFTING * _step(shooting, config) if layering.lift == "optimize" else 0.0
    completing = GRABCUT * cameras * megapixels if layering.segment != "none" else 0.0
    return 1.0 + flow + light + lifting + completing


def _motion(shooting: Shooting, frames: int, config: Config) -> float:
    group = config.group
    pixels = _pixels(shooting, config, group.coarse_share)
    step = 0.03 * shooting.megapixels * pixels + 0.0031 * shooting.dynamic(config) + 0.0014
    step *= HASHGRID if group.deformation == "hashgrid" else 1.0
    views = 0.152 * shooting.cameras * math.sqrt(shooting.megapixels)
    return views + group.iterations_per_frame * frames * step


def _smaller(megapixels: float) -> float:
    """Of the pictures that layering and tracking look at: as `GroupInput.smaller`, if they are three quarters as high as wide."""
    while megapixels > 0.75e-6 * ENOUGH_SIDE**2:
        megapixels *= COARSE
    return megapixels


def _pixels(shooting: Shooting, config: Config, coarse_share: float) -> float:
    """Pixels of an iteration, in the mean, over those of the whole picture: many look at smaller ones."""
    ends = [*size_ends(shooting.megapixels, coarse_share, config.training_megapixels), 0.0]
    return sum((end - begin) * COARSE**halvings for halvings, (end, begin) in enumerate(pairwise(ends)))
