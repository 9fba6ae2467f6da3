"""Folder at any address that fsspec supports: S3, Google and Azure buckets, SFTP, memory."""

from __future__ import annotations

import contextlib
import posixpath
import secrets
from typing import Any

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, StorageError, UsageError
from splatreel.storage.folder import PLAIN, REFUSALS, Headers, is_plain

_WHOLE = ("s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "oss", "obs", "memory")
"""Protocols whose files appear only when complete. For other protocols a file is written under a temporary name and moved."""
_BY_PREFIX = ("s3", "s3a", "gs", "gcs")
"""Protocols that can list files by a prefix of their names."""
_PACKAGES = {
    "s3": "s3fs",
    "s3a": "s3fs",
    "gs": "gcsfs",
    "gcs": "gcsfs",
    **dict.fromkeys(("az", "abfs", "abfss"), "adlfs"),
}
"""Python package that fsspec needs for each common protocol."""


class RemoteFolder:
    """Folder at a URL such as `s3://bucket/reels/one`.

    Credentials and endpoints come from the environment variables and files of the service's own tools, or from
    fsspec's.

    Raises:
        UsageError: The address is invalid.
        MissingDependencyError: A required Python package is not installed.
    """

    def __init__(self, url: str) -> None:
        self._url = url.rstrip("/")
        self._protocol = url.partition("://")[0]
        self._files, root = _open(url, self._protocol)
        self._root = root.rstrip("/")
        if not self._root.strip("/"):
            raise UsageError(
                f"{url}: names no folder. Write the bucket as well, such as {self._protocol}://BUCKET/REEL."
            )

    def address(self, name: str) -> str:
        """Return the name of a file for messages."""
        return f"{self._url}/{name}"

    def read(self, name: str, most: int) -> bytes | None:
        """Return the first `most` bytes of a file, or None."""
        try:
            return self._files.cat_file(f"{self._root}/{name}", start=0, end=most)
        except FileNotFoundError:
            return None
        except Exception as error:
            raise self._failed(name, "cannot be read", error) from error

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive) of a file."""
        try:
            return self._files.cat_file(f"{self._root}/{name}", start=begin, end=end) if end > begin else b""
        except Exception as error:
            raise self._failed(name, "cannot be read", error) from error

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Create or replace a file."""
        path = f"{self._root}/{name}"
        try:
            if self._protocol in _WHOLE:
                self._files.pipe_file(path, data, **header_arguments(self._protocol, headers))
            else:
                self._move_into_place(path, data)
        except Exception as error:
            raise self._failed(name, f"could not be written ({len(data)} bytes)", error) from error

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes of files by name."""
        folder = posixpath.dirname(prefix)
        try:
            self._files.invalidate_cache()
            found = self._files.find(f"{self._root}/{folder}".rstrip("/"), detail=True, **self._prefix_argument(prefix))
        except FileNotFoundError:
            return {}
        except Exception as error:
            raise self._failed(prefix, "cannot be listed", error) from error
        names = {str(path).removeprefix(f"{self._root}/"): int(entry["size"]) for path, entry in found.items()}
        return {name: size for name, size in names.items() if name.startswith(prefix) and is_plain(name)}

    def _prefix_argument(self, prefix: str) -> dict[str, str]:
        """Return the prefix argument for services that list by prefix. Other services list the folder."""
        last = posixpath.basename(prefix)
        return {"prefix": last} if last and self._protocol in _BY_PREFIX else {}

    def remove(self, name: str) -> None:
        """Delete a file."""
        try:
            with contextlib.suppress(FileNotFoundError):
                self._files.rm_file(f"{self._root}/{name}")
        except Exception as error:
            raise self._failed(name, "cannot be deleted", error) from error

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

    def _failed(self, name: str, what: str, error: Exception) -> StorageError:
        reason = " ".join(str(error).split()) or type(error).__name__
        return StorageError(f"{self.address(name)}: {what} ({reason:.300}).", lasting=_is_lasting(error))


def _open(url: str, protocol: str) -> tuple[Any, str]:
    """Return fsspec's file system and the path within it."""
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{url}: addresses of buckets need fsspec. Run\n  {install_command('cloud')}{_package_for(protocol)}"
        ) from error
    try:
        return url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        package = _package_for(protocol)
        advice = f"Run\n  pip install{package}" if package else f"{error}"
        raise MissingDependencyError(f"{url}: a Python package for {protocol}:// is missing. {advice}") from error
    except ValueError as error:
        raise UsageError(f"{url}: is not the address of a folder ({error}). Correct it.") from error
    except Exception as error:
        raise StorageError(f"{url}: cannot be reached ({error}).", lasting=_is_lasting(error)) from error


def _is_lasting(error: Exception) -> bool:
    """Return whether a retry cannot succeed. This includes missing credentials, which each service reports by its own error type."""
    return isinstance(error, REFUSALS) or type(error).__name__.endswith("CredentialsError")


def _package_for(protocol: str) -> str:
    package = _PACKAGES.get(protocol)
    return f" {package}" if package else ""


def header_arguments(protocol: str, headers: Headers) -> dict[str, Any]:
    """Return the arguments by which `pipe_file` sets headers. Hosts of other protocols choose headers themselves."""
    if protocol in ("s3", "s3a"):
        return {"ContentType": headers.type, "CacheControl": headers.caching}
    if protocol in ("gs", "gcs"):
        return {"content_type": headers.type, "fixed_key_metadata": {"cache_control": headers.caching}}
    return {}
