"""Conversion of paths and URLs to folders."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from splatreel.base.errors import UsageError
from splatreel.storage.folder import Folder, LocalFolder
from splatreel.storage.remote_folder import RemoteFolder

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://", re.ASCII)


def is_url(text: str) -> bool:
    """Return whether text is a URL such as `s3://bucket/reel`, and not a path with a Windows drive letter."""
    return _URL.match(text) is not None


def local_path(address: str | Path) -> Path | None:
    """Return the local path of an address, or None if the address is remote.

    Raises:
        UsageError: The address is `file://HOST/...` with another host.
    """
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
    """Return the folder at a path, or at a URL of any protocol that fsspec supports. Nothing is read yet.

    Raises:
        UsageError: The address is invalid or cannot be written to.
        MissingDependencyError: A required package is not installed.
    """
    path = local_path(address)
    if path is not None:
        return LocalFolder(path)
    if str(address).lower().startswith(("http://", "https://")):
        raise UsageError(
            f"{address}: web servers take no files. Give the address of the bucket, such as s3://BUCKET/REEL."
        )
    return RemoteFolder(str(address))
