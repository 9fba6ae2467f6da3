"""`splatreel publish`, and publishing while a reel is made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from splatreel.base.command_line import quoted
from splatreel.base.display import console
from splatreel.base.errors import ReelError, UsageError
from splatreel.cli.options import ReelFolder, reel_folder
from splatreel.cli.printing import counted, say

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
    from splatreel.codec.publish import Published
    from splatreel.codec.writer import ReelWriter
    from splatreel.run.output.group_writer import PresentationHook
    from splatreel.storage.address import Address


def publish(reel: ReelFolder, url: Annotated[Positional[str], arg(metavar="URL")], /, keep: float = 24.0) -> None:
    """Copy a reel to a bucket or another folder, for web pages to play it from there.

    The same command continues an interrupted copy, sends what is new in the reel, and deletes files that the reel has not needed
    for long.

    Args:
        reel: Folder of the reel, or of the reconstruction that holds it.
        url: Destination, such as s3://BUCKET/REEL or gs://BUCKET/REEL (needs splatreel[cloud]), or a folder.
        keep: Hours that files stay there after the reel does not need them any more. Viewers that have the reel open may ask for them.
    """
    from splatreel.codec.publish import HOUR, Publication

    folder, hours = reel_folder(reel), checked_hours(keep, "--keep")
    address = open_target(folder, url)
    with console() as progress:
        published = Publication(folder, address.with_retries(progress.note), hours * HOUR).update(progress)
    if published is None:
        raise ReelError(
            f"{reel}: is not a reel, it has no manifest.json. Give the folder that reconstruct or encode wrote."
        )
    say(describe(url, published))


def open_target(reel: Path, url: str) -> Address:
    """Return the address that a reel is to be copied to.

    Raises:
        UsageError: The address cannot be used.
        MissingDependencyError: A package for it is not installed.
    """
    from splatreel.storage.address import Address

    address = Address(url, writes=True)
    if address.path is not None and address.path.resolve().is_relative_to(reel.resolve()):
        raise UsageError(f"{url}: lies in the reel itself. Name another folder, or a bucket.")
    return address


def checked_hours(hours: float, option: str) -> float:
    """Return hours that an option gives. Raises `UsageError` for a negative or undefined number."""
    if not 0 <= hours < 1e6:
        raise UsageError(f"{option} {hours:g}: give hours, 0 or more.")
    return hours


def describe(url: str, published: Published) -> str:
    """Return a description of what is published."""
    files = counted(published.files, "file")
    lines = [
        f"{url}: the whole reel is published, {files}, {published.bytes:,} bytes, of which {published.sent_bytes:,} were sent now"
    ]
    if published.removed:
        lines.append(f"  {counted(published.removed, 'file')} of earlier versions deleted")
    if published.live:
        lines.append("  the reel is not finished: run the same command again to send what is added")
    return "\n".join(lines)


@contextmanager
def publishing(
    reel: Path, url: str | None, keep: float, progress: Progress, present: PresentationHook
) -> Iterator[PresentationHook]:
    """Copy a reel after each group in a thread, while the block makes it.

    At the end of the block the rest is sent, and the result is reported.

    Args:
        reel: Folder of the reel.
        url: Destination; None copies nothing.
        keep: Hours that unneeded files stay there.
        progress: Display of the progress.
        present: Adds poster and thumbnails to the reel.

    Returns:
        The function that `reconstruct` is to call instead of `present`.

    Raises:
        UsageError: The address cannot be used.
        MissingDependencyError: A package for it is not installed.
        ReelError: Not everything could be sent.
    """
    if url is None:
        yield present
        return
    from splatreel.codec.publish import HOUR, BackgroundPublication, Publication

    publication = Publication(reel, open_target(reel, url), checked_hours(keep, "--publish-keep") * HOUR)
    background = BackgroundPublication(publication, progress.note)

    def present_and_publish(writer: ReelWriter, group: int | None) -> None:
        present(writer, group)
        background.changed()

    try:
        yield present_and_publish
        progress.stage(f"sending the rest to {url}", 1)
        published = background.finish()
        progress.update(1)
    except BaseException as error:
        background.stop()
        if error is not background.failure:
            raise
        again = quoted(["splatreel", "publish", reel, url])
        raise ReelError(
            f"{error}\nThe reel is complete in {reel}, but not at {url}. To send the rest, run\n  {again}"
        ) from error
    if published is not None:
        progress.note(describe(url, published))
