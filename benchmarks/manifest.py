"""Measure the size of a long reel's manifest, and the time to read and write it. Nothing is encoded.

python benchmarks/manifest.py --groups 10000
"""

import dataclasses
import gzip
import hashlib
import time
from collections.abc import Callable

import numpy as np
import tyro

from record import record
from splatreel.codec.header import ReelHeader
from splatreel.codec.manifest import PAGE, FileEntry, Known, Manifest, make_page, parse_manifest
from splatreel.scene.camera import Camera


def main(groups: int = 10_000, chapter: int = 10, cameras: int = 20, note: str = "") -> None:
    """groups: of a reel in chapters of `chapter`; one layer is of all, one of each chapter, and one is born in its middle."""
    manifest, files = reel(groups, chapter, cameras)
    text = manifest.to_json().encode()
    known: Known = {}
    values = {
        "groups": groups,
        "layers": len(manifest.layers),
        "pages": len(manifest.pages),
        "manifest_bytes": len(text),
        "manifest_gzip_bytes": len(gzip.compress(text)),
        "pages_bytes": sum(map(len, files.values())),
        "largest_page_gzip_bytes": max(len(gzip.compress(data)) for data in files.values()) if files else 0,
        "read_seconds": least(lambda: parse_manifest(text, "m", lambda uri, limit: files[uri])),
        "read_again_seconds": least(lambda: parse_manifest(text, "m", lambda uri, limit: files[uri], known=known)),
        "write_seconds": least(manifest.to_json),
    }
    print("\n".join(f"{name}: {value}" for name, value in values.items()))
    record("manifest", values, note)


def reel(groups: int, chapter: int, cameras: int) -> tuple[Manifest, dict[str, bytes]]:
    """Return the manifest, split as a writer splits it, and the files of its pages by URI."""
    layers = [entry("layers", 0)]
    for index in range(0, groups, chapter):
        until = index + chapter
        layers += [entry("layers", index, ".1", until=until), entry("layers", index + chapter // 2, "", until=until)]
    header = ReelHeader(
        fps=30,
        group_length=30,
        overlap=5,
        sh_degree=3,
        bounds=np.array([[-1.0, -1, -1], [1, 1, 1]]),
        up=np.array([0.0, -1, 0]),
        camera=camera(0),
        cameras=[camera(index) for index in range(cameras)],
    )
    entries = [entry("groups", index, frames=35) for index in range(groups)]
    whole = Manifest(**vars(header), generator="splatreel", live=False, frames=0).with_files(layers, entries)
    made = [make_page(layers, entries[i * PAGE :][:PAGE], ()) for i in range(max(groups // PAGE - 1, 0))]
    return dataclasses.replace(whole, pages=tuple(page for page, _ in made)), {p.uri: data for p, data in made}


def entry(kind: str, number: int, more: str = "", frames: int = 0, until: int | None = None) -> FileEntry:
    name = f"{kind}/{number:04d}{more}.safetensors"
    digest, size = hashlib.sha256(name.encode()).hexdigest(), 150_000 + number * 7919 % 50_000
    return FileEntry(name, size, digest, 30 * number, frames, size // 30, number, until=until)


def camera(index: int) -> Camera:
    rng = np.random.default_rng(index)
    viewmat = np.eye(4)
    viewmat[:3, 3] = rng.normal(size=3)
    viewmat[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    viewmat[0, :3] *= np.sign(np.linalg.det(viewmat[:3, :3]))
    return Camera(f"cam{index:02d}", viewmat, np.array([[1400.0, 0, 960], [0, 1400, 540], [0, 0, 1]]), 1920, 1080)


def least(function: Callable[[], object], times: int = 5) -> float:
    """Return the seconds of the fastest call."""
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        function()
        taken.append(time.perf_counter() - started)
    return round(min(taken), 4)


if __name__ == "__main__":
    tyro.cli(main)
