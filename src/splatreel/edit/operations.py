"""Operations of an edit by their names, as the command line and edit lists write them: `NAME` or `NAME=VALUE`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.base.untrusted import read_json
from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, Outline
from splatreel.edit.clip_writer import replace_sound
from splatreel.edit.ground import floor_height, with_ground
from splatreel.edit.joining import Joined
from splatreel.edit.placement import Moved, Similarity
from splatreel.edit.reel_clip import ReelClip
from splatreel.edit.retiming import Cut, Retimed, Reversed
from splatreel.edit.selection import (
    Erased,
    InVolume,
    LastingEnough,
    OpaqueEnough,
    SeenByCameras,
    Selected,
    Selection,
    SmallEnough,
)
from splatreel.scene.gaussians import turn_between
from splatreel.scene.volumes import Outside, Sphere, fail, parse_number, parse_numbers, parse_volume


def _parse_axis(name: str, value: str) -> np.ndarray:
    """Return a unit direction [3]: x, -x, y, -y, z, -z or three numbers."""
    match = re.fullmatch("(-?)([xyz])", value.strip())
    direction = np.zeros(3)
    if match:
        direction["xyz".index(match[2])] = -1.0 if match[1] else 1.0
        return direction
    if value.count(",") != 2:
        raise fail(name, value, "Give x, -x, y, -y, z, -z or three numbers as the axis")
    direction = parse_numbers(name, value, 3)
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        raise fail(name, value, "Give an axis that is not zero")
    return direction / length


def _parse_color(name: str, value: str) -> np.ndarray:
    """Return a color `#rrggbb` as [3], 0..1."""
    match = re.fullmatch("#?([0-9a-fA-F]{6})", value)
    if match is None:
        raise fail(name, value, "Give a color like #ffffff")
    return np.array([int(match[1][i : i + 2], 16) for i in (0, 2, 4)]) / 255


def parse_range(name: str, value: str, outline: Outline) -> tuple[int, int]:
    """Return the first frame and the frame after the last of `A:B`, in frames or, with an s, in seconds."""
    match = re.fullmatch(r"([0-9.]+s?)?:([0-9.]+s?)?", value)
    if match is None or not (match[1] or match[2]):
        raise fail(name, value, "Give a range A:B of frames, or of seconds like 1.5s:4s")
    fps, first, end = outline.header.fps, match[1], match[2]
    ends = _frame(name, first, fps) if first else 0, _frame(name, end, fps) if end else outline.frames
    if not 0 <= ends[0] < ends[1] <= outline.frames:
        raise fail(name, value, f"Choose frames from 0:{outline.frames}, which are {outline.seconds:g} seconds")
    return ends[0], ends[1]


def _frame(name: str, text: str, fps: float) -> int:
    if text.endswith("s"):
        return round(parse_number(name, text[:-1], 0, 1e7) * fps)
    if re.fullmatch("[0-9]{1,15}", text) is None:
        raise fail(name, text, "Give a whole number of frames, or seconds like 1.5s")
    return int(text)


_GAMMA = 2.2
"""Exponent between light and colors. An exposure then multiplies colors, as the light of a group does."""


class _Lit(ChangedClip):
    """Clip whose colors are multiplied by `gain` [3], also those of the background."""

    def __init__(self, clip: Clip, gain: np.ndarray) -> None:
        super().__init__(clip)
        self._gain = np.asarray(gain, np.float32)

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group in another light."""
        light = np.ones((found.group.frames, 3), np.float32) if found.group.light is None else found.group.light
        return replace(found, group=replace(found.group, light=light * self._gain))


def _with_header(clip: Clip, **changes: Any) -> Clip:
    """Return a clip with other values in its header."""
    return ChangedClip(clip, replace(clip.outline, header=replace(clip.outline.header, **changes)))


FORMAT = "splatreel-edit"
"""Format of edit list files: `{"format": "splatreel-edit", "version": 1, "operations": ["NAME=VALUE", ...]}`."""
MOST = 1000
"""Maximum number of operations of an edit."""


@dataclass(frozen=True)
class Operation:
    """Operation of an edit.

    Attributes:
        form: How it is written.
        help: Its effect.
        apply: Function from a clip and the text of the value to the changed clip.
    """

    form: str
    help: str
    apply: Callable[[Clip, str], Clip]


def apply_operations(clip: Clip, texts: Iterable[str]) -> Clip:
    """Return the clip after operations, in their order.

    Raises:
        UsageError: There is no such operation, or it has no such value.
    """
    texts = list(texts)
    if len(texts) > MOST:
        raise UsageError(f"The edit has {len(texts)} operations, at most {MOST} are possible.")
    for text in texts:
        name, given, value = text.partition("=")
        operation = OPERATIONS.get(name.strip())
        if operation is None:
            raise UsageError(f"{text!r:.100}: there is no such operation. Choose one of {', '.join(OPERATIONS)}.")
        if bool(given) != ("=" in operation.form):
            raise UsageError(f"{text!r:.100}: write {operation.form}.")
        clip = operation.apply(clip, value.strip())
    return clip


def with_texts(clip: Clip, texts: Mapping[str, str]) -> Clip:
    """Return the clip with other texts, by their names in the manifest."""
    return ChangedClip(clip, replace(clip.outline, texts={**clip.outline.texts, **texts}))


def read_edit_list(file: Path) -> list[str]:
    """Return the operations of an edit list file.

    Raises:
        UsageError: The file cannot be read, or is not an edit list.
    """
    document = read_json(file, UsageError, most=1 << 20)
    right = isinstance(document, dict) and document.get("format") == FORMAT
    if not right:
        raise UsageError(f'{file}: is not an edit list: its "format" is not "{FORMAT}".')
    if document.get("version") != 1:
        raise UsageError(
            f"{file}: has version {document.get('version')!r:.60}; this Splatreel reads 1. Update Splatreel."
        )
    operations = document.get("operations")
    if not isinstance(operations, list) or not all(isinstance(text, str) for text in operations):
        raise UsageError(f'{file}: its "operations" are not a list of texts like "crop=sphere:0,0,0,2".')
    return operations


def _cut(clip: Clip, value: str) -> Clip:
    return Cut(clip, *parse_range("cut", value, clip.outline))


def _join(clip: Clip, value: str) -> Clip:
    if not value:
        raise fail("join", value, "Name the folder of a reel")
    folder = Path(value)
    inside = folder / "reel"
    return Joined(clip, ReelClip(inside if (inside / "manifest.json").is_file() else value))


def _fps(clip: Clip, value: str) -> Clip:
    return Retimed(clip, parse_number("fps", value, 1e-3, 1000))


def _crop(clip: Clip, value: str) -> Clip:
    header = clip.outline.header
    volume = parse_volume("crop", value, header)
    box, bounds = volume.bounds(), header.bounds
    if box is not None:
        inner = np.stack([np.maximum(box[0], bounds[0]), np.minimum(box[1], bounds[1])])
        bounds = inner if (inner[0] < inner[1]).all() else box
    source = header.source and replace(header.source, part=header.source.part or "crop")
    return _with_header(Selected(clip, InVolume(volume)), bounds=bounds, source=source)


def _remove(clip: Clip, value: str) -> Clip:
    text, _, when = value.partition("@")
    volume = parse_volume("remove", text, clip.outline.header)
    if not when:
        return Selected(clip, InVolume(Outside(volume)))
    return Erased(clip, volume, parse_range("remove", when, clip.outline))


def _selecting(make: Callable[[Clip, str], Selection]) -> Callable[[Clip, str], Clip]:
    return lambda clip, value: Selected(clip, make(clip, value))


def _near_focus(clip: Clip, value: str) -> Selection:
    return InVolume(Sphere(clip.outline.focus, parse_number("max-distance", value, 1e-30, 1e30)))


def _cameras(clip: Clip, value: str) -> Selection:
    count = len(clip.outline.header.cameras)
    least = parse_number("min-cameras", value, 1, max(count, 1))
    if least != round(least):
        raise fail("min-cameras", value, "Give a whole number")
    return SeenByCameras(round(least))


def _rotate(clip: Clip, value: str) -> Clip:
    *axis, degrees = value.split(",")
    direction = _parse_axis("rotate", ",".join(axis))
    half = np.radians(parse_number("rotate", degrees, -3600, 3600)) / 2
    return Moved(clip, Similarity(quat=np.concatenate([[np.cos(half)], np.sin(half) * direction])))


def _up(clip: Clip, value: str) -> Clip:
    quat = turn_between(clip.outline.header.up, _parse_axis("up", value))
    return Moved(clip, Similarity(quat=quat, turns_up=True))


def _scale(clip: Clip, value: str) -> Clip:
    return Moved(clip, Similarity(scale=parse_number("scale", value, 1e-6, 1e6)))


def _distance(clip: Clip, value: str) -> Clip:
    parts = value.rsplit(",", 2)
    if len(parts) != 3:
        raise fail("distance", value, "Write distance=CAMERA,CAMERA,METERS")
    cameras = {camera.name: camera for camera in clip.outline.header.cameras}
    missing = [name for name in parts[:2] if name not in cameras]
    if missing:
        raise fail("distance", value, f"{missing[0]!r:.60} is not a camera; choose from {', '.join(sorted(cameras))}")
    found = float(np.linalg.norm(cameras[parts[0]].center - cameras[parts[1]].center))
    if found <= 0:
        raise fail("distance", value, "Name two cameras that are apart")
    return Moved(clip, Similarity(scale=parse_number("distance", parts[2], 1e-6, 1e6) / found))


def _move(clip: Clip, value: str) -> Clip:
    return Moved(clip, Similarity(shift=parse_numbers("move", value, 3)))


def _floor(clip: Clip, value: str) -> Clip:
    up, origin = clip.outline.header.up, clip.outline.header.origin
    moved = Moved(clip, Similarity(shift=-floor_height(clip) * up))
    return _with_header(moved, origin=origin - (origin @ up) * up)


def _ground(clip: Clip, value: str) -> Clip:
    if not value:
        raise fail("ground", value, "Name the folder of the capture that the reel was made from")
    return with_ground(clip, value)


def _exposure(clip: Clip, value: str) -> Clip:
    return _Lit(clip, np.full(3, 2 ** (parse_number("exposure", value, -8, 8) / _GAMMA)))


def _gain(clip: Clip, value: str) -> Clip:
    gain = parse_numbers("gain", value if "," in value else ",".join([value] * 3), 3)
    if not ((gain >= 0.01) & (gain <= 100)).all():
        raise fail("gain", value, "Give factors from 0.01 to 100")
    return _Lit(clip, gain)


def _white(clip: Clip, value: str) -> Clip:
    color = _parse_color("white", value)
    if color.min() < 0.02:
        raise fail("white", value, "Give a color that is not so dark")
    return _Lit(clip, color.mean() / color)  # gray of the same mean brightness


def _background(clip: Clip, value: str) -> Clip:
    if value == "transparent":
        return _with_header(clip, transparent=True)
    return _with_header(clip, transparent=False, background=tuple(_parse_color("background", value).tolist()))


def _sound(clip: Clip, value: str) -> Clip:
    if value == "none":
        return ChangedClip(clip, replace_sound(clip.outline, None))
    match = re.fullmatch(r"(.+?)(?:@(-?[0-9.]+)s?)?", value)
    if match is None or not Path(match[1]).is_file():
        raise fail("sound", value, "Name a sound file, or none")
    start = parse_number("sound", match[2], -1e5, 1e5) if match[2] else 0.0
    return ChangedClip(clip, replace_sound(clip.outline, Path(match[1]), start))


OPERATIONS = {
    "cut": Operation(
        "cut=A:B", "keep frames A to B - 1, or seconds with an s, as in 1.5s:4s; either may be left out", _cut
    ),
    "join": Operation("join=REEL", "append another reel", _join),
    "reverse": Operation("reverse", "play backwards, with the sound", lambda clip, _: Reversed(clip)),
    "fps": Operation("fps=N", "change the frame rate; motion is interpolated, the duration stays", _fps),
    "crop": Operation("crop=VOLUME", "keep what is in a volume, in all frames", _crop),
    "remove": Operation("remove=VOLUME[@A:B]", "remove what is in a volume, in frames A to B - 1 or in all", _remove),
    "min-cameras": Operation(
        "min-cameras=N", "remove points that fewer cameras saw, hidden points included", _selecting(_cameras)
    ),
    "min-opacity": Operation(
        "min-opacity=X",
        "remove points that are always fainter, 0 to 1",
        _selecting(lambda _, value: OpaqueEnough(parse_number("min-opacity", value, 0, 1))),
    ),
    "max-size": Operation(
        "max-size=X",
        "remove points with a larger standard deviation, world units",
        _selecting(lambda _, value: SmallEnough(parse_number("max-size", value, 1e-30, 1e30))),
    ),
    "max-distance": Operation(
        "max-distance=X", "remove points farther from what the cameras look at", _selecting(_near_focus)
    ),
    "min-seconds": Operation(
        "min-seconds=X",
        "remove points that appear and disappear in less time",
        _selecting(lambda _, value: LastingEnough(parse_number("min-seconds", value, 0, 1e6))),
    ),
    "rotate": Operation(
        "rotate=AXIS,DEGREES", "turn the scene about an axis: x, y, z or three numbers; up stays", _rotate
    ),
    "up": Operation("up=AXIS", "turn the scene and its up direction to x, -x, y, -y, z, -z or three numbers", _up),
    "scale": Operation("scale=X", "multiply all lengths, for example to get meters", _scale),
    "distance": Operation("distance=A,B,METERS", "scale so that the cameras A and B are so far apart", _distance),
    "move": Operation("move=X,Y,Z", "shift the scene", _move),
    "floor": Operation("floor", "shift the scene so that its floor has the height 0", _floor),
    "ground": Operation("ground=CAPTURE", "add the floor under the subject, as the capture shows it", _ground),
    "exposure": Operation("exposure=STOPS", "brighten, or darken with a negative number", _exposure),
    "gain": Operation("gain=X or R,G,B", "multiply all colors", _gain),
    "white": Operation("white=#RRGGBB", "make this color gray", _white),
    "background": Operation("background=#RRGGBB", "set the color behind the points, or transparent", _background),
    "sound": Operation("sound=FILE[@S]", "play a sound file from its second S on, or none", _sound),
}
"""All operations, in the order of the help."""
