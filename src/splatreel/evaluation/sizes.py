"""How large a reel is, and what it would be without compression."""

from __future__ import annotations

from splatreel.codec.manifest import Manifest


def reel_bytes(manifest: Manifest) -> int:
    """Bytes of the whole reel."""
    return manifest_bytes(manifest) + sum(entry.bytes for entry in (*manifest.layers, *manifest.groups))


def first_view_bytes(manifest: Manifest) -> int:
    """Bytes a player needs for the first picture: the manifest, the layers born at the first group, and that group."""
    first = [entry.bytes for entry in (*manifest.layers, *manifest.groups) if entry.group == 0]
    return manifest_bytes(manifest) + sum(first)


def manifest_bytes(manifest: Manifest) -> int:
    return len(manifest.to_json().encode())


def float32_bytes(manifest: Manifest) -> int:
    """Bytes of the model as plain float32: every point's attributes once, and 7 numbers a dynamic point and frame."""
    attributes = 4 * (3 + 4 + 3 + 1 + 3 * (manifest.sh_degree + 1) ** 2)
    points = sum(entry.points for entry in (*manifest.layers, *manifest.groups))
    offsets = sum(4 * 7 * entry.points * entry.frames for entry in manifest.groups)
    return attributes * points + offsets
