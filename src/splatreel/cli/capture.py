"""`splatreel capture check | calibrate | board | sync | convert | film`; `capture_masks.py` has `capture masks`."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from tyro.conf import Positional, arg

from splatreel.base import threads
from splatreel.base.command_line import install_command, option, quoted
from splatreel.base.display import console
from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.cli.options import (
    CaptureAddress,
    CaptureFolder,
    OutFolder,
    check_out,
    parse_frames,
    parse_held_out,
    parse_left_out,
)
from splatreel.cli.printing import already_complete, counted, say

if TYPE_CHECKING:
    import numpy as np

    from splatreel.base.progress import Progress
    from splatreel.capture.base import Capture
    from splatreel.method.prediction.quality import CaptureVerdict, Coverage
    from splatreel.scene.camera import Camera

CHUNK = 8
"""Number of frames of all cameras that are in memory at a time."""


def capture_check(
    capture: CaptureAddress,
    /,
    width: int | None = None,
    frames: str | None = None,
    hold_out: str | None = None,
    leave_out: str | None = None,
    quick: bool = False,
    page: Path | None = None,
    masks: Annotated[str | None, arg(metavar="PATH")] = None,
) -> None:
    """Read a whole capture, and report what it holds and whether it can be reconstructed.

    Fails if the poses do not fit each other or the images, if two cameras have the same pose, or if masks contradict each other.
    It does not fail for cameras so far apart that nothing confirms their poses.

    Args:
        capture: Folder or address of the videos or images and their cameras.
        width: Width of the images to read, in pixels; by default their own.
        frames: Frames A to B - 1, as A:B; by default all.
        hold_out: Names of the cameras to keep for evaluation, as `reconstruct` takes them.
        leave_out: Names of cameras that are not read at all, as NAME,NAME.
        quick: Leave out the trial that predicts the quality of novel views, which takes some seconds.
        page: HTML file to write, such as check.html: the verdict, the cameras in plan and elevation, and an image of each.
        masks: Folder of masks, or its address. The verdict is then about their subject, and the page shows them.
    """
    if page is not None:
        check_out("--page", page)
    from splatreel.capture.capture_sound import choose
    from splatreel.capture.opening import open_capture

    chosen = {
        "frames": parse_frames(frames),
        "held_out": parse_held_out(hold_out),
        "leave_out": parse_left_out(leave_out),
    }
    source = open_capture(capture, width=width, **chosen)
    with closing(source), console() as progress:
        names = [camera.name for camera in source.cameras]
        images = _read_all(source, names, progress)
        seconds = source.frames / source.fps
        sound = choose("auto", source.tracks(), seconds, source.first_frame / source.fps, source.path)
        masked = None if masks is None else _masks_of(source, masks, images, progress)
    held_out = ", ".join(source.held_out) or "none"
    points = "no sparse points" if source.points is None else f"{len(source.points):,} sparse points"
    say(f"{capture}: a capture in the layout of {source.layout}; every frame can be read")
    say(f"  {len(names)} cameras and {points}; kept for evaluation, not trained on: {held_out}")
    say(f"  {counted(source.frames, 'frame')} at {source.fps:g} a second, {source.width} x {source.height} pixels")
    say(f"  sound: {sound or 'none'}")
    said: list[str] = []
    _say_each([*source.notes, *(masked.sentences if masked else [])], said)
    alpha = None if masked is None else masked.levels
    coverage, verdict = _judge(source, names, images, alpha, quick, said) or (None, None)
    mine = {"--frames": frames, "--leave-out": leave_out}
    given = {"--width": width, **mine, "--hold-out": hold_out}
    options = _options(given | {"--masks": masks})
    command = quoted(["splatreel", "reconstruct", capture, "--out", "OUT", *options])
    with_masks = (
        quoted(["splatreel", "capture", "masks", capture, "--out", "masks", *_options(mine)]),
        quoted(["splatreel", "capture", "check", capture, *_options(given | {"--masks": "masks"})]),
    )
    unjudged = f"It can be read; nothing else was checked. Run\n  {command}"
    text = unjudged if verdict is None else verdict.text(command, with_masks)
    if page is not None:
        from splatreel.evaluation.page.check_page import CheckFacts, check_page
        from splatreel.evaluation.report import write_text

        write_text(
            page, check_page(CheckFacts(source, images[0], said, text, coverage, None if alpha is None else alpha[0]))
        )
        say(f"  page: {page}")
    if verdict is not None and verdict.faults:
        raise ReconstructionError(f"{capture}: {text}")
    say(text)


def _options(given: Mapping[str, object]) -> list[str]:
    """Return the arguments of options that are given."""
    return [part for name, value in given.items() if value is not None for part in option(name, value)]


def _moments(source: Capture) -> tuple[int, int]:
    """Return the first frame, and one in the middle, or the last one of a short capture."""
    return 0, source.frames // 2 // CHUNK * CHUNK or min(CHUNK, source.frames) - 1


def _read_all(source: Capture, names: list[str], progress: Progress) -> np.ndarray:
    """Read every frame. Return the images [M, C, H, W, 3] of the first one and of the one in the middle."""
    import numpy as np

    progress.stage("reading every frame", source.frames)
    chosen, moments = _moments(source), []
    for first in range(0, source.frames, CHUNK):
        count = min(CHUNK, source.frames - first)
        read = source.read(first, count, names)
        moments += [read[[frame - first]] for frame in chosen if first <= frame < first + count]
        progress.update(first + count)
    return np.concatenate(moments)


class _CheckedMasks(NamedTuple):
    """Masks of all cameras at the first frame and at the one in the middle, [M, C, H, W] uint8, and sentences about all masks."""

    levels: np.ndarray
    sentences: list[str]


def _masks_of(source: Capture, folder: str, images: np.ndarray, progress: Progress) -> _CheckedMasks:
    """Read the masks of all frames. `images` [M, C, H, W, 3] are of the frames of `_moments`."""
    import numpy as np

    from splatreel.capture.file_capture import FileCapture
    from splatreel.capture.mask_shares import describe_motion, describe_shares, describe_sizes, mask_shares
    from splatreel.capture.masks import MaskFiles

    assert isinstance(source, FileCapture)  # as all readers return it
    masks = MaskFiles(folder, source)
    masked = [c for c, camera in enumerate(source.cameras) if camera.name not in masks.absent]
    names, cameras = [camera.name for camera in source.cameras], [source.cameras[c] for c in masked]
    moments, shares = [], []
    progress.stage("reading every mask", source.frames)
    try:
        for frame in range(source.frames):
            read = threads.map_parallel(lambda name, at=source.first_frame + frame: masks.read(at, 1, name)[0], names)
            shares.append(mask_shares(np.stack(read)))
            moments += [np.stack(read)] * _moments(source).count(frame)
            progress.update(frame + 1)
    finally:
        masks.close()
    levels = np.stack(moments)
    chosen = [names[c] for c in masked]
    sentences = [
        *describe_shares(chosen, np.stack(shares)[:, masked], source.first_frame),
        *describe_sizes(cameras, levels[:, masked]),
        *describe_motion(chosen, images[:, masked], levels[:, masked]),
    ]
    return _CheckedMasks(levels, [*masks.notes, *sentences])


def _judge(
    source: Capture, names: list[str], frames: np.ndarray, alpha: np.ndarray | None, quick: bool, said: list[str]
) -> tuple[Coverage, CaptureVerdict] | None:
    """Report doubts about a capture, and judge it; None where packages for that are not installed.

    Args:
        source: The capture.
        names: Names of its cameras.
        frames: Images of two moments of these cameras.
        alpha: Masks [M, C, H, W] uint8 of these cameras at two moments; None judges the whole scene.
        quick: True leaves out the trial of novel views.
        said: Receives the sentences that are printed.

    Raises:
        ReconstructionError: Reconstruction would refuse the capture.
    """
    from splatreel.config import Config
    from splatreel.run.requirements import check_capture, check_images, check_memory

    check_capture(source)
    check_memory(source, Config())
    check_images(source, names, frames)
    _say_each(source.doubts, said)
    if importlib.util.find_spec("cv2") is None:
        _say_each([f"poses are not compared with the images, which needs {install_command('recon')}"], said)
        return None
    from splatreel.method.cameras.poses import inspect_poses
    from splatreel.method.prediction.quality import judge_capture

    training = [camera.name for camera in source.training_cameras]
    places = [names.index(name) for name in training]
    shown = frames[:, places]
    found = inspect_poses(source.training_cameras, shown)
    found.refuse(str(source.origin))
    _say_each([*found.repairs(training), *found.doubts(training)], said)
    kept = [number for number in range(len(training)) if number not in found.strangers]
    cameras = [found.corrected[n].camera if n in found.corrected else source.training_cameras[n] for n in kept]
    coverage = _cover(source, cameras, shown[0, kept], None if alpha is None else alpha[:, places][:, kept], quick)
    _say_each(coverage.sentences(), said)
    return coverage, judge_capture(coverage, [training[number] for number in found.doubtful])


def _say_each(sentences: Sequence[str], said: list[str]) -> None:
    """Print sentences, and append them to `said`."""
    for sentence in sentences:
        say(f"  {sentence}")
    said += sentences


def _cover(
    source: Capture, cameras: list[Camera], images: np.ndarray, alpha: np.ndarray | None, quick: bool
) -> Coverage:
    """Measure how cameras cover the scene, or a subject. Arguments: as `_judge`, images [C, H, W, 3] uint8."""
    from splatreel.method.prediction.quality import cover

    with console() as progress:
        known = {"points": source.points, "point_colors": source.point_colors, "near": source.near}
        return cover(cameras, images, **known, with_trial=not quick, progress=progress, alpha=alpha)


def capture_calibrate(
    capture: CaptureFolder,
    /,
    also: Path | None = None,
    leave_out: str | None = None,
    distance: tuple[str, str, float] | None = None,
    scale_board: str | None = None,
    same_lens: bool = False,
    board: str | None = None,
    board_videos: Path | None = None,
) -> None:
    """Find the poses and lenses of cameras by their videos or images: by COLMAP from some of the frames, or by a board.

    Writes the model sparse/0 into the folder, unless the frames contradict each other. If the videos do not start together, run
    `capture sync` first.

    Args:
        capture: Folder of the videos, one per camera, or of folders of images, one per camera.
        also: Folder of photographs by a camera that was carried from each camera's view to the next. They connect cameras far apart.
        leave_out: Names of cameras that are not read at all, as NAME,NAME.
        distance: Names of two cameras and the distance of their lenses in meters, as cam00 cam05 2.5. Then the world's unit is a meter.
        scale_board: Board that two cameras see at some time, as 5x7:0.035. Then the world's unit is a meter.
        same_lens: All cameras have the same lens and zoom. Then fewer cameras and less texture are enough.
        board: Board that is carried through the view of all cameras, as 5x7:0.035 (columns x rows of squares of that many meters).
            Then only the board is used, for cameras that share no texture. `capture board` prints one.
        board_videos: Folder of the videos that show the board, with the cameras' names; by default the videos of the capture.
    """
    from splatreel.calibration.board import parse_board

    if board is None and board_videos is not None:
        raise UsageError("--board-videos needs the board that they show, such as --board 5x7:0.035.")
    if distance is not None and scale_board is not None:
        raise UsageError("--distance and --scale-board both give the scale. Leave out one of them.")
    from splatreel.calibration.calibration_files import MODEL, calibration_record, is_made_by

    options = {"also": also, "leave_out": leave_out, "distance": distance, "scale_board": scale_board}
    options |= {"same_lens": same_lens, "board": board, "board_videos": board_videos}
    given = {name: str(value) for name, value in options.items() if value is not None and value is not False}
    record = calibration_record(capture, given, [folder for folder in (also, board_videos) if folder is not None])
    if is_made_by(capture, record):
        say(f"{capture / MODEL}: was complete already, made by the same command from the same files")
        return
    if board is not None:
        if also is not None or distance is not None or scale_board is not None or same_lens:
            raise UsageError(
                "--board gives lenses, poses and meters. Leave out --also, --distance, --scale-board and --same-lens."
            )
        _calibrate_by_board(capture, board, board_videos, leave_out, record)
        return
    from splatreel.calibration.calibrate import calibrate
    from splatreel.calibration.learned_matches import find_matcher

    matcher, scale = find_matcher(), distance if scale_board is None else parse_board(scale_board)
    with console() as progress:
        found = calibrate(capture, progress, also, parse_left_out(leave_out), matcher, scale, same_lens, record)
    agreed = f", placed alike at {found.moments} moments" if found.moments > 1 else ""
    say(f"{capture / MODEL}: {len(found.placed)} cameras{agreed}; points are off by {found.error:.2f} pixels")
    _say_each(found.notes, [])
    if found.lost:
        say(f"  left out, since they overlap the others too little to be certain: {', '.join(found.lost)}")
    if found.doubtful:
        say(f"  doubtful, since they see few points: {', '.join(f'{n} ({found.placed[n]})' for n in found.doubtful)}")


def _calibrate_by_board(
    capture: Path, spec: str, videos: Path | None, leave_out: str | None, record: dict[str, Any]
) -> None:
    """Calibrate by the sightings of a board, and report the result."""
    from splatreel.calibration.board import parse_board
    from splatreel.calibration.board_calibration import calibrate_by_board
    from splatreel.calibration.calibration_files import MODEL

    with console() as progress:
        found = calibrate_by_board(capture, parse_board(spec), progress, videos, parse_left_out(leave_out), record)
    off = max(found.errors[name] for name in found.placed)
    say(f"{capture / MODEL}: {len(found.placed)} cameras, up to {found.extent:.3g} m apart")
    say(f"  corners of the board are off by {off:.2f} pixels at most, in the median of a camera")
    say(
        f"  either half of the frames gives the same poses within {found.degrees:.2g} degrees and {1000 * found.meters:.2g} mm"
    )
    say(f"  frames with the board: {', '.join(f'{name} {count}' for name, count in found.placed.items())}")
    _say_each(found.notes, [])
    if found.lost:
        say(f"  left out, since either half of the frames places them elsewhere: {', '.join(found.lost)}")


def capture_board(file: Annotated[Positional[Path], arg(metavar="FILE")], /, board: str = "5x7:0.035") -> None:
    """Write a ChArUco board or checkerboard to print, for `capture calibrate --board`.

    Print it at 100 %, not fitted to the page, and glue it onto something flat. Larger squares are seen from further away.

    Args:
        file: File to write: .pdf, .svg or .png.
        board: Columns x rows : meters of a square; 5x7:0.035 fits A4 and 5x7:0.14 A0. A third part names another dictionary of
            OpenCV, as 5x7:0.035:5X5_100, or a board without markers, as 10x7:0.025:checkerboard.
    """
    from splatreel.calibration.board import parse_board, write_board

    check_out("FILE", file)
    made = parse_board(board)
    width, height = write_board(made, file)
    squares = f"{made.columns} x {made.rows} squares of {1000 * made.square:g} mm"
    say(f"{file}: {squares}, {1000 * width:.0f} x {1000 * height:.0f} mm with its margin")
    say("  print it at 100 %, glue it onto something flat, measure a square, and use it with that size:")
    say(f"  {quoted(['splatreel', 'capture', 'calibrate', 'CAPTURE', '--board', made.spec])}")


def capture_sync(capture: CaptureFolder, /, leave_out: str | None = None, dry_run: bool = False) -> None:
    """Find when the videos of a folder start, by sound, or else by motion, flashes or timecode. Writes splatreel.json.

    Clocks that drift get a rate. A calibrated capture whose videos are in step to half a frame is not changed.

    Args:
        capture: Folder of the videos, one per camera.
        leave_out: Names of cameras that are not read at all, as NAME,NAME.
        dry_run: Print what is found, and write nothing.
    """
    from splatreel.calibration.sync import synchronize
    from splatreel.capture.readers.colmap import unread_videos

    with console() as progress:
        found = synchronize(capture, progress, parse_left_out(leave_out), dry_run)
    file = capture / "splatreel.json"
    say(f"{file}: second of each video at which all videos have started")
    for name, start in found.starts.items():
        evidence = found.evidence.get(name)
        say(f"  {name} {start:.3f}{'' if evidence is None else f', {evidence}'}")
        if name in found.rates:
            change = found.rates[name] - 1
            say(
                f"    its clock is {100 * abs(change):.3f} % too {'fast' if change > 0 else 'slow'}, which is corrected"
            )
    _say_each([*found.notes, *unread_videos(capture)], [])
    if found.in_step:
        say(f"The videos are in step already, to half a frame. {file} was not changed.")
    elif dry_run:
        say(f"--dry-run: {file} was not changed.")


def capture_convert(
    capture: CaptureAddress,
    out: OutFolder,
    /,
    width: int | None = None,
    frames: str | None = None,
    format: Literal["jpg", "png"] = "jpg",
) -> None:
    """Write a capture as a folder that EasyVolcap, COLMAP and Splatreel read, with undistorted, synchronized images.

    Args:
        capture: Folder or address of the videos or images and their cameras.
        out: New folder.
        width: Width of the images to write, in pixels; by default their own.
        frames: Frames A to B - 1, as A:B; by default all.
        format: File format of the images. PNG keeps every pixel.
    """
    from splatreel.base.new_folder import is_taken
    from splatreel.capture.conversion import convert_capture
    from splatreel.capture.opening import open_capture

    check_out("OUT", out, capture)
    source, existed = open_capture(capture, width=width, frames=parse_frames(frames)), is_taken(out)
    with closing(source), console() as progress:
        names = convert_capture(source, out, format, progress)
    if existed:
        say(already_complete(out))
    say(f"{out}: {len(names)} cameras and {source.frames} frames of {source.width} x {source.height} pixels")
    say("  intri.yml and extri.yml of EasyVolcap, the COLMAP model sparse/0, and images/CAMERA/; sound is not copied")
    _say_each(source.notes, [])
    renamed = [f"{old} is now {new}" for old, new in names.items() if old != new]
    if renamed:
        say(f"  {', '.join(renamed)}")


def capture_film(out: OutFolder, /) -> None:
    """Write the built-in capture: a toy room that fourteen virtual cameras film, in the layout of Neu3DV.

    Args:
        out: New folder.
    """
    check_out("OUT", out)
    from splatreel.capture.builtin_film import copy_film
    from splatreel.capture.opening import open_capture

    with closing(open_capture(copy_film(out))) as film:
        size, held_out = f"{film.width} x {film.height}", ", ".join(film.held_out)
        say(f"{out}: {len(film.cameras)} cameras and {film.frames} frames of {size} pixels, with sound")
    say(f"  kept for evaluation, not trained on: {held_out}. Run\n  {quoted(['splatreel', 'capture', 'check', out])}")
