"""Every error Splatreel raises on purpose.

A message says what happened, names the file and the offending value, and says what to do about it. The command line prints it
as one block and leaves with the error's exit code; a program can catch `SplatreelError`.
"""


class SplatreelError(Exception):
    """Base of every error a user can cause or meet."""

    exit_code = 1


class UsageError(SplatreelError):
    """The request itself is wrong: an unknown option value, two options that exclude each other."""

    exit_code = 2


class CaptureError(SplatreelError):
    """The input videos, images or cameras cannot be used as they are."""


class ReelError(SplatreelError):
    """A reel, or a file that claims to belong to one, is damaged, incomplete or of an unknown version."""


class GaussiansError(SplatreelError):
    """Gaussians hold values no renderer can draw (NaN, wrong shapes)."""


class ReconstructionError(SplatreelError):
    """Reconstruction cannot start or go on."""


class InUseError(ReconstructionError):
    """Another process is at work there; once it is done, or was killed, the same may succeed."""


class StorageError(SplatreelError):
    """A folder elsewhere, such as a bucket, cannot be reached or refuses. lasting: to try again would change nothing."""

    def __init__(self, message: str, *, lasting: bool = False) -> None:
        super().__init__(message)
        self.lasting = lasting


class MissingDependencyError(SplatreelError):
    """An optional package is needed; the message names the extra that brings it."""
