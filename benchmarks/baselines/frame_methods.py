"""Baselines that train frame by frame: 3DGS per frame, 3DGStream-like and V3-like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from baselines.frame_training import add_points, move_points, train_freely, train_in_place
from baselines.part_by_part import Frames
from baselines.shared_start import SharedStart
from splatreel.codec.group_file import encode_layer
from splatreel.config import EncodeConfig
from splatreel.method.encode.compression import group_importance, weigh
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group, group_spans

VIEWS = 4
"""Views that the importance of the points of a frame is measured in."""
ADDING = 0.25
"""Share of a frame's iterations that trains added points."""
MOVING = 0.5
"""Share of a frame's iterations that moves points before their attributes are trained."""
VIDEO = EncodeConfig(codec="h265", sh_entries=0).with_h265(
    source="ori", crf_attributes=20, weighted_codebook=False, fold=False
)
"""V3's coding: positions in 16 bits, all else in 8 bits, as maps in H.265."""


class FrameByFrame:
    """Method whose parts are single frames."""

    def parts(self, start: SharedStart) -> list[range]:
        """Return every frame after the keyframe."""
        return [range(frame, frame + 1) for frame in range(1, start.capture.frames)]


class PerFrame(FrameByFrame):
    """3DGS per frame.

    What it is: every frame trains all attributes with 3DGS's density control, and is stored whole. It starts from the frame
    before, which is better at a short time than a start from sparse points.

    What it is not: frames from scratch for the full number of iterations, as papers train them; `bench oracle` does that.
    The reel is coded by our codec, which is far smaller than the PLY files of papers.
    """

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the keyframe."""
        return keyframe

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        """Train all attributes."""
        return [train_freely(start, before, images[0], iterations, first)]

    def write(self, start: SharedStart, frames: Frames, reel: Path) -> None:
        """Write each frame as a layer that lives for one frame."""
        writer = start.open_writer(reel, 1, start.config.encode)
        header = writer.manifest
        for frame in range(frames.count):
            points = frames.load(frame)
            moments, cameras = [points], list(header.cameras)
            importance = weigh(moments, cameras, header.near, header.antialias, VIEWS)
            until = frame + 1 if frame + 1 < frames.count else None
            # In one part: no player shows a part of a single frame.
            file, order = encode_layer(frame, frame, points, writer.config, importance)
            writer.add_layer(frame, frame, points, encoded=((file,), order), until=until)
            none = Gaussians.empty(header.sh_degree), np.zeros((1, 0, 3), np.float32), np.zeros((1, 0, 4), np.float32)
            alive = np.ones(len(points), bool)
            writer.add_group(Group(frame, frame, *none, alive, light=start.light(frame, 1)))
        writer.finish()


class Streaming(FrameByFrame):
    """3DGStream-like: the motion of all points since the frame before, and added points.

    What it is: a hash grid with a small network moves and turns all points from one frame to the next, and points are added
    where gradients stay large, as in 3DGStream.

    What it is not: 3DGStream stores the network of each frame, 7.6 MB. Our codec stores the offsets of points instead, with
    knowledge of the whole video, which is far smaller and cannot be streamed. Added points stay, as in HiCoM; 3DGStream drops
    them with their frame. The grid has 8 levels of 2^13 entries, so that a CPU trains it.
    """

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the keyframe."""
        return keyframe

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        """Move all points, then add some."""
        adding = int(ADDING * iterations)
        moved, meter = move_points(start, before, images[0], iterations - adding, first)
        added = add_points(start, moved, meter, images[0], adding, first)
        return [Gaussians.concatenate([moved, added])]

    def write(self, start: SharedStart, frames: Frames, reel: Path) -> None:
        """Write one group of all frames. Points are transparent before the frame that added them."""
        write_groups(start, frames, reel, [range(frames.count)], start.config.encode)


class AttributeVideo(FrameByFrame):
    """V3-like: attributes of points over time as video.

    What it is: a fixed number of points, moved from frame to frame by a hash grid, then trained in place. Each group of frames
    is coded as maps of positions and rotations in H.265, as in V3. View-dependent color is left out, as in V3.

    What it is not: V3 is made for a person in an empty room. Sizes of points do not change here, and our codec stores the
    changes of color and opacity. There is no loss on the entropy of changes.
    """

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the keyframe without view-dependent color."""
        return replace(keyframe, sh=keyframe.sh[:, :1])

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        """Move all points, then train them in place."""
        moving = int(MOVING * iterations)
        moved = move_points(start, before, images[0], moving, first)[0] if moving else before
        return [train_in_place(start, moved, images[0], max(iterations - moving, 1), first)]

    def write(self, start: SharedStart, frames: Frames, reel: Path) -> None:
        """Write groups of all points without layers."""
        write_groups(start, frames, reel, group_ranges(start), VIDEO, 0)


def group_ranges(start: SharedStart) -> list[range]:
    """Return the frames of each group, without overlaps."""
    spans = group_spans(start.capture.frames, start.config.group.length, 0)
    return [range(span.first, span.first + span.count) for span in spans]


def write_groups(
    start: SharedStart,
    frames: Frames,
    reel: Path,
    parts: list[range],
    encode: EncodeConfig,
    sh_degree: int | None = None,
) -> None:
    """Write groups of all points without layers.

    Args:
        start: Run that the baseline starts from.
        frames: Points of all frames.
        reel: The reel.
        parts: Frames of each group.
        encode: Settings of the codec. Points in H.265 are not weighed by their effect on the images, as in V3.
        sh_degree: Degree of the colors; None for that of the run.
    """
    writer = start.open_writer(reel, len(parts[0]), encode, sh_degree)
    nothing = Gaussians.empty(writer.manifest.sh_degree)
    for index, part in enumerate(parts):
        group, importance = chain(start, frames, part[0], len(part), index), None
        if encode.codec != "h265":
            importance = group_importance(writer.manifest, writer.config, nothing, group)[0]
        writer.add_group(group, importance)
    writer.finish()


def chain(start: SharedStart, frames: Frames, first: int, count: int, index: int) -> Group:
    """Return frames as one group of points that move and change color and opacity.

    The points of a frame are the first rows of the next. A point is transparent before its first frame, in its first place.

    Args:
        start: Run that the baseline starts from.
        frames: Points of all frames.
        first: First frame of the group.
        count: Number of frames of the group.
        index: Number of the group.
    """
    shown = [frames.load(frame) for frame in range(first, first + count)]
    counts = [0, *(len(points) for points in shown)]
    dynamic = Gaussians.concatenate([points[counts[t] :] for t, points in enumerate(shown)])
    total = len(dynamic)
    dx = np.zeros((count, total, 3), np.float32)
    dq = np.zeros((count, total, 4), np.float32)
    dq[..., 0] = 1
    shade = np.zeros((count, total, 4), np.float32)
    back = rotations.conjugate(dynamic.quats)
    for t, points in enumerate(shown):
        own = len(points)
        dx[t, :own] = points.means - dynamic.means[:own]
        dq[t, :own] = rotations.multiply(back[:own], points.quats)
        shade[t, :own, :3] = points.sh[:, 0] - dynamic.sh[:own, 0]
        shade[t, :own, 3] = points.opacities - dynamic.opacities[:own]
        shade[t, own:, 3] = -dynamic.opacities[own:]
    return Group(
        index, first, dynamic, dx, dq, np.zeros(0, bool), shade if shade.any() else None, start.light(first, count)
    )
