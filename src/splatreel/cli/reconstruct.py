"""`splatreel reconstruct`."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.threads import use as use_threads
from splatreel.cli.capture_masks import AUTO, is_complete, make_masks
from splatreel.cli.machine_options import MachineOptions
from splatreel.cli.options import (
    CaptureAddress,
    CaptureOptions,
    ReelTexts,
    Set,
    check_effect,
    parse_renditions,
    parse_set,
    with_set,
)
from splatreel.cli.printing import playable, say
from splatreel.cli.publish import publishing
from splatreel.config import Codec, Config, Deformation, Quality, Rate, preset
from splatreel.config.settings import changed
from splatreel.storage.address import local_path, without_secrets

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
    from splatreel.capture.opening import CaptureSource
    from splatreel.run.output.group_writer import PresentationHook
    from splatreel.run.pipeline import RunSpec


Device = Literal["auto", "cpu", "gpu", "cuda"]


@dataclass(frozen=True)
class ConfigOptions:
    """Settings of the reconstruction."""

    quality: Quality = "standard"
    """Preset of settings; it decides how long training takes."""
    codec: Codec | None = None
    """Codec of the points; by default that of the quality."""
    renditions: str | None = None
    """Rates, such as high,medium,low, that all groups are written in for a player to choose from."""
    deformation: Deformation | None = None
    """Model of motion; by default that of the quality."""
    seed: int = 0
    """Seed of all random numbers."""
    settings: Set = ()
    """Any setting that `splatreel config` lists, such as group.lambda_arap=0; may be repeated."""

    def config(self, is_begun: bool = False) -> Config:
        """Return the settings.

        Args:
            is_begun: A run with these settings continues. Settings without effect, which earlier versions took, are then allowed.

        Raises:
            UsageError: A value is not possible, or a setting has no effect.
        """
        config = with_set(configure(self.quality, self.codec, self.deformation, self.seed), self.settings)
        config = with_renditions(config, parse_renditions(self.renditions))
        if not is_begun:
            check_effect(config, {name: f"--set {name}" for name in parse_set(self.settings)})
        return config


@dataclass(frozen=True)
class SubjectOptions:
    """Part of the scene to make a reel of. Players show the page behind it."""

    masks: Annotated[str | None, arg(metavar="PATH")] = None
    """Folder of masks, or its address, white where the images show the subject. It has a folder of images or a video for each
    camera, of the camera's name. Images are named or numbered as the camera's frames. auto makes them first, in OUT/masks, as
    `splatreel capture masks` does."""
    clean_plate: Annotated[Path | None, arg(metavar="PATH")] = None
    """With --masks auto: folder with an image or a video without the subject for each camera."""
    region: str | None = None
    """Volume to keep, in the coordinates of the capture, as `splatreel edit crop=` takes it: box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS,
    cylinder:x,y,z,RADIUS,HEIGHT or capture. Its surroundings are trained coarsely and left out."""

    def check(self, cluster: str | None) -> None:
        """Check that the options fit together, and to a cluster.

        Raises:
            UsageError: They do not.
        """
        if self.clean_plate is not None and self.masks != AUTO:
            raise UsageError("--clean-plate is for --masks auto. Leave it out, or add --masks auto.")
        if self.masks == AUTO and cluster is not None:
            raise UsageError(
                "--masks auto makes masks on this machine only. Run `splatreel capture masks` first, or leave out --cluster."
            )

    def find_masks(self, source: CaptureSource, folder: Path, estimate: bool) -> str | None:
        """Return the folder of the masks, if there are any. Make them if they are auto.

        Args:
            source: How to open the whole scene.
            folder: Output folder.
            estimate: True makes no masks.

        Raises:
            UsageError: Masks are needed for an estimate and are not complete.
        """
        if self.masks != AUTO:
            return self.masks
        from splatreel.capture.masks import MADE_MASKS

        masks = folder / MADE_MASKS
        if not estimate:
            make_masks(source, masks, self.clean_plate)
        elif not is_complete(masks):
            raise UsageError(
                "--estimate needs finished masks. Run `splatreel capture masks` first, and give --masks its folder."
            )
        return str(masks)


@dataclass(frozen=True)
class PublishOptions:
    """Copy of the reel in a bucket or another folder."""

    publish: str | None = None
    """Copy the reel to this address while it grows, such as s3://BUCKET/REEL, as `splatreel publish` does."""
    publish_keep: float = 24.0
    """Hours that files stay there after the reel does not need them any more."""


@dataclass(frozen=True)
class FollowOptions:
    """Reconstruction of a capture that is still being written (docs/live.md)."""

    follow: bool = False
    """The capture is still being written: show each group soon after it is filmed (docs/live.md)."""
    follow_timeout: float = 30.0
    """With --follow: seconds without a new frame after which the capture has ended."""
    when_late: Literal["wait", "draft", "skip"] = "wait"
    """With --follow, if groups take longer to make than they last. wait: make all groups, with a growing delay; draft: use quicker
    settings until the delay is gone; skip: leave out what was filmed meanwhile, so that nothing moves there."""
    keep: float | None = None
    """With --follow: seconds that the reel keeps; all by default."""

    def check(self) -> None:
        """Check that the options fit together.

        Raises:
            UsageError: They do not.
        """
        changed = [field.name for field in fields(self) if getattr(self, field.name) != field.default]
        if changed and not self.follow:
            option = changed[0].replace("_", "-")
            raise UsageError(f"--{option} is for captures that are still being written. Add --follow, or leave it out.")
        for option, seconds in (("follow-timeout", self.follow_timeout), ("keep", self.keep)):
            if seconds is not None and not 0 < seconds < math.inf:
                raise UsageError(f"--{option} {seconds:g}: give seconds, more than 0.")

    def reconstruct(self, source: CaptureSource, spec: RunSpec, progress: Progress, present: PresentationHook) -> str:
        """Reconstruct the capture while it is written, and return the closing message.

        Args:
            source: The capture and how to open it.
            spec: The run.
            progress: Display of the progress.
            present: Adds poster and thumbnails to the reel.
        """
        path = local_path(source.path)
        if path is None:
            raise UsageError(
                f"--follow: {source.path} is not a folder of this machine. Run the command on the machine that writes the capture."
            )
        from splatreel.capture.follower import Follower, open_growing
        from splatreel.capture.growth import Growth
        from splatreel.run.live.following import Live, reconstruct_following

        growth = Growth(path, self.follow_timeout)
        with (
            closing(open_growing(path, growth, progress.note, **source.request)) as capture,
            Follower(capture, growth, progress.note) as follower,
        ):
            result = reconstruct_following(
                follower,
                spec.out,
                spec.config,
                Live(self.when_late, self.keep),
                sound=spec.sound,
                device=spec.device,
                progress=progress,
                present=present,
            )
            return playable(result.reel)


def reconstruct(
    capture: CaptureAddress,
    /,
    out: Annotated[str, arg(metavar="PATH")],
    frames_and_size: OmitArgPrefixes[CaptureOptions] = CaptureOptions(),  # noqa: B008 - it is frozen
    subject: OmitArgPrefixes[SubjectOptions] = SubjectOptions(),
    sound: str = "auto",
    device: Device = "auto",
    threads: int | None = None,
    estimate: bool = False,
    configuration: OmitArgPrefixes[ConfigOptions] = ConfigOptions(),
    publication: OmitArgPrefixes[PublishOptions] = PublishOptions(),
    machines: OmitArgPrefixes[MachineOptions] = MachineOptions(),  # noqa: B008 - it is frozen
    following: OmitArgPrefixes[FollowOptions] = FollowOptions(),
    texts: OmitArgPrefixes[ReelTexts] = ReelTexts(),  # noqa: B008 - it is frozen
) -> None:
    """Reconstruct a capture into a reel. After an interruption, the same command continues.

    Args:
        capture: Folder of the videos or images and their cameras, or an address of it, such as s3://BUCKET/CAPTURE.
        out: OUT/reel gets the reel, playable while it grows; OUT/work gets the checkpoints. With --cluster also s3:// and others.
        frames_and_size: Size, frames and cameras to train on.
        subject: Part of the scene.
        sound: Soundtrack: auto, the loudest camera without distortion; the name of a camera; a sound or video file that starts with
            the capture; or none.
        device: Device that trains: gpu is any graphics card, cuda an NVIDIA card with gsplat; auto uses one if it can.
        threads: Number of threads; by default one per core.
        estimate: Only estimate time and memory. Nothing is written.
        configuration: Settings.
        publication: Copy of the reel.
        machines: Machines that make a long video.
        following: Options for a capture that is still being written.
        texts: Texts of the reel.
    """
    use_threads(threads)
    config = configuration.config(is_begun=(Path(out) / "work").is_dir())
    following.check()
    subject.check(machines.cluster)
    if subject.region is not None:
        config = changed(config, {"region": subject.region})
    if following.follow and (subject.masks is not None or config.region):
        raise UsageError("--masks and --region are for captures that are complete. Leave them out, or --follow.")
    machines.check(out, follow=following.follow, estimate=estimate)

    frames_and_size.check()
    if not estimate:
        names = (without_secrets(str(address)) for address in (capture, out))
        say(f"Reconstructing {' into '.join(names)}", flush=True)  # before the imports, which take seconds
    from splatreel.evaluation.page.report_page import ReportWriter
    from splatreel.kernels.warmup import background_warmup
    from splatreel.play.presentation_writer import PresentationWriter
    from splatreel.run.pipeline import RunSpec

    with machines.folder(out) as folder:
        source = frames_and_size.source(capture, subject.find_masks(frames_and_size.source(capture), folder, estimate))
        spec = RunSpec(source, folder, config, sound, device)
        if estimate:
            return say(machines.estimated(spec))
        presents, url = PresentationWriter(texts.given()), machines.published(out, publication.publish)
        with (
            console() as progress,
            background_warmup(progress),
            publishing(folder / "reel", url, publication.publish_keep, progress, presents) as present,
        ):
            report = ReportWriter(folder, present, progress)
            if following.follow:
                done = following.reconstruct(source, spec, progress, report)
            else:
                done = machines.reconstruct(spec, out, progress, report)
            report.finish()
    return say(done)


def with_renditions(config: Config, renditions: tuple[Rate, ...]) -> Config:
    """Return the settings with these renditions, or with their own if there are none.

    Raises:
        UsageError: The codec has no renditions.
    """
    renditions = renditions or config.encode.renditions
    if renditions and config.encode.codec != "predictive":
        raise UsageError("--renditions are of the predictive codec. Choose --codec predictive.")
    return changed(config, {"encode.renditions": renditions})


def configure(quality: Quality, codec: Codec | None, deformation: Deformation | None, seed: int) -> Config:
    """Return the preset of a quality with the changes of the command line.

    Raises:
        UsageError: The seed is out of range.
    """
    if not 0 <= seed < 1 << 32:
        raise UsageError(f"--seed {seed} is out of range. Choose a whole number from 0 to {(1 << 32) - 1}.")
    given = {"seed": seed, "encode.codec": codec, "group.deformation": deformation}
    return changed(preset(quality), {name: value for name, value in given.items() if value is not None})
