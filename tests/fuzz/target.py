"""Rules for any file: it decodes, or raises a `ReelError` that names it, in bounded memory and time."""

from __future__ import annotations

import hashlib
import json

from splatreel.base.errors import ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.codec.manifest import parse_manifest
from splatreel.codec.opus_sound import decode_sound
from tests.fuzz.seeds import DOCUMENTS, FIRST_PAGE, files, pages

NAME = "some/file"


def check(seed: str, data: bytes) -> bool:
    """Decode the edited file of a seed. Return whether it is valid; raise any exception that breaks the rules."""
    try:
        if seed == "page":
            _parse_page(data)
        elif seed.startswith("manifest"):
            parse_manifest(data, NAME, _fetch)
        elif seed == "sound":
            for _, samples in decode_sound(data, [], 1):
                assert samples.shape[1] == 1
        elif seed.startswith("layer"):
            decode_layer(data, NAME)[1].check_finite(NAME)
        else:
            group = decode_group(data, NAME)
            group.dynamic.check_finite(NAME)
    except ReelError as error:
        named = seed == "sound" or (
            str(error).startswith(NAME) and (seed in DOCUMENTS or _says_where(str(error), data))
        )
        if not named:
            raise AssertionError(f"The error does not name the file and the section: {error}") from error
        return False
    return True


def _fetch(uri: str, limit: int) -> bytes:
    if uri not in pages():
        raise ReelError(f"{NAME}: there is no {uri:.100}.")
    return pages()[uri][: limit + 1]


def _parse_page(data: bytes) -> None:
    """Parse data as a page of a manifest with the matching length and digest."""
    document = json.loads(files()["manifest-long"])
    document["pages"][0] |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    text = json.dumps(document).encode()
    parse_manifest(text, NAME, lambda uri, limit: data[: limit + 1] if uri == FIRST_PAGE else _fetch(uri, limit))


def _says_where(message: str, data: bytes) -> bool:
    """Return whether a message names the section, or reports an error of the header."""
    try:
        unpack_file(data)
    except ReelError:
        return True
    return any(words in message for words in ("section '", f"{NAME}: claims ", f"{NAME}: is a "))
