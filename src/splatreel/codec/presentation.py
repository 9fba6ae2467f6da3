"""Presentation of a reel in its manifest: texts, images, sound, and the limits of its views (docs/format.md).

Every field is optional. The parser accepts untrusted input.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

from splatreel.base.errors import ReelError
from splatreel.codec.quantize import integer, number, numbers

_MAX_ASSET_BYTES = 64 << 20
"""Maximum size of an image or sound file."""
MAX_TEXT = {"title": 200, "author": 200, "description": 2000, "licence": 200}
"""Maximum number of characters of each text."""
_URI = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)*")
_SOUND_TYPE = re.compile(r'audio/[a-z0-9]+; codecs="[A-Za-z0-9.]+"')
_MOST_SECONDS = 1e7

Vec3 = tuple[float, float, float]
T = TypeVar("T")


@dataclass(frozen=True)
class Asset:
    """File of the reel without points. `uri` is relative to the manifest."""

    uri: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Poster:
    """JPEG of the start camera at the first frame, width x height pixels."""

    asset: Asset
    width: int
    height: int


@dataclass(frozen=True)
class Thumbnails:
    """Images of the start camera, the k-th at time k * seconds.

    Attributes:
        width: Width of an image in pixels.
        height: Height of an image in pixels.
        columns: Images per row of a sheet.
        rows: Rows of a sheet.
        seconds: Time between images.
        sheets: JPEGs of columns x rows images, row by row. All but the last are full.
    """

    width: int
    height: int
    columns: int
    rows: int
    seconds: float
    count: int
    sheets: tuple[Asset, ...]


@dataclass(frozen=True)
class SoundSegment:
    """Part of the sound that starts at `start` seconds of the reel and is `seconds` long."""

    asset: Asset
    start: float
    seconds: float


@dataclass(frozen=True)
class Sound:
    """Sound as fragmented MP4. `init`, followed by any consecutive segments, is a stream of MIME type `type`.

    Attributes:
        segments: Segments in order of time.
        position: Position of the source, world units; None if the sound has no position.
    """

    type: str
    rate: int
    channels: int
    init: Asset
    segments: tuple[SoundSegment, ...]
    position: Vec3 | None = None

    @property
    def assets(self) -> list[Asset]:
        """All sound files, `init` first."""
        return [self.init, *(segment.asset for segment in self.segments)]

    def trimmed_before(self, seconds: float) -> Sound:
        """Drop segments that end before a time in seconds, except one for decoder pre-roll."""
        over = sum(segment.start + segment.seconds <= seconds for segment in self.segments)
        return replace(self, segments=self.segments[max(min(over, len(self.segments)) - 1, 0) :])


@dataclass(frozen=True)
class Limits:
    """Limits of views; None means no limit.

    Attributes:
        focus: Point the cameras look at, world units.
        angle: Largest angle in degrees at the focus between a viewer and the nearest camera.
        distance: Smallest and largest distance of a viewer from the focus, world units.
        floor: Lowest height of a viewer along the reel's `up`.
    """

    focus: Vec3
    angle: float | None = None
    distance: tuple[float, float] | None = None
    floor: float | None = None


@dataclass(frozen=True)
class Presentation:
    """Fields of a manifest for users. Texts are plain; an empty text is absent."""

    title: str = ""
    author: str = ""
    description: str = ""
    licence: str = ""
    poster: Poster | None = None
    thumbnails: Thumbnails | None = None
    sound: Sound | None = None
    limits: Limits | None = None

    @property
    def assets(self) -> list[Asset]:
        """All files that the presentation names."""
        found = [self.poster.asset] if self.poster else []
        found += self.thumbnails.sheets if self.thumbnails else ()
        found += self.sound.assets if self.sound else ()
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the manifest's fields."""
        document: dict[str, Any] = {name: getattr(self, name) for name in MAX_TEXT if getattr(self, name)}
        if self.poster:
            document["poster"] = vars(self.poster.asset) | {"width": self.poster.width, "height": self.poster.height}
        if self.thumbnails:
            sheets = [vars(sheet) for sheet in self.thumbnails.sheets]
            document["thumbnails"] = vars(self.thumbnails) | {"sheets": sheets}
        if self.sound:
            document["sound"] = _sound_to_json(self.sound)
        if self.limits:
            limits = {name: value for name, value in vars(self.limits).items() if value is not None}
            document["limits"] = {n: list(v) if isinstance(v, tuple) else v for n, v in limits.items()}
        return document


EMPTY = Presentation()


def parse_presentation(document: dict[str, Any]) -> Presentation:
    """Parse the presentation of a manifest. Raise `ReelError` with the name of the invalid field."""
    return Presentation(
        **{name: _parse_text(document, name) for name in MAX_TEXT},
        poster=_parse(document, "poster", _parse_poster),
        thumbnails=_parse(document, "thumbnails", _parse_thumbnails),
        sound=_parse(document, "sound", _parse_sound),
        limits=_parse(document, "limits", _parse_limits),
    )


def check_text(name: str, text: str) -> str:
    """Return a valid title, author, description or license. Raise `ReelError` for one that is too long or not Unicode."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ReelError(f"has a {name} that holds half a character.")
    if len(text) > MAX_TEXT[name]:
        raise ReelError(f"has a {name} of {len(text)} characters, at most {MAX_TEXT[name]} are read.")
    return text


def parse_uri(entry: Mapping[str, Any]) -> str:
    """Return a file's `uri`. Raise `ReelError` if it leaves the reel or is hidden."""
    uri = entry.get("uri")
    if not isinstance(uri, str) or len(uri) > 500 or not _URI.fullmatch(uri):
        raise ReelError(f"has the uri {uri!r:.100}; only plain relative paths inside the reel are read.")
    return uri


def parse_digest(entry: Mapping[str, Any]) -> str:
    """Return a file's `sha256` in hexadecimal. Raise `ReelError` if it is invalid."""
    digest = entry.get("sha256")
    if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
        raise ReelError(f"has the sha256 {digest!r:.100}, expected 64 hexadecimal digits.")
    return digest


def _parse(document: dict[str, Any], name: str, parse: Callable[[dict[str, Any]], T]) -> T | None:
    value = document.get(name)
    if value is None:
        return None
    try:
        if not isinstance(value, dict):
            raise ReelError("is not an object.")
        return parse(value)
    except ReelError as error:
        raise ReelError(f"{name} {error}") from error


def _parse_text(document: dict[str, Any], name: str) -> str:
    value = document.get(name, "")
    if not isinstance(value, str):
        raise ReelError(f"its {name} is not text.")
    return check_text(name, value)


def _parse_asset(entry: object) -> Asset:
    if not isinstance(entry, dict):
        raise ReelError("has a file entry that is not an object.")
    return Asset(parse_uri(entry), integer(entry, "bytes", 1, _MAX_ASSET_BYTES), parse_digest(entry))


def _parse_assets(value: object) -> tuple[Asset, ...]:
    if not isinstance(value, list) or not 1 <= len(value) <= 1 << 20:
        raise ReelError("has no list of files.")
    return tuple(_parse_asset(entry) for entry in value)


def _parse_poster(value: dict[str, Any]) -> Poster:
    return Poster(_parse_asset(value), integer(value, "width", 1, 1 << 14), integer(value, "height", 1, 1 << 14))


def _parse_thumbnails(value: dict[str, Any]) -> Thumbnails:
    found = Thumbnails(
        width=integer(value, "width", 1, 4096),
        height=integer(value, "height", 1, 4096),
        columns=integer(value, "columns", 1, 1000),
        rows=integer(value, "rows", 1, 1000),
        seconds=number(value, "seconds", 1e-3, _MOST_SECONDS),
        count=integer(value, "count", 1, 1 << 30),
        sheets=_parse_assets(value.get("sheets")),
    )
    if -(-found.count // (found.columns * found.rows)) != len(found.sheets):
        raise ReelError(f"has {found.count} images, which {len(found.sheets)} sheets do not hold.")
    return found


def _parse_sound(value: dict[str, Any]) -> Sound:
    kind = value.get("type")
    if not isinstance(kind, str) or len(kind) > 100 or not _SOUND_TYPE.fullmatch(kind):
        raise ReelError(f'has the type {kind!r:.100}, expected something like audio/mp4; codecs="opus".')
    entries = value.get("segments")
    segments = tuple(
        SoundSegment(asset, number(entry, "start", 0, _MOST_SECONDS), number(entry, "seconds", 1e-3, 3600))
        for asset, entry in zip(_parse_assets(entries), entries or (), strict=True)
    )
    if any(later.start < before.start + before.seconds - 1e-3 for before, later in pairwise(segments)):
        raise ReelError("has segments that overlap or are not in order of time.")
    return Sound(
        type=kind,
        rate=integer(value, "rate", 1000, 768_000),
        channels=integer(value, "channels", 1, 8),
        init=_parse_asset(value.get("init")),
        segments=segments,
        position=_vector(value, "position") if "position" in value else None,
    )


def _parse_limits(value: dict[str, Any]) -> Limits:
    distance = tuple(numbers(value, "distance", 2).tolist()) if "distance" in value else None
    if distance and not 0 <= distance[0] < distance[1]:
        raise ReelError(f"has the distances {list(distance)}, expected the least and the most.")
    return Limits(
        focus=_vector(value, "focus"),
        angle=number(value, "angle", 0, 180) if "angle" in value else None,
        distance=distance,
        floor=number(value, "floor", -3e38, 3e38) if "floor" in value else None,
    )


def _vector(value: dict[str, Any], name: str) -> Vec3:
    x, y, z = numbers(value, name, 3).tolist()
    return x, y, z


def _sound_to_json(sound: Sound) -> dict[str, Any]:
    document: dict[str, Any] = {"type": sound.type, "rate": sound.rate, "channels": sound.channels}
    document["init"] = vars(sound.init)
    document["segments"] = [vars(s.asset) | {"start": s.start, "seconds": s.seconds} for s in sound.segments]
    if sound.position is not None:
        document["position"] = list(sound.position)
    return document
