"""A stretch that was left out: the last known points, held still."""

from __future__ import annotations

import numpy as np

from splatreel.recon.encode.importance import weigh
from splatreel.recon.encode.output import Output
from splatreel.recon.init.layout import Layout
from splatreel.recon.run.job import Job
from splatreel.recon.run.store import StoredLayer
from splatreel.recon.stages.stage import AfterGap, NextGroup, RetiredStatic
from splatreel.recon.stages.write_stages import write_group
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints


def hold_group(
    job: Job, span: GroupSpan, before: NextGroup, edge: np.ndarray, layout: Layout, output: Output
) -> AfterGap:
    """A group in which nothing moves, published: a reel has no frame without a group. The next one starts where this one did.

    edge: [C, H, W, 3] uint8, the pictures of the last frame before the gap.
    """
    static = before.static
    if isinstance(static, RetiredStatic):
        static = _renew(job, span, before, static, layout, output)
    still, count = before.dynamic, span.count
    dq = np.tile(np.array([1, 0, 0, 0], np.float32), (count, len(still), 1))
    light = np.tile(np.exp(before.rig.light), (count, 1)) if before.rig.light.any() else None
    group = Group(
        span.index, span.first, still, np.zeros((count, len(still), 3), np.float32), dq, static.alive, light=light
    )
    with job.timed("encode"):
        write_group(job, None, group, static, output)
    return AfterGap(before.rig, static, still, None, edge)


def _renew(
    job: Job, span: GroupSpan, before: NextGroup, static: RetiredStatic, layout: Layout, output: Output
) -> StaticPoints:
    """The static points that are there, written anew."""
    none = StaticPoints.none(job.config.keyframe.sh_degree)
    living = static.trained[static.alive]
    if not len(living):
        return none
    seen = Gaussians.concatenate([living, before.dynamic])
    importance = weigh([seen], before.rig.cameras, layout.near, job.device, job.config.antialias)[: len(living)]
    encoded = output.encoder.layer(span.index, span.first, living, importance)
    decoded, order = output.add_layer(span.index, span.first, living, encoded), encoded[1]
    job.store.group(span.index).save_layer(StoredLayer(living[order], decoded, importance[order]))
    return none.with_layer(decoded)
