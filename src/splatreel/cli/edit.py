"""`splatreel edit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.cli.options import ReelAddress, ReelTexts, check_out, reel_folder
from splatreel.cli.printing import already_complete, playable, say


def edit(
    reel: ReelAddress,
    operations: Annotated[Positional[tuple[str, ...]], arg(metavar="[OPERATION...]")] = (),
    /,
    out: Path | None = None,
    list_: Annotated[Path | None, arg(name="list")] = None,
    texts: OmitArgPrefixes[ReelTexts] = ReelTexts(),  # noqa: B008 - it is frozen
) -> None:
    """Edit a finished reel without training: crop it, clean it, turn it, cut it, or change its texts.

    Operations make a new reel, in the order in which they are written; the reel itself stays. Texts alone change in place.

    Keep a person before any background: edit REEL crop=cylinder:0,0,0,2,2.5 background=transparent --out PERSON

    Remove floaters: edit REEL min-cameras=3 min-opacity=0.03 --out CLEAN

    Stand it upright, in meters: edit REEL up=y distance=cam01,cam05,1.8 floor --out METERS

    Keep some seconds, brighter: edit REEL cut=2s:5s exposure=0.5 sound=music.wav --out PART

    Args:
        reel: Folder of the reel, or its URL.
        operations: Operations, in order. Time: cut=A:B, join=REEL, reverse, fps=N. Points: crop=VOLUME, remove=VOLUME, min-cameras=N,
            min-opacity=X, max-size=X, max-distance=X, min-seconds=X. Place: rotate=AXIS,DEGREES, up=AXIS, scale=X, distance=A,B,METERS,
            move=X,Y,Z, floor, ground=CAPTURE. Colors: exposure=STOPS, gain=R,G,B, white=COLOR, background=COLOR. Sound: sound=FILE.
            docs/editing.md explains them.
        out: Folder of the new reel.
        list_: Edit list, a JSON file that the player saved. Its operations come before those of the command line.
        texts: New texts.
    """
    from splatreel.edit.operations import read_edit_list

    given = texts.given()
    wanted = [*(read_edit_list(list_) if list_ is not None else ()), *operations]
    if out is None:
        if wanted:
            raise UsageError("Operations make a new reel. Name its folder with --out.")
        _edit_texts(reel_folder(reel), given)
        return
    if not wanted and not given:
        raise UsageError("Nothing to change. Write operations, such as crop=sphere:0,0,0,2, or name a --list.")
    source = reel_folder(reel)
    check_out("--out", out, source)
    _edit_points(source, wanted, out, given)


def _edit_texts(reel: str | Path, given: dict[str, str]) -> None:
    """Change texts in place."""
    from splatreel.codec.manifest import edit_reel

    if not given:
        raise UsageError(
            "Nothing to change. Give --title, --author, --description or --license, or operations and --out."
        )
    if isinstance(reel, str):
        raise UsageError(f"{reel}: is not on this machine. Copy the reel, edit the copy, and publish it again.")
    manifest = edit_reel(reel, given)
    for name in given:
        option = "license" if name == "licence" else name
        say(f"{reel}: {option} {getattr(manifest.presentation, name) or 'removed'}")


def _edit_points(reel: str | Path, operations: list[str], out: Path, given: dict[str, str]) -> None:
    from splatreel.base.new_folder import is_taken
    from splatreel.edit.clip_writer import write_clip
    from splatreel.edit.operations import apply_operations, with_texts
    from splatreel.edit.reel_clip import ReelClip

    source = ReelClip(reel)
    clip = with_texts(apply_operations(source, operations), given)
    existed = is_taken(out)
    with console() as progress:
        progress.stage("writing the groups", len(clip.outline.groups))
        written = write_clip(clip, out, progress.update)
    if existed:
        say(already_complete(out))
    old, new = source.outline, clip.outline
    say(
        f"{reel}: {old.frames} frames, {old.seconds:.2f} s, {source.bytes / 1e6:.2f} MB. {out}: {new.frames} frames, "
        f"{new.seconds:.2f} s, {written / 1e6:.2f} MB"
    )
    say(playable(out))
