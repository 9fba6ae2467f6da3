"""From an address to the folder that it names."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from splatreel.errors import UsageError
from splatreel.storage.folder import Folder, LocalFolder
from splatreel.storage.remote_folder import RemoteFolder

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://", re.ASCII)


def is_url(text: str) -> bool:
    """Whether text is an address rather than a path: `s3://bucket/reel`, but not `C:\\reel`."""
    return _URL.match(text) is not None


def local_path(address: str | Path) -> Path | None:
    """The path that an address names on this machine; None if it is elsewhere. Raises `UsageError` for `file://HOST/...`."""
    text = str(address)
    if not is_url(text):
        return Path(address)
    split = urlsplit(text)
    if split.scheme.lower() != "file":
        return None
    if split.netloc not in ("", "localhost"):
        raise UsageError(
            f"{text}: is on the host {split.netloc}. Write file:///PATH, with three slashes, for a path here."
        )
    return Path(url2pathname(split.path))


def open_folder(address: str | Path) -> Folder:
    """The folder at a path, or at a URL of any protocol that fsspec knows. Nothing is read yet.

    Raises `UsageError` for an address that is none or that nobody can write to, `MissingDependencyError` where a package is missing.
    """
    path = local_path(address)
    if path is not None:
        return LocalFolder(path)
    if str(address).lower().startswith(("http://", "https://")):
        raise UsageError(
            f"{address}: web servers take no files. Give the address of the bucket, such as s3://BUCKET/REEL."
        )
    return RemoteFolder(str(address))
