"""Hostile files for the tests of both readers. `python -m tests.fuzz.hostile` writes them to tests/data/hostile.

Their names are KIND-NAME.bin, where KIND is layer, group or manifest. `python -m tests.fuzz.run PROGRAM --keep NAME` adds a file that
fuzzing found.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer
from splatreel.codec.predictive import klt
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.fuzz.edits import Draft
from tests.fuzz.seeds import files

_LENGTHS = struct.Struct("<IIII")
"""Lengths of the four streams of a `klt` section."""
FOLDER = Path(__file__).parent.parent / "data" / "hostile"
LIES: dict[str, tuple[str, Callable[[Draft], object]]] = {
    "layer-millions-of-points": ("layer-predictive", lambda d: d.own.update(points=8_000_000)),
    "layer-points-of-another": ("layer-h265", lambda d: d.own.update(points=13)),
    "layer-zlib-bomb": ("layer-h265", lambda d: d.sections.update(quats=zlib.compress(bytes(1 << 25), 9))),
    "layer-nan-range": ("layer-h265", lambda d: d.own["sections"]["scales"].update(min=[float("nan"), 0, 0])),
    "layer-huge-range": ("layer-h265", lambda d: d.own["sections"]["scales"].update(max=[1e39, 1, 1])),
    "layer-other-codec": ("layer-h265", lambda d: d.own["sections"]["sh_base"].update(codec="jpeg")),
    "layer-entry-beyond-codebook": ("layer-h265", lambda d: d.own["sections"]["sh_rest"].update(bits=16, entries=1)),
    "layer-section-outside": ("layer-h265", lambda d: d.places.update(means={"data_offsets": [0, 1 << 40]})),
    "layer-negative-place": ("layer-h265", lambda d: d.places.update(means={"data_offsets": [-8, 8]})),
    "layer-no-positions": ("layer-predictive", lambda d: d.own["sections"].pop("means")),
    "layer-draco-cut-off": ("layer-h265", lambda d: d.sections.update(means=d.sections["means"][:20])),
    "layer-draco-no-positions": ("layer-h265", lambda d: d.sections.update(means=_normals(d.sections["means"]))),
    "layer-huge-step": ("layer-predictive", lambda d: d.own["sections"]["shapes"].update(step=1e300)),
    "layer-stream-cut-off": ("layer-predictive", lambda d: d.sections.update(shapes=d.sections["shapes"][:-3])),
    "layer-places-cut-off": ("layer-predictive", lambda d: d.sections.update(places=d.sections["places"][:-3])),
    "layer-thousands-of-bits": ("layer-predictive", lambda d: d.own["sections"]["means"].update(finer=4000)),
    "group-millions-of-frames": ("group-predictive", lambda d: d.own.update(frames=5_000_000)),
    "group-billions-of-flags": ("group-h265", lambda d: d.own["sections"]["alive"].update(count=1 << 40)),
    "group-video-cut-off": ("group-h265", lambda d: d.sections.update(offsets=d.sections["offsets"][:900])),
    "group-maps-too-large": ("group-h265", lambda d: d.own["sections"]["offsets"].update(width=8192, height=8192)),
    "group-basis-of-no-columns": ("group-predictive", lambda d: d.own["sections"]["dx"].update(shifts=[])),
    "group-basis-of-millions": ("group-predictive", lambda d: _millions_in_a_basis(d)),
    "group-no-motion": ("group-h265", lambda d: d.own["sections"].pop("offsets")),
    "group-millions-of-flags": ("group-h265", lambda d: _millions_of_flags(d)),
    "group-thousands-of-still-frames": ("group-predictive", lambda d: _still(d, 30_000, 350)),
    "group-thousands-of-pictures": ("group-h265", lambda d: d.own.update(frames=9_000)),
    "group-millions-of-samples": ("group-h265", lambda d: d.sections.update(offsets=_samples(d.sections["offsets"]))),
    "layer-equal-points": ("layer-predictive", lambda d: _still(d, 800_000, 0)),
    "layer-draco-many-numbers": ("layer-h265", lambda d: d.sections.update(means=_numbers(d.sections["means"]))),
}
"""For each name the seed and the edit that makes it hostile."""
MANIFEST_LIES: dict[str, Callable[[dict[str, Any]], object]] = {
    "manifest-path-up": lambda m: m["groups"][0].update(uri="../../secret"),
    "manifest-absolute-path": lambda m: m["layers"][0].update(uri="/etc/passwd"),
    "manifest-other-host": lambda m: m["groups"][0].update(uri="https://other.example/groups/0000.safetensors"),
    "manifest-no-scheme": lambda m: m["groups"][0].update(uri="//other.example/x"),
    "manifest-hidden-file": lambda m: m["groups"][0].update(uri="groups/.hidden"),
    "manifest-no-time": lambda m: m.update(fps=0),
    "manifest-infinite-frames": lambda m: m.update(frames=10**400),
    "manifest-no-camera": lambda m: m.update(camera=None),
    "manifest-bounds-of-one-corner": lambda m: m.update(bounds=[[0, 0, 0]]),
    "manifest-later-version": lambda m: m.update(version=3),
    "manifest-endless": lambda m: m.update(frames=1 << 40),
    "manifest-endless-group": lambda m: (m.update(frames=1 << 40), m["groups"][-1].update(frames=(1 << 40) - 2)),
    "manifest-points-without-bytes": lambda m: m["layers"][0].update(points=800_000),
    "manifest-sound-path-up": lambda m: m.update(sound=_sound(uri="../secret.m4s")),
    "manifest-sound-of-a-page": lambda m: m.update(sound=_sound() | {"type": "text/html"}),
    "manifest-sound-endless": lambda m: m.update(sound=_sound(seconds=1e12)),
    "manifest-sound-before-it-begins": lambda m: m.update(sound=_sound(start=-1)),
    "manifest-sound-too-large": lambda m: m.update(sound=_sound(bytes=1 << 40)),
    "manifest-sound-nowhere": lambda m: m.update(sound=_sound() | {"position": [0, "x", 0]}),
    "manifest-retired-before-it-is-born": lambda m: (m.update(version=2), m["layers"][1].update(until=1)),
    "manifest-longest-lived-last": lambda m: m.update(version=2, layers=[x | {"group": 0} | u for x, u in _lives(m)]),
    "manifest-lists-what-is-gone": lambda m: (m.update(version=2, first_group=4), m["layers"][0].update(until=3)),
    "manifest-first-group-below-zero": lambda m: m.update(version=2, first_group=-1),
    "manifest-page-path-up": lambda m: m.update(version=2, pages=[_page(uri="../../secret")]),
    "manifest-page-endless": lambda m: m.update(version=2, pages=[_page(groups=1 << 40)]),
    "manifest-page-too-large": lambda m: m.update(version=2, pages=[_page(bytes=1 << 30)]),
    "manifest-page-of-no-time": lambda m: m.update(version=2, pages=[_page(frames=-5)]),
    "manifest-pages-too-large-together": lambda m: m.update(version=2, pages=[_page(bytes=1 << 20)] * 80),
    "manifest-pages-and-no-group": lambda m: m.update(version=2, pages=[_page()], groups=[], live=True),
    "manifest-layers-without-bytes": lambda m: m.update(layers=[m["layers"][i] | {"points": 80_000} for i in (0, 1)]),
}


def _lives(manifest: dict[str, Any]) -> list[tuple[dict[str, Any], dict[str, int]]]:
    return [(manifest["layers"][0], {"until": 1}), (manifest["layers"][1], {"until": 2})]


def _page(**lie: object) -> dict[str, Any]:
    """Return the entry of a page in a manifest, with false values."""
    said = {"uri": "pages/000000.json", "bytes": 900, "sha256": "0" * 64, "first_frame": 0, "frames": 3, "groups": 1}
    return said | lie


def _sound(**segment: object) -> dict[str, Any]:
    """Return sound of one segment with false values."""
    asset = {"uri": "sound/init.mp4", "bytes": 565, "sha256": "0" * 64}
    first = asset | {"uri": "sound/0000.m4s", "start": 0, "seconds": 2} | segment
    kind = 'audio/mp4; codecs="opus"'
    return {"type": kind, "rate": 48000, "channels": 1, "init": asset, "segments": [first]}


def _millions_of_flags(draft: Draft) -> None:
    """Replace the alive bitmap by 8 MB of zeros, deflated."""
    draft.own["sections"]["alive"].update(count=1 << 26, deflate=True)
    draft.sections["alive"] = zlib.compress(bytes(1 << 23), 9)


def _still(draft: Draft, points: int, frames: int) -> None:
    """Replace the points by equal ones, which take no bytes, and pad the file with zeros to pass the limits on points per byte."""
    same = Gaussians(
        np.zeros((points, 3)),
        np.tile([1.0, 0, 0, 0], (points, 1)),
        np.ones((points, 3)),
        np.ones(points),
        np.zeros((points, 9, 3)),
    )
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (frames, points, 1))
    data, _ = (
        encode_group(
            Group(0, 0, same, np.zeros((frames, points, 3), np.float32), still, np.ones(40, bool)), EncodeConfig()
        )
        if frames
        else encode_layer(0, 0, same, EncodeConfig())
    )
    made = Draft.of(data)
    made.own["sections"]["means"]["finer"] = 0
    draft.own, draft.sections = (
        made.own,
        made.sections | {"places": b"", "filler": bytes(max(points // 8, points * frames >> 8))},
    )


def _samples(video: bytes) -> bytes:
    """Make the tables of a video's first track claim twenty million samples of one byte."""
    out, count = bytearray(video), 20_000_000
    for name, at, words in ((b"stts", 8, (count, 512)), (b"stsc", 8, (1, count, 1)), (b"stsz", 4, (1, count))):
        struct.pack_into(f">{len(words)}I", out, video.index(name) + 4 + at, *words)
    return bytes(out)


def _numbers(cloud: bytes) -> bytes:
    """Make a Draco cloud claim positions of 255 numbers each."""
    return cloud[:19] + b"\xff" + cloud[20:]


def _normals(cloud: bytes) -> bytes:
    """Make the only attribute of a Draco cloud claim to be normals. The type follows the number of attributes."""
    return cloud[:17] + b"\1" + cloud[18:]


def _millions_in_a_basis(draft: Draft) -> None:
    """Add a basis of 3000 x 3000 zeros, which takes no bytes in the file and 72 MB per array in memory."""
    frames = 3000
    draft.own["frames"] = frames
    draft.own["sections"]["dx"]["shifts"] = [4] * frames
    _, *sizes = _LENGTHS.unpack_from(draft.sections["dx"])
    basis = klt.encode_basis(np.zeros((frames, frames), np.int64))
    rest = draft.sections["dx"][-sum(sizes) :]
    draft.sections["dx"] = _LENGTHS.pack(len(basis), *sizes) + basis + rest


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, (seed, lie) in LIES.items():
        draft = Draft.of(files()[seed])
        lie(draft)
        (FOLDER / f"{name}.bin").write_bytes(draft.pack())
    for name, lie in MANIFEST_LIES.items():
        document = json.loads(files()["manifest"])
        lie(document)
        (FOLDER / f"{name}.bin").write_text(json.dumps(document))


if __name__ == "__main__":
    main()
