"""`splatreel publish`, and the same while a reel is being made."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from splatreel.cli.options import reel_folder
from splatreel.cli.output import counted, say
from splatreel.errors import ReelError, UsageError

if TYPE_CHECKING:
    from splatreel.codec.publication import Published
    from splatreel.codec.writer import ReelWriter
    from splatreel.progress import Progress
    from splatreel.recon.encode.group_writer import PresentationHook
    from splatreel.storage.folder import Folder


def publish(reel: Positional[Path], url: Annotated[Positional[str], arg(metavar="URL")], /, keep: float = 24.0) -> None:
    """Copy a reel to a bucket or another folder, for web pages to play it from there.

    The same command goes on where it was cut off, sends what is new in the reel, and deletes what has not been part of it for long.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it.
        url: Where to, such as s3://BUCKET/REEL or gs://BUCKET/REEL (needs splatreel[cloud]), or a folder.
        keep: Hours that files stay there after they are no part of the reel any more: who has it open may still ask for them.
    """
    from splatreel.codec.publication import HOUR, Publication
    from splatreel.progress import console
    from splatreel.storage.retrying import RetryingFolder

    folder, hours = reel_folder(reel), checked_hours(keep, "--keep")
    there = open_target(folder, url)
    progress = console()
    try:
        published = Publication(folder, RetryingFolder(there, progress.note), hours * HOUR).update(progress)
    finally:
        progress.close()
    if published is None:
        raise ReelError(
            f"{reel}: is not a reel, it has no manifest.json. Give the folder that reconstruct or encode wrote."
        )
    say(describe(url, published))


def open_target(reel: Path, url: str) -> Folder:
    """Where a reel is to be copied. Raises `UsageError` or `MissingDependencyError` for an address that cannot be used."""
    from splatreel.storage.addresses import local_path, open_folder

    path = local_path(url)
    if path is not None and path.resolve() == reel.resolve():
        raise UsageError(f"{url}: is the reel itself. Name another folder, or a bucket.")
    return open_folder(url)


def checked_hours(hours: float, option: str) -> float:
    """Raises `UsageError` for less than none, and for what is no number."""
    if not 0 <= hours < 1e6:
        raise UsageError(f"{option} {hours:g}: give hours, 0 or more.")
    return hours


def describe(url: str, published: Published) -> str:
    """What is there, in words."""
    files = counted(published.files, "file")
    lines = [
        f"{url}: all of the reel is there, {files}, {published.bytes:,} bytes; {published.sent_bytes:,} of them were sent now"
    ]
    if published.removed:
        lines.append(f"  {counted(published.removed, 'file')} of earlier versions deleted")
    if published.live:
        lines.append("  the reel is not finished: the same command sends what is added to it")
    return "\n".join(lines)


@contextmanager
def publishing(
    reel: Path, url: str | None, keep: float, progress: Progress, present: PresentationHook
) -> Iterator[PresentationHook]:
    """While the block makes the reel, it is copied to `url` after each group, in a thread; None: it is not copied.

    Gives what `reconstruct` is to call instead of `present`. At the end of the block all that is left is sent, and said.
    Raises `UsageError` or `MissingDependencyError` for an address that cannot be used, before the block begins; `ReelError` at the end
    where not all is there.
    """
    if url is None:
        yield present
        return
    from splatreel.codec.background_publication import BackgroundPublication
    from splatreel.codec.publication import HOUR, Publication

    publication = Publication(reel, open_target(reel, url), checked_hours(keep, "--publish-keep") * HOUR)
    background = BackgroundPublication(publication, progress.note)

    def present_and_publish(writer: ReelWriter, group: int | None) -> None:
        present(writer, group)
        background.changed()

    try:
        yield present_and_publish
        progress.stage(f"sending what is left to {url}", 1)
        published = background.finish()
        progress.update(1)
    except BaseException as error:
        background.stop()
        if error is not background.failure:
            raise
        again = shlex.join(["splatreel", "publish", str(reel), url])
        raise ReelError(
            f"{error}\nThe reel is whole in {reel}, but not at {url}. To send what is missing there, run\n  {again}"
        ) from error
    if published is not None:
        progress.note(describe(url, published))
