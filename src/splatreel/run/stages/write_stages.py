"""Stages that encode: the new static points as a layer, and the finished group."""

from __future__ import annotations

from splatreel.codec.predictive.precision import STEPS
from splatreel.config import Config
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.encode.importance import group_importance, weigh
from splatreel.method.encode.step_choice import encode_group_by_slope, encode_layer_by_slope
from splatreel.run.job import Job
from splatreel.run.output.group_output import Output
from splatreel.run.stages.stage import GroupState, Stage
from splatreel.run.store import StoredGroup, StoredLayer
from splatreel.run.workload import Workload
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.static_points import StaticPoints


class WriteLayer(Stage[StaticPoints]):
    """Encodes the new static points as a layer. Later stages use the decoded points, and so make up for the loss."""

    name = "encode"
    text = "encoding static points"
    label = "encoding"

    def is_needed(self, state: GroupState) -> bool:
        """Return True if there are new static points."""
        return len(state.layers.settled) > 0

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return seconds that grow with the number of pixels."""
        return 0.21 + 0.155 * work.cameras * work.smaller()

    def run(self, state: GroupState) -> StaticPoints:
        """Encode, decode and save the layer."""
        job, data, layers, output = state.job, state.data, state.layers, state.output
        settled, relit = layers.settled, layers.relit.points
        seen = Gaussians.concatenate([settled, layers.dynamic, relit, state.static.living])
        others, moving = seen[len(settled) :], len(layers.dynamic) + len(relit)
        importance = weigh([seen], data.cameras, data.near, job.device, data.antialias)[: len(settled)]
        encoded, steps = encode_layer_by_slope(output.encoder, data, settled, others, moving, importance, job.trial)
        decoded, order = output.add_layer(data.span.index, data.span.first, settled, encoded), encoded[1]
        job.progress.update(1, points=len(decoded))
        state.store.save_layer(StoredLayer(settled[order], decoded, importance[order], steps))
        return state.static.with_layer(decoded)

    def apply(self, state: GroupState, found: StaticPoints) -> None:
        """Take over the static points."""
        state.static = found


class WriteGroup(Stage[Group]):
    """Saves the finished group, then encodes it. A group that a reel holds is never trained again."""

    name = "encode"
    text = "encoding the group"
    label = "encoding"

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return seconds that grow with pixels, dynamic points and frames."""
        return 0.21 + 0.155 * work.cameras * work.smaller() + 0.0097 * work.dynamic(config) * frames

    def run(self, state: GroupState) -> Group:
        """Save and encode the group."""
        found, data = state.motion, state.data
        arrays = found.dynamic, found.dx, found.dq, found.alive, found.shade, data.light
        group = Group(data.span.index, data.span.first, *arrays)
        write_group(state.job, data, group, state.static, state.output)
        state.job.progress.update(1)
        return group

    def apply(self, state: GroupState, found: Group) -> None:
        """Take over the group."""
        state.group = found


def write_group(job: Job, data: GroupInput | None, group: Group, static: StaticPoints, output: Output) -> None:
    """Save a finished group, then encode it.

    Args:
        job: The run.
        data: Images of the group, by which quantization steps are chosen; None: the default steps.
        group: The group.
        static: Static points that it shows.
        output: Destination of the encoded group.
    """
    encoder = output.encoder
    importance = group_importance(output.header, encoder.config, static.points, group, job.device)[0]
    if data is None:
        files, steps = encoder.group(group, importance), STEPS
    else:
        files, steps = encode_group_by_slope(encoder, data, group, static, importance, job.trial)
    job.store.group(group.index).save_group(StoredGroup(group, importance, steps))
    output.add_group(group, files)
