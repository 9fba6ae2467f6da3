"""Stages about the motion of a group: layering, tracking and motion training."""

from __future__ import annotations

import math

from splatreel.config import Config
from splatreel.method.cameras.rig import Rig, report_offsets
from splatreel.method.layering.labels import Layers, RelitPoints, find_layers
from splatreel.method.tracking.tracking import GroupStart, track
from splatreel.method.train.group import GroupResult
from splatreel.method.train.training import train_group
from splatreel.run import checkpoint
from splatreel.run.checkpoint import Arrays, present
from splatreel.run.stages.stage import GroupState, NextGroup, RetiredStatic, Stage
from splatreel.run.store import GroupStore
from splatreel.run.workload import Workload
from splatreel.scene.gaussians import Gaussians

HASHGRID = 3.0
"""Time of an iteration with the hash grid, as a multiple of one with splines."""
LIFTING = 280.0
"""Time of the paper's optimization of labels, in iterations of a keyframe."""
GRABCUT = 6.0
"""Seconds that GrabCut takes for a megapixel of masks. SAM2 was never timed."""
OFFSETS = "delays"
"""Name of the checkpoint of the cameras' time offsets."""


class Layering(Stage[Layers]):
    """Separates static from dynamic points (paper section 4.1)."""

    name = "layering"
    text = "separating static from moving points"
    label = text
    checkpoint = "layering"

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return the seconds of flow, light, labels and masks. Large images are halved to 640 pixels for flow, to 0.1 MP for light."""
        if frames < 2:
            return 0.0
        layering, cameras, megapixels = config.layering, work.cameras, work.megapixels
        flow = 1.44 * cameras * min(megapixels, 0.115) * min(layering.flow_frames, frames - 1) / 7
        light = 0.033 * cameras * frames * min(megapixels, 0.077) if layering.relighting else 0.0
        lifting = LIFTING * work.full_iteration(config) if layering.lift == "optimize" else 0.0
        completing = GRABCUT * cameras * megapixels if layering.segment != "none" else 0.0
        return 0.3 + flow + light + lifting + completing

    def run(self, state: GroupState) -> Layers:
        """Decide for every point whether it moves in this group."""
        found = find_layers(state.data, state.points, state.static, state.job.config.layering)
        resting = len(found.settled) + int(found.alive.sum())
        lit = {"lit": len(found.relit)} if len(found.relit) else {}
        state.job.progress.update(1, moving=len(found.dynamic), resting=resting, **lit)
        return found

    def apply(self, state: GroupState, found: Layers) -> None:
        """Take over the layers. Static points whose layers end here become new static points."""
        if isinstance(state.static, RetiredStatic):
            found, state.static = state.static.reissue(found)
        state.layers, state.static = found, state.static.with_alive(found.alive)
        state.tracks = GroupStart(Gaussians.concatenate([found.dynamic, found.relit.points]))

    def pack(self, found: Layers) -> Arrays:
        """Return the layers as arrays."""
        arrays = {"alive": found.alive, "light": found.relit.light}
        kinds = {"settled": found.settled, "dynamic": found.dynamic, "relit": found.relit.points}
        for kind, points in kinds.items():
            arrays |= checkpoint.pack(points, f"{kind}_")
        return arrays

    def unpack(self, arrays: Arrays) -> Layers:
        """Return the layers from arrays."""
        settled, dynamic, relit = (checkpoint.unpack(arrays, f"{kind}_") for kind in ("settled", "dynamic", "relit"))
        return Layers(arrays["alive"], settled, dynamic, RelitPoints(relit, arrays["light"]))


class Tracking(Stage[GroupStart]):
    """Tracks the dynamic points by optical flow, and adds points for what appears."""

    name = "tracking"
    text = "tracking moving points"
    label = text
    checkpoint = "tracking"

    def is_needed(self, state: GroupState) -> bool:
        """Return True if there are frames to track over."""
        return state.job.config.group.tracks and state.span.count > 1

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return seconds that grow with frames, images and dynamic points."""
        if frames < 2 or not config.group.tracks:
            return 0.0
        return frames * (0.12 * work.cameras * work.smaller() + (0.09 + 0.0011 * work.cameras) * work.dynamic(config))

    def steps(self, state: GroupState) -> int:
        """Return the number of frames."""
        return state.span.count

    def run(self, state: GroupState) -> GroupStart:
        """Track the dynamic points, at first by their velocity in the group before."""
        job, data, layers = state.job, state.data, state.layers
        velocity = state.start.velocity if isinstance(state.start, NextGroup) else None
        velocities = velocity and velocity.at(layers.dynamic.means, data.unit)
        found = track(data, layers.dynamic, layers.relit, state.static, velocities, job.config.layering, job.progress)
        appeared = len(found.dynamic) - len(layers.dynamic) - len(layers.relit)
        job.progress.update(state.span.count, moving=len(found.dynamic), appeared=appeared)
        return found

    def apply(self, state: GroupState, found: GroupStart) -> None:
        """Take over the tracks. Static points that have left their place are dynamic from here on."""
        state.tracks = found
        if found.departed is not None:
            state.static = state.static.without(found.departed)

    def pack(self, found: GroupStart) -> Arrays:
        """Return the tracks as arrays."""
        return checkpoint.pack(found.dynamic) | present(tracks=found.tracks, shades=found.shades, left=found.departed)

    def unpack(self, arrays: Arrays) -> GroupStart:
        """Return the tracks from arrays."""
        return GroupStart(checkpoint.unpack(arrays), arrays.get("tracks"), arrays.get("shades"), arrays.get("left"))


class Motion(Stage[GroupResult]):
    """Trains the motion of the dynamic points (paper section 4.2). The file of the finished group is its checkpoint."""

    name = "group"
    text = "training the motion"
    label = text
    trains = True

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return the seconds of all iterations, and of the static background of each view."""
        if frames < 2:
            return 0.0
        group = config.group
        pixels = work.training_share(config, group.coarse_share)
        iteration = 0.03 * work.megapixels * pixels + 0.0031 * work.dynamic(config) + 0.0014
        iteration *= HASHGRID if group.deformation == "hashgrid" else 1.0
        views = 0.152 * work.cameras * math.sqrt(work.megapixels)
        return views + group.iterations_per_frame * frames * iteration

    def steps(self, state: GroupState) -> int:
        """Return the number of iterations."""
        return state.job.config.group.iterations_per_frame * state.span.count

    def run(self, state: GroupState) -> GroupResult:
        """Train the dynamic points and their motion on all frames of the training views."""
        found = train_group(state.data, state.tracks, state.static, state.job.config, state.job.progress)
        state.job.progress.update(self.steps(state), moving=len(found.dynamic))
        found.dynamic.check_finite(f"Group {state.span.index}")
        return found

    def apply(self, state: GroupState, found: GroupResult) -> None:
        """Take over the motion and the time offsets of the cameras."""
        state.motion = found
        if state.job.config.group.time_offsets:
            offsets = found.time_offsets
            state.store.save(OFFSETS, {"delays": offsets.values})
            state.rig = state.rig.with_offsets(offsets.values)
            report_offsets(state.rig, offsets, state.job.progress)

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig with the time offsets at the end of the group."""
        arrays = store.load(OFFSETS)
        return rig if arrays is None else rig.with_offsets(arrays["delays"])
