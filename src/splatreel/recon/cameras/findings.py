"""What an inspection of the cameras' poses found, and the sentences that a user reads of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from splatreel.errors import ReconstructionError
from splatreel.scene.camera import Camera


@dataclass(frozen=True)
class Mended:
    """A camera that was put right. pixels: by how much what it shows moves, median of places as far as most cameras look."""

    camera: Camera
    pixels: float


@dataclass(frozen=True)
class Findings:
    """What an inspection found, by index of the cameras.

    mended: those that were put right. strangers: those that do not show what their neighbors do. doubtful: all that seem wrong, if
    they are so many that nobody can tell which are right; the first two are empty then. unchecked: those that show too little of what
    the others do for anybody to tell. misread: what all poses are in truth, where they are not what was asked for.
    """

    mended: dict[int, Mended]
    strangers: list[int]
    doubtful: list[int]
    unchecked: list[int] = field(default_factory=list)
    misread: str | None = None

    def refuse(self, origin: str) -> None:
        """Raises `ReconstructionError` for poses that are not what was asked for. origin: where they come from."""
        if self.misread is not None:
            raise ReconstructionError(
                f"{origin}: the poses do not fit the pictures, but would if they were {self.misread}. Needed are matrices of world to "
                f"camera, in OpenCV's axes: x right, y down, z forward. Convert them."
            )

    def repairs(self, names: list[str]) -> list[str]:
        """A sentence for each camera that was put right."""
        return [
            f"{names[number]} is not where its pose says, what it shows is off by {mended.pixels:.1f} pixels: put right"
            for number, mended in self.mended.items()
        ]

    def doubts(self, names: list[str]) -> list[str]:
        """Sentences on those that could not be."""
        wrong = "shows nothing that its neighbors do from where it is said to be, and is left out: check its pose and its video"
        said = [f"{names[number]} {wrong}" for number in self.strangers]
        if self.doubtful:
            doubtful = ", ".join(names[number] for number in self.doubtful)
            said.append(
                f"the poses or lenses of {doubtful} do not fit each other, too many to be put right: calibrate anew"
            )
        if len(self.unchecked) == len(names):
            said.append("the cameras show too little in common to check their poses: taken as they are said to be")
        elif self.unchecked:
            unchecked = ", ".join(names[number] for number in self.unchecked)
            said.append(
                f"{unchecked}: too little in common with the other cameras to check the pose, taken as it is said to be"
            )
        return said
