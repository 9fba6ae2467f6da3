"""A long video: does it finish, in constant time a group, without drift, with a small manifest?

python benchmarks/long.py --frames 6000

The toy room for five seconds, played forth and back; meanwhile the light changes slowly, and the globe, the plane and the train come
and go for half a minute or so at a time. What is measured in the last minute is compared with the first one.
"""

import resource
import time
from pathlib import Path

import numpy as np
import tyro

from record import record
from splatreel.capture.base import Capture
from splatreel.capture.builtin import toyroom
from splatreel.capture.builtin.raytracer import trace_frame, trace_static
from splatreel.capture.builtin.solids import POSITION, Shapes
from splatreel.capture.builtin.synthetic import NEAR, make_cameras
from splatreel.cli.main import keep_freed_memory
from splatreel.cli.options import with_set
from splatreel.codec.reader import ReelReader
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.evaluate import evaluate
from splatreel.play.presentation_writer import PresentationWriter
from splatreel.progress import console
from splatreel.recon.pipeline import reconstruct
from splatreel.recon.run.store import Store

FPS = 30
NOISE = 1.5
"""Gray levels, standard deviation, of the pictures' noise: without any, nothing would be like a video."""
LIGHT, LIGHT_SHARE = 0.8, 0.2
"""The light on average, so that no picture is too bright; how much brighter and darker it gets."""
LOOP = 5 * FPS
"""Frames that are traced, of each choice of things that are there."""
MINUTE = 60 * FPS
LIGHT_ROUNDS = 2
VISITS = ((2, 0.7, slice(0, 1)), (3, 0.5, slice(2, None)))
"""The globe; the plane with the train. How often each comes until the last minute begins, as the light goes up and down: that minute
shows what the first one did, so that they can be compared. The share of the time for which each is there, and its solids."""
QUICK = ("keyframe.refine_iterations=100", "group.iterations_per_frame=6")
"""Settings below `draft`, so that 200 groups take an hour on two cores: what is asked is whether the end is as the start."""
CAMERAS = ("cam03", "cam04", "cam05", "cam06", "cam07", "cam08")


def visible(elapsed: float) -> tuple[bool, ...]:
    """Which of the visitors are there. elapsed: of the time until the last minute begins."""
    return tuple((elapsed * rounds) % 1.0 < share for rounds, share, _ in VISITS)


def without(shapes: Shapes, there: tuple[bool, ...]) -> Shapes:
    """What moves; what is away is far below the floor."""
    solids = shapes.solids.copy()
    for here, (_, _, rows) in zip(there, VISITS, strict=True):
        if not here:
            solids[rows, POSITION + 1] -= 50
    return shapes._replace(solids=solids)


class LongFilm(Capture):
    """The toy room by six cameras, one of them held out; every picture is traced when it is read for the first time."""

    def __init__(self, frames: int, width: int, height: int) -> None:
        every = make_cameras(width, height)
        cameras = [camera for camera in every if camera.name in CAMERAS]
        self._still = toyroom.standing(0)
        self._seen = {camera.name: trace_static(camera, self._still, toyroom.LIGHT) for camera in cameras}
        self._traced: dict[tuple[str, tuple[bool, ...], int], np.ndarray] = {}
        self._repeats = max(frames - MINUTE, MINUTE)
        super().__init__(Path("long film"), cameras, held_out=["cam07"], frame_range=(0, frames), fps=FPS, near=NEAR)

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        for place in range(len(out)):
            frame = first + place
            elapsed, at = frame / self._repeats, abs((frame + LOOP) % (2 * LOOP) - LOOP)
            light = LIGHT * (1 + LIGHT_SHARE * np.sin(2 * np.pi * LIGHT_ROUNDS * elapsed))
            for c, name in enumerate(cameras):
                rng = np.random.default_rng([frame, int(name.removeprefix("cam"))])
                picture = self._picture(name, visible(elapsed), at)
                out[place, c] = np.rint(picture * light + rng.normal(0, NOISE, picture.shape)).clip(0, 255)

    def _picture(self, name: str, there: tuple[bool, ...], at: int) -> np.ndarray:
        """Traced once, and kept."""
        if (name, there, at) not in self._traced:
            shapes = without(toyroom.moving(at / FPS), there)
            light = toyroom.LIGHT
            self._traced[name, there, at] = trace_frame(self.camera(name), self._seen[name], self._still, shapes, light)
        return self._traced[name, there, at]


def seconds_of_groups(store: Store, groups: int) -> np.ndarray:
    """[G] seconds between a group's checkpoint and the one before; NaN for the first of each chapter."""
    ends = np.array([store.group(i).folder.joinpath("group.safetensors").stat().st_mtime for i in range(groups)])
    seconds = np.diff(ends, prepend=np.nan)
    seconds[list(store.chapter_firsts() or [0])] = np.nan
    return seconds


def middle(values: np.ndarray) -> float | None:
    """The median of those that are known."""
    known = values[~np.isnan(values)]
    return round(float(np.median(known)), 2) if len(known) else None


def main(
    frames: int = 6000,
    width: int = 160,
    height: int = 90,
    quality: Quality = "draft",
    settings: tuple[str, ...] = QUICK,
    chapter_frames: int = 300,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Film, reconstruct, evaluate, compare the end with the beginning, record. settings: as `--set` of splatreel reconstruct."""
    keep_freed_memory()
    out = out or Path(f"out/benchmark-long-{frames}")
    config = with_set(changed(preset(quality), {"chapter_frames": chapter_frames}), settings)
    capture = LongFilm(frames, width, height)
    progress, started = console(), time.monotonic()
    try:
        result = reconstruct(capture, out, config, progress=progress, present=PresentationWriter())
        wall = time.monotonic() - started
        report = evaluate(
            result.reel, capture, out=out, seconds=result.seconds, device=result.device, progress=progress
        )
    finally:
        progress.close()
    manifest = ReelReader(result.reel).manifest
    groups = len(manifest.groups)
    seconds = seconds_of_groups(Store(result.work), groups)
    psnr = np.array([frame["psnr"] for frame in report.per_frame])
    tenth = max(groups // 10, 1)
    values = {
        "frames": frames,
        "groups": groups,
        "chapters": len(Store(result.work).chapter_firsts() or [0]),
        "psnr": report.psnr,
        "psnr_first_minute": float(psnr[:MINUTE].mean()),
        "psnr_last_minute": float(psnr[-MINUTE:].mean()),
        "seconds_of_a_group_first_tenth": middle(seconds[:tenth]),
        "seconds_of_a_group_last_tenth": middle(seconds[-tenth:]),
        "static_points_first_group": manifest.static_points(0),
        "static_points_last_group": manifest.static_points(groups - 1),
        "manifest_bytes": (result.reel / "manifest.json").stat().st_size,
        "reel_bytes": report.reel_bytes,
        "seconds": result.seconds,
        "seconds_wall": round(wall, 1),
        "seconds_a_frame": round(sum(result.seconds.values()) / frames, 3),
        "peak_memory_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        "settings": [f"chapter_frames={chapter_frames}", *settings],
    }
    print(record("long", values, note))


if __name__ == "__main__":
    tyro.cli(main)
