"""`splatreel reconstruct`."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from splatreel.cli.following import Following
from splatreel.cli.machines import Machines
from splatreel.cli.options import CaptureAddress, Set, parse_frames, parse_held_out, parse_renditions, with_set
from splatreel.cli.output import say
from splatreel.cli.publish import publishing
from splatreel.cli.words import Words
from splatreel.config import Config, Quality, Rate, preset
from splatreel.errors import UsageError
from splatreel.threads import use as use_threads

Device = Literal["auto", "cpu", "cuda"]
Codec = Literal["predictive", "h265"]
Deformation = Literal["trajectory", "hashgrid"]


def reconstruct(
    capture: CaptureAddress,
    /,
    out: Annotated[str, arg(metavar="PATH")],
    width: int | None = None,
    scale: float | None = None,
    frames: str | None = None,
    hold_out: str | None = None,
    sound: str = "auto",
    quality: Quality = "standard",
    device: Device = "auto",
    codec: Codec | None = None,
    renditions: str | None = None,
    deformation: Deformation | None = None,
    seed: int = 0,
    settings: Set = (),
    threads: int | None = None,
    estimate: bool = False,
    profile: bool = False,
    publish: str | None = None,
    publish_keep: float = 24.0,
    machines: OmitArgPrefixes[Machines] = Machines(),  # noqa: B008 - it is frozen
    following: OmitArgPrefixes[Following] = Following(),  # noqa: B008 - it is frozen
    words: OmitArgPrefixes[Words] = Words(),  # noqa: B008 - it is frozen
) -> None:
    """Make a reel of a capture. Interrupt it at will: the same command continues.

    Args:
        capture: Folder of the videos or images and their cameras, or an address of it, such as s3://BUCKET/CAPTURE.
        out: OUT/reel becomes the reel, playable while it grows; OUT/work holds the checkpoints. With --cluster also s3:// and others.
        width: Width of the images to train on, in pixels; their own by default.
        scale: Size of the images to train on, as a share of their own, instead of the width.
        frames: Which frames, as A:B (B is left out); all by default.
        hold_out: Names of cameras to keep for evaluation, as NAME,NAME; none: all are trained on; what the format says by default.
        sound: A camera's name; a file of sound or video that begins with the capture; auto: the camera loudest undistorted; none.
        quality: How long to train.
        device: Where to train; auto takes a CUDA GPU if there is one.
        codec: How points are coded; what the quality says by default.
        renditions: Rates, such as high,medium,low, that all groups are written in for a player to choose from.
        deformation: How points move; what the quality says by default.
        seed: Seed of everything random.
        settings: Any setting that `splatreel config` lists, such as group.lambda_arap=0; as often as you like.
        threads: How many threads to use; as many as there are cores by default.
        estimate: Only say how long it would take, and how much memory. Nothing is written.
        profile: Measure where the time goes, and write it to OUT/profile.md.
        publish: Copy the reel there while it grows, such as to s3://BUCKET/REEL, as `splatreel publish` does.
        publish_keep: Hours that files stay there after they are no part of the reel any more.
    """
    use_threads(threads)
    span, held_out = parse_frames(frames), parse_held_out(hold_out)
    config = with_set(configure(quality, codec, deformation, seed), settings)
    config = with_renditions(config, parse_renditions(renditions))
    following.check()
    machines.check(out, follow=following.follow, estimate=estimate)
    from splatreel.capture.opening import CaptureSource
    from splatreel.evaluation.profile import profiled
    from splatreel.kernels.warmup import background_warmup
    from splatreel.play.presentation_writer import PresentationWriter
    from splatreel.progress import console

    source = CaptureSource(capture, {"width": width, "scale": scale, "frames": span, "held_out": held_out})
    if estimate:
        return say(machines.estimated(source, config, sound, device))
    progress, presents = console(), PresentationWriter(words.given())
    try:
        with machines.folder(out) as folder:
            url = machines.published(out, publish)
            with (
                background_warmup(progress),
                profiled(folder / "profile.md" if profile else None),
                publishing(folder / "reel", url, publish_keep, progress, presents) as present,
            ):
                output = {"sound": sound, "device": device, "progress": progress, "present": present}
                if following.follow:
                    done = following.reconstruct(capture, folder, config, source.request, output)
                else:
                    done = machines.reconstruct(source, folder, config, out, output)
    finally:
        progress.close()
    say(done)


def with_renditions(config: Config, renditions: tuple[Rate, ...]) -> Config:
    """Raises `UsageError` where the codec has none."""
    renditions = renditions or config.encode.renditions
    if renditions and config.encode.codec != "predictive":
        raise UsageError("--renditions are of the predictive codec. Choose --codec predictive.")
    return dataclasses.replace(config, encode=dataclasses.replace(config.encode, renditions=renditions))


def configure(quality: Quality, codec: Codec | None, deformation: Deformation | None, seed: int) -> Config:
    """The preset of a quality with what the command line changes. Raises `UsageError` for a seed that is none."""
    if not 0 <= seed < 1 << 32:
        raise UsageError(f"--seed {seed} is out of range. Choose a whole number from 0 to {(1 << 32) - 1}.")
    config = dataclasses.replace(preset(quality), seed=seed)
    if codec is not None:
        config = dataclasses.replace(config, encode=dataclasses.replace(config.encode, codec=codec))
    if deformation is not None:
        config = dataclasses.replace(config, group=dataclasses.replace(config.group, deformation=deformation))
    return config
