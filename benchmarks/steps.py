"""Bytes against held-out quality of a finished run's first group: with the usual steps, its own, and steps chosen anew.

Nothing is trained: the layer and the group are encoded again from their checkpoints, which may be of an earlier version.

python benchmarks/steps.py RUN CAPTURE --name kitchen
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import tyro

from bench.rate_distortion import bd_rate
from record import record
from splatreel.capture.base import Capture
from splatreel.codec import group_file
from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.evaluation.metrics import psnr, ssim
from splatreel.evaluation.reel_capture import open_reel_capture
from splatreel.method.cameras.exposure import remove_exposure
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.step_choice import encode_group_by_slope, encode_layer_by_slope
from splatreel.method.prediction.quality import Coverage
from splatreel.play.timeline import Moment, Part, Timeline
from splatreel.run.steps import EXPOSURE, KEYFRAME
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan

COARSENESS = EncodeConfig().coarseness
FACTORS = 0.7, 1.0, 1.5, 2.2, 3.3


class FirstGroup:
    """The first group of a run and its layer, before encoding, with the images of the held-out cameras at some frames."""

    def __init__(self, run: Path, capture: Capture, cameras: list[str], moments: int) -> None:
        reader = ReelReader(run / "reel")
        self.store = Store(run / "work")
        self.manifest = reader.manifest
        self.render = Timeline(reader).render
        self.capture = capture
        self.work = self.store.group(0)
        layer = self.work.layer()
        if layer is None:
            raise SystemExit(f"{run}: its first group has no static points.")
        self.stored = self.work.group()
        self.layer = layer
        self.frames = np.linspace(0, self.stored.group.frames - 1, moments).round().astype(int).tolist()
        self.views = [camera for camera in capture.cameras if camera.name in cameras]
        names = [view.name for view in self.views]
        self.truths = [capture.read(frame, 1, names)[0].astype(np.float32) / 255 for frame in self.frames]

    def choose(self) -> tuple[Steps, Steps]:
        """Return the steps of the layer and of the group that this revision chooses."""
        names, group = [camera.name for camera in self.manifest.cameras], self.stored.group
        images = np.ascontiguousarray(self.capture.read(0, group.frames, names))
        if (exposure := EXPOSURE.load(self.work)) is not None:
            remove_exposure(images, exposure)
        span, keyframe = GroupSpan(0, 0, group.frames, group.frames), KEYFRAME.load(self.work)
        layout, antialias = self.store.layout(), self.manifest.antialias
        if keyframe is None or layout is None or self.layer.importance is None or self.stored.importance is None:
            raise SystemExit("The run lacks a keyframe, a layout or measured importances.")
        rig = replace(Rig.of(list(self.manifest.cameras)), gains=keyframe.gains)
        data = GroupInput(span, images, rig, group.light, layout, 0, antialias)
        coverage: Coverage | None = self.store.coverage()
        trial, encoder = coverage and coverage.trial, ReelEncoder(EncodeConfig())
        points, moving = self.layer.trained, group.at(0.0)
        importance = self.layer.importance, self.stored.importance
        layer = encode_layer_by_slope(encoder, data, points, moving, len(moving), importance[0], trial)[1]
        return layer, encode_group_by_slope(
            encoder, data, group, StaticPoints(points, group.alive), importance[1], trial
        )[1]

    def measure(self, layer: Steps, group: Steps, factor: float) -> dict:
        """Encode, decode and compare with the held-out cameras. factor: on all steps."""
        config = EncodeConfig(coarseness=COARSENESS * factor)
        still, order = group_file.encode_layer(0, 0, self.layer.trained, config, self.layer.importance, layer)
        moving, _ = group_file.encode_group(self.stored.group, config, self.stored.importance, group)
        points = group_file.decode_layer(still, "layer")[1][np.argsort(order)]
        sizes = {"bytes": len(still) + len(moving), "layer_bytes": len(still), "group_bytes": len(moving)}
        return {"factor": factor, **sizes, **self.score(points, group_file.decode_group(moving, "group"))}

    def score(self, points: Gaussians, group: Group) -> dict:
        """Return the mean PSNR and SSIM over all held-out images."""
        pairs = list(self._images(points, group))
        return {
            name: round(float(np.mean([measure(*pair) for pair in pairs])), 4)
            for name, measure in (("psnr", psnr), ("ssim", ssim))
        }

    def _images(self, points: Gaussians, group: Group) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for frame, truths in zip(self.frames, self.truths, strict=True):
            shown = ((points[group.alive], True), (group.at(float(frame)), False))
            parts = [Part(each, still, np.arange(len(each))) for each, still in shown]
            moment = Moment.join(parts, group.light_at(float(frame)))
            for view, truth in zip(self.views, truths, strict=True):
                yield np.clip(self.render(moment, view), 0, 1), truth


def main(
    run: tyro.conf.Positional[Path],
    capture: tyro.conf.Positional[Path],
    /,
    name: str,
    frames: int | None = None,
    cameras: str | None = None,
    moments: int = 7,
    note: str = "",
) -> None:
    """Measure and record. frames: of the capture, that the run was made from. cameras: names, by default the held-out ones."""
    span = None if frames is None else (0, frames)
    names = cameras.split(",") if cameras else None
    source, _ = open_reel_capture(run / "reel", capture, frames=span, names=names)
    found = FirstGroup(run, source, names or list(source.held_out), moments)
    before = found.score(found.layer.trained, found.stored.group)
    stored, chosen = (found.layer.steps, found.stored.steps), found.choose()
    curves = {
        name: [found.measure(*steps, factor) for factor in FACTORS]
        for name, steps in {"usual_steps": (STEPS, STEPS), "stored_steps": stored, "chosen_steps": chosen}.items()
    }
    rates = {name: [(row["bytes"], row["psnr"]) for row in rows] for name, rows in curves.items()}
    bd_rates = {
        f"bd_rate_to_{name}": bd_rate(rates[f"{name}_steps"], rates["chosen_steps"]) for name in ("usual", "stored")
    }
    factors = [{key: round(value / asdict(STEPS)[key], 2) for key, value in asdict(steps).items()} for steps in chosen]
    values = {"before_encoding": before, **curves, **bd_rates, "factors": factors}
    print(values)
    record(f"steps {name}", values, note)


if __name__ == "__main__":
    tyro.cli(main)
