"""All exceptions that Splatreel raises on purpose.

A message states what happened, the file and value concerned, and the remedy. The command line prints the message and
exits with the error's exit code. Programs catch `SplatreelError`.
"""


class SplatreelError(Exception):
    """Base class of all expected errors."""

    exit_code = 1


class UsageError(SplatreelError):
    """An invalid request, such as an unknown option value or two options that exclude each other."""

    exit_code = 2


class CaptureError(SplatreelError):
    """Input videos, images or cameras that cannot be used as they are."""


class ReelError(SplatreelError):
    """A reel, or a file of one, that is damaged, incomplete or of an unknown version."""


class GaussiansError(SplatreelError):
    """Gaussians with values that no renderer can draw, such as NaN or wrong shapes."""


class ReconstructionError(SplatreelError):
    """A reconstruction that cannot start or continue."""


class GpuError(ReconstructionError):
    """A GPU that was lost, has too little memory or does not allow what training needs. The CPU can continue."""


class CancelledError(SplatreelError):
    """A call that the program cancelled. The same call continues."""


class InUseError(ReconstructionError):
    """A folder that another process is using. The same call may succeed when that process has ended."""


class StorageError(SplatreelError):
    """A folder, such as a bucket, that cannot be reached or refuses access.

    Attributes:
        lasting: True if a retry cannot succeed.
    """

    def __init__(self, message: str, *, lasting: bool = False) -> None:
        super().__init__(message)
        self.lasting = lasting


class MissingDependencyError(SplatreelError):
    """An optional package that is not installed. The message names the extra that installs it."""
