"""Safe access to members of zip archives from untrusted sources, whatever their compression."""

from __future__ import annotations

import io
import lzma
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

from splatreel.base.errors import SplatreelError

_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, NotImplementedError, RuntimeError),
    *(ValueError, TypeError, KeyError, IndexError),
)
"""Errors of `zipfile` for damaged members, by their compression, and of code that reads damaged values."""
_BLOCK, _SMALL_BLOCK = 1 << 20, 4096
"""Bytes that are unpacked at a time. `zipfile` unpacks as many packed bytes of bzip2 and LZMA without any limit."""
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextmanager
def naming_damage(
    subject: str, kind: Callable[[str], SplatreelError], what: str = "damaged", remedy: str = "Copy it again."
) -> Iterator[None]:
    """Turn whatever a damaged archive makes a parser raise into an error that starts with `subject`.

    Errors of the system, such as a full disk, are not called damage.

    Args:
        subject: Name of the file or member.
        kind: Error constructor.
        what: State of a damaged file, which follows "is" in the message.
        remedy: Last sentence of the message.
    """
    try:
        yield
    except _DAMAGE as error:
        if isinstance(error, OSError) and error.errno is not None:  # bzip2 raises OSError without a number
            raise kind(f"{subject}: cannot be read ({error.strerror}).") from error
        raise kind(f"{subject}: is {what} ({error!s:.80}). {remedy}") from error


def copy_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, target: IO[bytes]) -> None:
    """Unpack a member into an open file, in bounded memory even if it holds more than it states."""
    block = _BLOCK if info.compress_type in _BOUNDED else _SMALL_BLOCK
    with archive.open(info) as source:
        while data := source.read(block):
            target.write(data)


def read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return the content of a member, in little more memory than it states."""
    data = io.BytesIO()
    copy_member(archive, info, data)
    return data.getvalue()


def check_array_member(info: zipfile.ZipInfo, subject: str, kind: Callable[[str], SplatreelError]) -> None:
    """Refuse a member that is encrypted or of a compression that NumPy does not write."""
    if info.flag_bits & 1:
        raise kind(f"{subject} is encrypted. Save it without a password.")
    if info.compress_type not in _BOUNDED:
        raise kind(f"{subject} is in a compression that NumPy does not write. Save it with numpy.savez_compressed.")
