"""Files at any address that fsspec supports: S3, Google and Azure buckets, SFTP, memory."""

from __future__ import annotations

import contextlib
import posixpath
import secrets
from typing import Any

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.storage.transport import Headers, status_of

_S3, _GOOGLE, _AZURE = ("s3", "s3a"), ("gs", "gcs"), ("az", "abfs", "abfss")
_WHOLE = (*_S3, *_GOOGLE, *_AZURE, "oss", "obs", "memory")
"""Protocols whose files appear only when complete. For other protocols a file is written under a temporary name and moved."""
_BY_PREFIX = (*_S3, *_GOOGLE)
"""Protocols that can list files by a prefix of their names."""
_PACKAGES = {**dict.fromkeys(_S3, "s3fs"), **dict.fromkeys(_GOOGLE, "gcsfs"), **dict.fromkeys(_AZURE, "adlfs")}
"""Python package that fsspec needs for each common protocol."""
_HELP = "(docs/publishing.md)."
CREDENTIALS = {
    **dict.fromkeys(_S3, f"Give credentials: `aws configure`, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY {_HELP}"),
    **dict.fromkeys(_GOOGLE, f"Give credentials: `gcloud auth application-default login` {_HELP}"),
    **dict.fromkeys(_AZURE, f"Give credentials: AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY {_HELP}"),
    **dict.fromkeys(
        ("http", "https"),
        f"Let the public read it, or give the bucket's own address with credentials, such as s3://BUCKET/REEL {_HELP} Some hosts "
        "answer so for missing files.",
    ),
    "": f"Give credentials that may access it {_HELP}",
}
"""Remedies for each protocol where access is refused."""


class Bucket:
    """Folder at a URL such as `s3://bucket/reels/one`.

    Args:
        url: Address of the folder.
        shown: The address for messages.

    Raises:
        UsageError: The address is invalid.
        MissingDependencyError: A required Python package is not installed.
        Exception: The service cannot be reached.
    """

    def __init__(self, url: str, shown: str) -> None:
        self._protocol = url.partition("://")[0].lower()
        self._files, root = _open(url, shown, self._protocol)
        self._root = root.rstrip("/")
        if not self._root.strip("/"):
            raise UsageError(
                f"{shown}: names no folder. Write the bucket as well, such as {self._protocol}://BUCKET/REEL."
            )

    def read(self, name: str, begin: int, end: int) -> bytes:
        """Return a part of a file, also from a server that ignores ranges."""
        try:
            data = self._files.cat_file(f"{self._root}/{name}", start=begin, end=end)
        except Exception as error:
            if status_of(error) != 416:
                raise
            return b""  # the file ends before `begin`
        return data if len(data) <= end - begin else data[begin:end]

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        """Create or replace a file."""
        path = f"{self._root}/{name}"
        if self._protocol in _WHOLE:
            self._files.pipe_file(path, data, **header_arguments(self._protocol, headers))
        else:
            self._move_into_place(path, data)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes of files by name."""
        folder, last = posixpath.split(prefix)
        by_prefix = {"prefix": last} if last and self._protocol in _BY_PREFIX else {}
        try:
            self._files.invalidate_cache()
            found = self._files.find(f"{self._root}/{folder}".rstrip("/"), detail=True, **by_prefix)
        except FileNotFoundError:
            return {}
        return {str(path).removeprefix(f"{self._root}/"): int(entry["size"]) for path, entry in found.items()}

    def remove(self, name: str) -> None:
        """Delete a file."""
        with contextlib.suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{name}")

    def _move_into_place(self, path: str, data: bytes) -> None:
        folder, name = posixpath.split(path)
        temporary = f"{folder}/.{name}.{secrets.token_hex(8)}.tmp"
        self._files.makedirs(folder, exist_ok=True)
        try:
            self._files.pipe_file(temporary, data)
            self._files.mv(temporary, path)
        except BaseException:
            with contextlib.suppress(Exception):
                self._files.rm_file(temporary)
            raise


def _open(url: str, shown: str, protocol: str) -> tuple[Any, str]:
    """Return fsspec's file system and the path within it."""
    package = f" {_PACKAGES[protocol]}" if protocol in _PACKAGES else ""
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{shown}: addresses of buckets need fsspec. Run\n  {install_command('cloud')}{package}"
        ) from error
    try:
        return url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        advice = f"Run\n  pip install{package}" if package else f"{error}"
        raise MissingDependencyError(f"{shown}: a Python package for {protocol}:// is missing. {advice}") from error
    except ValueError as error:
        raise UsageError(f"{shown}: is not the address of a folder ({error}). Correct it.") from error


def header_arguments(protocol: str, headers: Headers) -> dict[str, Any]:
    """Return the arguments by which `pipe_file` sets headers. Hosts of other protocols choose headers themselves."""
    if protocol in _S3:
        return {"ContentType": headers.type, "CacheControl": headers.caching}
    if protocol in _GOOGLE:
        return {"content_type": headers.type, "fixed_key_metadata": {"cache_control": headers.caching}}
    return {}
