"""Addresses of new folders on each tested kind of storage."""

from __future__ import annotations

import itertools

import pytest

_NUMBERS = itertools.count()
KINDS = ("disk", "memory", "bucket")


def new_address(kind: str, request: pytest.FixtureRequest) -> str:
    """Return a path, or an address in memory or in a bucket of the S3-compatible server."""
    if kind == "disk":
        return str(request.getfixturevalue("tmp_path") / "elsewhere")
    if kind == "memory":
        pytest.importorskip("fsspec", reason="needs the extra cloud")
        return f"memory://storage-{next(_NUMBERS)}/folder"
    return request.getfixturevalue("bucket").url("some/folder")
