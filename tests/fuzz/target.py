"""What must hold for any file: it decodes, or `ReelError` names it; in bounded memory and time."""

from __future__ import annotations

from splatreel.codec.container import unpack_file
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.codec.manifest import parse_manifest
from splatreel.codec.sound import decode_sound
from splatreel.errors import ReelError

NAME = "some/file"


def check(seed: str, data: bytes) -> bool:
    """Decode the edited file of a seed; True if it is a file of a reel. Raises whatever should not be raised."""
    try:
        if seed == "manifest":
            parse_manifest(data, NAME)
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
            str(error).startswith(NAME) and (seed == "manifest" or _says_where(str(error), data))
        )
        if not named:
            raise AssertionError(f"The error does not name the file and the section: {error}") from error
        return False
    return True


def _says_where(message: str, data: bytes) -> bool:
    """A section, unless the header is at fault: what it is of, or how much it claims."""
    try:
        unpack_file(data)
    except ReelError:
        return True
    return any(words in message for words in ("section '", f"{NAME}: claims ", f"{NAME}: is a "))
