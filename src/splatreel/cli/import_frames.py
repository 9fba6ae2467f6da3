"""`splatreel import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from splatreel.cli.options import check_no_reel
from splatreel.cli.printing import playable, say
from splatreel.config import COARSENESS, EncodeConfig, Rate
from splatreel.errors import UsageError
from splatreel.threads import use as use_threads

if TYPE_CHECKING:
    from splatreel.sequence.comparison import Comparison

UP = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}


def import_frames(
    frames: Positional[Path],
    /,
    out: Path,
    fps: float = 30.0,
    cameras: Path | None = None,
    up: str | None = None,
    rate: Rate = "high",
    title: str | None = None,
    antialiased: bool = False,
    gaps: Literal["refuse", "hold"] = "refuse",
    threads: int | None = None,
) -> None:
    """Make a reel of Gaussians that another program trained: numbered PLY files, or the params.npz of Dynamic 3D Gaussians.

    Gaussians that stay the same from frame to frame are stored once. They are recognized if all files hold the same points in the same
    order, or at least the very same points where nothing moves. At the end the reel is compared with the files.

    Args:
        frames: Folder with one PLY file per frame (frame0000.ply, frame0001.ply, ...), or with params.npz.
        out: Folder of the new reel.
        fps: Frames per second.
        cameras: Cameras that the film was made from: cameras.json as 3DGS writes it, a calibration file, or the capture. The reel
            then starts at one of them, keeps viewers near them, and spends its bytes on what they see. By default a ring of cameras
            around everything is assumed.
        up: Axis that points up: x, -x, y, -y, z or -z; by default that of the cameras, or -y without cameras.
        rate: high has hardly any loss; medium and low are smaller.
        title: Title of the reel in the player.
        antialiased: The points were trained to be drawn like Mip-Splatting does, blurred by 0.1 square pixels and fainter.
        gaps: Handling of missing file numbers. refuse: make nothing; hold: show the frame before for as long.
        threads: Number of threads; by default one per core.
    """
    if not 0 < fps <= 1000:
        raise UsageError(f"--fps {fps:g}: give frames a second, more than 0 and at most 1000.")
    if up is not None and up not in UP:
        raise UsageError(f"--up {up}: choose {', '.join(UP)}.")
    use_threads(threads)
    import numpy as np

    from splatreel.codec.writer import ReelWriter
    from splatreel.play.presentation_writer import PresentationWriter
    from splatreel.progress import console
    from splatreel.recon.run.device import pick_device
    from splatreel.recon.run.run_lock import lock_reel
    from splatreel.sequence.comparison import check_seen
    from splatreel.sequence.frames import open_frames
    from splatreel.sequence.reel import header_of, write_reel
    from splatreel.sequence.viewpoints import read_cameras

    film = open_frames(frames, gaps)
    views = None if cameras is None else read_cameras(cameras)
    header, limits = header_of(film.read(0), views, None if up is None else np.array(UP[up], float), fps, antialiased)
    check_seen(
        film, list(header.cameras), header.near, antialiased, f"the cameras of {cameras}" if cameras else "the cameras"
    )
    words = {"title": title} if title else {}
    check_no_reel(out)
    progress = console()
    try:
        with lock_reel(out):
            check_no_reel(out)  # another process may have finished it meanwhile
            writer = ReelWriter(out, header, config=EncodeConfig(coarseness=COARSENESS[rate]))
            found = write_reel(
                film, writer, progress, pick_device("auto"), limits, PresentationWriter(words, {"title": frames.name})
            )
    finally:
        progress.close()
    size = sum(file.bytes for file in writer.manifest.files)
    say(
        f"{len(film)} frames in {size / 1e6:.2f} MB, {film.size / size:,.0f} times smaller than the {film.size / 1e6:,.0f} MB of "
        f"{frames}. Its images have {found.psnr:.1f} dB PSNR against those of the files (mean of {found.pictures})."
    )
    _say_doubts(found, rate)
    if views is None:
        say(
            f"A ring of cameras was assumed, with {up or '-y'} up. If that is wrong, name the cameras of the film (--cameras), "
            "or another --up."
        )
    say(playable(out))


def _say_doubts(found: Comparison, rate: Rate) -> None:
    """Name cameras that see nothing, and the cause of a visible loss."""
    from splatreel.sequence.comparison import CLOSE

    if found.blind:
        say(f"Cameras that see nothing of the film: {', '.join(found.blind)}.")
    if found.psnr < CLOSE:
        rated = f"the rate is {rate}, and --rate high loses less." if rate != "high" else "it was lost in encoding."
        say(f"Warning: below {CLOSE:.0f} dB the reel differs visibly from the film. The cause: {found.cause or rated}")
