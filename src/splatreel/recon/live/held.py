"""A stretch that was left out: the last known points, held still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.recon.encode.importance import weigh
from splatreel.recon.encode.output import Output
from splatreel.recon.groups import Handover
from splatreel.recon.init.layout import Layout
from splatreel.recon.run.job import Job
from splatreel.recon.run.store import StoredLayer
from splatreel.recon.stages import publish_group
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints


def hold_group(job: Job, span: GroupSpan, before: Handover, layout: Layout, output: Output) -> Handover:
    """A group in which nothing moves, published: a reel has no frame without a group. The next one starts where this one did."""
    static = before.static if before.trained is None else _renew(job, span, before, layout, output)
    still, count = before.dynamic, span.count
    dq = np.tile(np.array([1, 0, 0, 0], np.float32), (count, len(still), 1))
    light = np.tile(np.exp(before.rig.light), (count, 1)) if before.rig.light.any() else None
    group = Group(
        span.index, span.first, still, np.zeros((count, len(still), 3), np.float32), dq, static.alive, light=light
    )
    with job.timed("encode"):
        publish_group(job, None, group, static, output)
    return replace(before, static=static, velocity=None, trained=None)


def _renew(job: Job, span: GroupSpan, before: Handover, layout: Layout, output: Output) -> StaticPoints:
    """The static points that are there, written anew."""
    none = StaticPoints.none(job.config.keyframe.sh_degree)
    assert before.trained is not None
    living = before.trained[before.static.alive]
    if not len(living):
        return none
    seen = Gaussians.concatenate([living, before.dynamic])
    importance = weigh([seen], before.rig.cameras, layout.near, job.device, job.config.antialias)[: len(living)]
    encoded = output.encoder.layer(span.index, span.first, living, importance)
    decoded, order = output.add_layer(span.index, span.first, living, encoded), encoded[1]
    job.store.group(span.index).save_layer(StoredLayer(living[order], decoded, importance[order]))
    return none.with_layer(decoded)
