"""The whole way from a capture to a reel: group after group, published as they finish, continued where a run was cut off."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from splatreel.capture.base import Capture
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.kernels.image import render_image
from splatreel.motion.flow import make_flow
from splatreel.motion.light import changes_of_light
from splatreel.motion.temporal_mean import temporal_mean
from splatreel.progress import Progress, Silent
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.coverage.coverage import Coverage, cover, load_coverage, save_coverage
from splatreel.recon.encode.header import header_of
from splatreel.recon.encode.importance import weigh
from splatreel.recon.encode.publisher import (
    Present,
    Publisher,
    finished_groups,
    group_folder,
    importance,
    load_group,
    load_layer,
    nothing_more,
    open_writer,
    save_group,
    save_header,
)
from splatreel.recon.encode.sound import RunSound, hear, save_sound
from splatreel.recon.init.layout import Layout
from splatreel.recon.layering.labels import Layers, convertible, crowding, label_points, separate
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.recon.layering.tracking import Start, follow
from splatreel.recon.layering.velocity_prior import VelocityPrior
from splatreel.recon.run import checkpoint
from splatreel.recon.run.device import check_room, pick_device
from splatreel.recon.run.memory import check_memory
from splatreel.recon.run.plan import Plan
from splatreel.recon.run.requirements import check_capture, check_pictures
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.spans import Span, spans
from splatreel.recon.train.group import GroupTrainer
from splatreel.recon.train.keyframe import KeyframeTrainer
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.points import TrainablePoints, default_rates
from splatreel.recon.train.render import View
from splatreel.recon.train.single_frame import first_keyframe_trainer, lay_out, train_frame
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


@dataclass
class Scene:
    """What is handed from group to group. static: all static points so far, as decoded; alive: [S] bool; dynamic: at the keyframe.

    momentum: how they were going there, unless it is the first.
    """

    static: Gaussians
    alive: np.ndarray
    dynamic: Gaussians
    momentum: VelocityPrior | None = None


@dataclass(frozen=True)
class Result:
    """Where a reconstruction lies. seconds: per stage, summed over the groups and over interrupted runs."""

    reel: Path
    work: Path
    seconds: dict[str, float]
    device: str


def reconstruct(
    capture: Capture,
    out: Path,
    config: Config,
    *,
    sound: str = "auto",
    device: str = "auto",
    progress: Progress | None = None,
    present: Present = nothing_more,
) -> Result:
    """Reconstruct a capture into OUT/reel, with checkpoints in OUT/work; the same call continues an interrupted run.

    sound: auto (the best of the cameras'), none, the name of a camera, or a file. device: auto, cpu or cuda. present: adds what is
    there beside the points. Raises `ReconstructionError` when OUT belongs to another capture or configuration or is in use, or a
    checkpoint is damaged, `UsageError` for a device that is not there, `ReelError` where the disk refuses, and what the capture raises
    for frames or sound that cannot be read. What is finished stays, whatever is raised.
    """
    check_capture(capture)
    check_memory(capture, config.group.length + config.group.overlap)
    chosen = pick_device(device)
    progress = progress or Silent()
    with RunLock(Path(out), capture, config, sound) as claim:
        heard = hear(claim.work, capture, sound, progress)
        return Reconstruction(capture, claim, config, heard, chosen, progress, present).run()


class Reconstruction:
    """One run. Its methods are the stages, in order."""

    def __init__(
        self,
        capture: Capture,
        claim: RunLock,
        config: Config,
        sound: RunSound | None,
        device: torch.device,
        progress: Progress,
        present: Present,
    ) -> None:
        self.capture, self.claim, self.config, self.device, self.progress = capture, claim, config, device, progress
        self.sound, self.present = sound, present
        self.reel, self.work = claim.reel, claim.work
        self.spans = spans(capture.frames, config.group.length, config.group.overlap)
        self.plan = Plan([span.count for span in self.spans], config)
        self.seconds: dict[str, float] = self._load_seconds()
        self.rig = Rig(capture.training_cameras, config, device)

    def run(self) -> Result:
        layout = self._lay_out()
        writer = self._open_reel(layout)
        publisher = Publisher(writer, self.work, self.device)
        scene = Scene(Gaussians.empty(self.config.keyframe.sh_degree), np.zeros(0, bool), Gaussians.empty())
        finished = finished_groups(self.work)
        for span in self.spans[:finished]:
            scene = self._restore(span, scene, publisher)
        if finished:
            self.present(writer, finished - 1)
        todo = self.spans[finished:]
        with FramePrefetcher(self.capture, self.rig.names, [(s.first, s.count) for s in todo]) as stretches:
            for span, frames in zip(todo, stretches, strict=True):
                scene = self._group(span, scene, frames, layout, writer)
        self.present(writer, None)
        writer.finish()
        return Result(self.reel, self.work, self.seconds, self.device.type)

    def _group(self, span: Span, scene: Scene, frames: np.ndarray, layout: Layout, writer: ReelWriter) -> Scene:
        """All stages of one group; returns the scene at the next keyframe."""
        with self._timed("exposure"):
            light = self.rig.even_out(frames, span.own, self._folder(span), self.progress)
        with self._timed("poses"):
            self.rig.place(frames, self._folder(span), self.progress)
        points = self._keyframe(span, scene, frames, layout)
        scene = replace(scene, dynamic=points)
        layers = self._layer(span, scene, frames, layout)
        scene = self._settle(span, scene, layers, writer)
        start = self._follow(span, scene, layers.lit, frames, layout)
        if start.left is not None:
            scene.alive[scene.alive] = ~start.left
        self.rig.delays.restart()
        with self._timed("group"):
            iterations = self.config.group.iterations_per_frame * span.count
            self.progress.stage(self._title(span, "learning how it moves"), iterations, self.plan.motion(span.index))
            data = Pictures(self._on_device(frames), self._views(layout), layout.near, layout.unit)
            trainer = GroupTrainer(
                data,
                start,
                scene.static,
                scene.alive,
                self.rig.gains,
                self.config,
                self.config.seed + span.index,
                self._convertible(scene, frames, layout),
                self.rig.delays,
            )
            result = trainer.train(self.progress)
            self.progress.update(iterations, moving=len(result.dynamic))
        result.dynamic.check_finite(f"Group {span.index}")
        self.rig.keep_delays(self._folder(span), self.progress)
        group = Group(span.index, span.first, result.dynamic, result.dx, result.dq, result.alive, result.shade, light)
        with self._timed("encode"):
            self.progress.stage(self._title(span, "writing it for players"), 1, self.plan.moved(span.index))
            shown = importance(writer, scene.static, group, self.device)[0]
            save_group(self.work, group, shown)  # before it is published: what is in the reel is never trained again
            writer.add_group(group, shown)
            self.present(writer, span.index)
            self.progress.update(1)
        return self._hand_over(span, scene.static, group)

    def _keyframe(self, span: Span, scene: Scene, frames: np.ndarray, layout: Layout) -> Gaussians:
        """(a): the Gaussians of the keyframe. Group 0: everything; later: the dynamic points, before frozen static ones."""
        path = self._folder(span) / "keyframe.safetensors"
        if path.exists():
            arrays = checkpoint.load_arrays(path)
            self.rig.load_gains(arrays)
            return checkpoint.unpack(arrays)
        with self._timed("keyframe"):
            config, first = self.config.keyframe, span.index == 0
            iterations = config.first_iterations if first else config.refine_iterations
            if not first and len(scene.dynamic) == 0:
                return scene.dynamic
            what = "building the scene at its first frame" if first else "refining what moves at its first frame"
            self.progress.stage(self._title(span, what), iterations, self.plan.keyframe(span.index))
            self.rig.gains.restart()
            images = temporal_mean(frames) if config.temporal_mean else frames[0]
            trainer = self._keyframe_trainer(scene, layout, first)
            coarse_share = config.coarse_share if first else 0.0
            cameras, antialias = self.rig.cameras, self.config.antialias
            train_frame(trainer, cameras, images, layout, iterations, coarse_share, antialias, self.progress)
            points = trainer.points.gaussians()
        points.check_finite(f"Keyframe {span.index}")
        checkpoint.save_arrays(path, checkpoint.pack(points) | self.rig.packed_gains())
        return points

    def _keyframe_trainer(self, scene: Scene, layout: Layout, first: bool) -> KeyframeTrainer:
        if first:
            seeds = checkpoint.load_arrays(self.work / "points.safetensors")
            return first_keyframe_trainer(
                seeds["points"], seeds["colors"], layout, self.rig.cameras, self.rig.gains, self.config
            )
        rates = default_rates(layout.unit, self.config.keyframe.rate_scale)
        points = TrainablePoints.from_gaussians(scene.dynamic, rates, self.device)
        return KeyframeTrainer(
            points,
            self.rig.gains,
            self.config.keyframe,
            static=scene.static[scene.alive],
            max_points=len(points) + max(1000, len(points) // 3),
            seed=self.config.seed,
        )

    def _layer(self, span: Span, scene: Scene, frames: np.ndarray, layout: Layout) -> Layers:
        """(b): label all living points by their motion in this group."""
        with self._timed("layering"):
            self.progress.stage(
                self._title(span, "telling what moves from what rests"), 1, self.plan.layering(span.index)
            )
            everything = Gaussians.concatenate([scene.dynamic, scene.static[scene.alive]])
            moves = label_points(everything, self.rig.cameras, frames, layout.near, self.config.layering, self.device)
            if span.index:
                moves[: len(scene.dynamic)] |= crowding(scene.dynamic.means, self.rig.cameras, layout.clearance)
            light = np.zeros((span.count, len(everything)), np.float32)
            if self.config.layering.relighting:
                still = everything[~moves]
                light[:, ~moves] = changes_of_light(still, self.rig.cameras, frames, layout.near, self.device)
            layers = separate(scene.static, scene.alive, scene.dynamic, moves, light)
            static = len(layers.settled) + int(layers.alive.sum())
            lit = {"lit": len(layers.lit)} if len(layers.lit) else {}
            self.progress.update(1, moving=len(layers.dynamic), resting=static, **lit)
        return layers

    def _settle(self, span: Span, scene: Scene, layers: Layers, writer: ReelWriter) -> Scene:
        """Store the new static points as a layer, and go on with what a reader of the reel will see of them (closed loop)."""
        if len(layers.settled) == 0:
            return replace(scene, alive=layers.alive, dynamic=layers.dynamic)
        with self._timed("encode"):
            self.progress.stage(self._title(span, "writing what rests"), 1, self.plan.layered(span.index))
            seen = Gaussians.concatenate(
                [layers.settled, layers.dynamic, layers.lit.points, scene.static[layers.alive]]
            )
            near, antialias = writer.manifest.near, self.config.antialias
            shows = weigh([seen], self.rig.cameras, near, self.device, antialias)[: len(layers.settled)]
            decoded, order = writer.add_layer(span.index, span.first, layers.settled, shows)
            self.progress.update(1, points=len(decoded))
        raw = layers.settled[order]
        arrays = checkpoint.pack(raw, "raw_") | checkpoint.pack(decoded, "decoded_") | {"importance": shows[order]}
        checkpoint.save_arrays(self._folder(span) / "layer.safetensors", arrays)
        alive = np.concatenate([layers.alive, np.ones(len(decoded), bool)])
        static = Gaussians.concatenate([scene.static, decoded])
        return replace(scene, static=static, alive=alive, dynamic=layers.dynamic)

    def _follow(self, span: Span, scene: Scene, lit: RelitPoints, frames: np.ndarray, layout: Layout) -> Start:
        """Tracks of the dynamic points, to start their deformation from, and new points for what appears."""
        if not self.config.group.tracks or span.count < 2:
            return Start(Gaussians.concatenate([scene.dynamic, lit.points]))
        with self._timed("tracking"):
            self.progress.stage(self._title(span, "following what moves"), span.count, self.plan.tracking(span.index))
            gains = self.rig.packed_gains()["gains"]
            static, flow = scene.static[scene.alive], make_flow(self.config.layering.flow)
            motion = scene.momentum and scene.momentum.at(scene.dynamic.means, layout.unit)
            start = follow(
                scene.dynamic,
                motion,
                lit,
                static,
                self.rig.cameras,
                frames,
                gains,
                flow,
                layout.near,
                partial(render_image, near=layout.near, antialias=self.config.antialias, background=layout.background),
                self.progress,
            )
            new = len(start.dynamic) - len(scene.dynamic) - len(lit)
            self.progress.update(span.count, moving=len(start.dynamic), appeared=new)
        return start

    def _convertible(self, scene: Scene, frames: np.ndarray, layout: Layout) -> np.ndarray:
        """[S] bool: the static points that adaptive conversion may make dynamic."""
        least, allowed = self.config.layering.adapt_changed_share, scene.alive.copy()
        if least:
            living = scene.static[scene.alive]
            allowed[scene.alive] = convertible(living, self.rig.cameras, frames, layout.near, least, self.device)
        return allowed

    def _hand_over(self, span: Span, static: Gaussians, group: Group) -> Scene:
        """The scene at the next keyframe: the dynamic points, deformed there (paper section 4)."""
        return Scene(static, group.alive, group.at(span.own), VelocityPrior.of(group, span.own))

    def _restore(self, span: Span, scene: Scene, publisher: Publisher) -> Scene:
        """The scene after a finished group, from the checkpoints and the scene before; the reel gets what it lacks."""
        if span.index < len(publisher.writer.manifest.groups):
            publisher.skip(span.index)
        else:
            with self._timed("encode"):
                publisher.publish(span.index)
        born = load_layer(self.work, span.index, "decoded")
        static = scene.static if born is None else Gaussians.concatenate([scene.static, born])
        self.rig.restore(span.own, self._folder(span))
        return self._hand_over(span, static, load_group(self.work, span.index))

    def _lay_out(self) -> Layout:
        """Initial points and the measures of the scene, from the first frame."""
        path = self.work / "layout.json"
        if path.exists() and (self.work / "points.safetensors").exists():
            self.rig.stand(group_folder(self.work, 0))
            return Layout.from_dict(checkpoint.load_json(path))
        with self._timed("points"):
            self.progress.stage("reading the first frame, checking the cameras", 1, (0.0, 0.0))
            capture, middle = self.capture, self.spans[0].count // 2
            frames = np.concatenate([capture.read(frame, 1, self.rig.names) for frame in (0, middle)])
            check_pictures(capture, self.rig.names, frames)
            for doubt in capture.doubts:
                self.progress.note(doubt)
            frames = self.rig.gather(frames, group_folder(self.work, 0), self.progress, str(capture.origin))
            known = capture.points, capture.point_colors, capture.near
            self.progress.update(1)
            coverage = self._cover(frames[0]) if self.config.check_coverage else None
            self.progress.stage("finding where the scene's surfaces are", 1, self.plan.points())
            seeds, layout = lay_out(self.rig.cameras, frames[0], self.config, *known)
            self.progress.update(1, points=len(seeds.points))
        self.claim.keep()
        if coverage is not None:
            save_coverage(self.work, coverage)
        checkpoint.save_arrays(self.work / "points.safetensors", {"points": seeds.points, "colors": seeds.colors})
        checkpoint.save_json(path, layout.to_dict())
        return layout

    def _cover(self, images: np.ndarray) -> Coverage:
        """What to expect of new views, told before it is trained. images: [C, H, W, 3] uint8, of the first frame."""
        capture = self.capture
        known = {"points": capture.points, "point_colors": capture.point_colors, "near": capture.near}
        found = cover(self.rig.cameras, images, **known, device=self.device, progress=self.progress)
        for sentence in found.sentences():
            self.progress.note(sentence)
        return found

    def _open_reel(self, layout: Layout) -> ReelWriter:
        points = checkpoint.load_arrays(self.work / "points.safetensors")["points"]
        coverage = load_coverage(self.work)
        header = header_of(self.rig.cameras, self.capture.fps, self.config, layout, points, coverage)
        save_header(self.work, header)
        save_sound(self.work, self.sound)
        return open_writer(self.work, self.reel, self.config.encode, resume=True)

    def _on_device(self, frames: np.ndarray) -> torch.Tensor:
        if self.device.type == "cuda":
            check_room(frames.nbytes, torch.cuda.mem_get_info(self.device)[0], frames.shape[3])
        return torch.from_numpy(frames).to(self.device)

    def _views(self, layout: Layout) -> list[View]:
        return [View.of(camera, self.device, self.config.antialias, layout) for camera in self.rig.cameras]

    def _folder(self, span: Span) -> Path:
        return group_folder(self.work, span.index)

    def _title(self, span: Span, what: str) -> str:
        return f"group {span.index + 1}/{len(self.spans)}: {what}"

    def _load_seconds(self) -> dict[str, float]:
        path = self.work / "seconds.json"
        return checkpoint.load_json(path) if path.exists() else {}

    @contextmanager
    def _timed(self, stage: str):
        start = time.monotonic()
        yield
        self.seconds[stage] = round(self.seconds.get(stage, 0.0) + time.monotonic() - start, 3)
        checkpoint.save_json(self.work / "seconds.json", self.seconds)
