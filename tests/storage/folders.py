"""Addresses of new folders on each kind of storage that is tested."""

from __future__ import annotations

import itertools

import pytest

_NUMBERS = itertools.count()
KINDS = ("disk", "memory", "bucket")


def new_address(kind: str, request: pytest.FixtureRequest) -> str:
    """A path, or an address of memory or of a bucket of the S3-compatible server."""
    if kind == "disk":
        return str(request.getfixturevalue("tmp_path") / "elsewhere")
    if kind == "memory":
        pytest.importorskip("fsspec", reason="needs the extra cloud")
        return f"memory://storage-{next(_NUMBERS)}/folder"
    return request.getfixturevalue("bucket").url("some/folder")
