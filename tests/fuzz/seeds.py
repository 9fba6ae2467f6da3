"""Seeds for fuzzing: a tiny file of every codec and kind, manifests of both versions, a page, and sound."""

from __future__ import annotations

import dataclasses
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from splatreel.codec.group_file import encode_group, encode_layer
from splatreel.codec.sound import encode_sound
from splatreel.config import EncodeConfig
from splatreel.scene.group import Group
from tests.codec.reels import points, write_reel
from tests.golden import random_motion, weights
from tests.golden_long import LONG

PAPER = EncodeConfig(codec="h265", sh_entries=4)
FLOATS = dict.fromkeys(("position_bits", "quat_bits", "opacity_bits", "scale_bits", "color_bits"))
CONFIGURATIONS = {
    "predictive": EncodeConfig(coarseness=1.0),
    "h265": PAPER,
    "ori": dataclasses.replace(PAPER.with_h265(source="ori"), sh_entries=None),
    "dif": dataclasses.replace(PAPER.with_h265(source="dif", fold=False), sh_entries=0),
    "raw": PAPER.with_h265(source="raw", **FLOATS),
    "pictures": PAPER.with_h265(crf_attributes=20),
}
POINTS, FRAMES = 12, 3

FIRST_PAGE = "pages/000000.json"
DOCUMENTS = "manifest", "manifest-long", "page"
"""Names of the seeds that are JSON."""


@cache
def pages() -> dict[str, bytes]:
    """Return the pages of `manifest-long` by uri."""
    return {f"pages/{path.name}": path.read_bytes() for path in (LONG / "pages").iterdir()}


@cache
def files() -> dict[str, bytes]:
    """Return the seeds by name.

    They are `layer-NAME` and `group-NAME` for every configuration, the `manifest` of a reel, the `manifest-long` of a reel with pages,
    the first `page` of the latter, and the `sound` of a reel.
    """
    found = {}
    for name, config in CONFIGURATIONS.items():
        found[f"layer-{name}"], _ = encode_layer(0, 0, points(POINTS, degree=2), config, weights(POINTS))
        moving = points(POINTS, seed=1)
        dx, dq = random_motion(np.random.default_rng(0), moving, FRAMES)
        group = Group(0, 0, moving, dx, dq, np.arange(40) % 3 > 0)
        found[f"group-{name}"], _ = encode_group(group, config, weights(POINTS))
        if config.h265.source == "ofs":
            shade = np.linspace(-0.2, 0.2, FRAMES * POINTS * 4, dtype=np.float32).reshape(FRAMES, POINTS, 4)
            light = np.linspace(0.5, 2, FRAMES * 3, dtype=np.float32).reshape(FRAMES, 3)
            shaded = dataclasses.replace(group, shade=shade, light=light)
            found[f"group-{name}-shaded"], _ = encode_group(shaded, config, weights(POINTS))
    with tempfile.TemporaryDirectory() as folder:
        found["manifest"] = (write_reel(Path(folder) / "reel") / "manifest.json").read_bytes()
    found["manifest-long"], found["page"] = (LONG / "manifest.json").read_bytes(), pages()[FIRST_PAGE]
    sound = encode_sound([np.sin(np.arange(4800, dtype=np.float32))[:, None]], 1)
    found["sound"] = sound.init + sound.segments[0]
    return found
