"""The verdict of `capture check`: whether the evidence that it printed supports a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.recon.coverage.coverage import FEWEST_SHARED, Coverage
from splatreel.recon.coverage.rating import rating

UNCONFIRMED = 5
"""Points shared with two others, below which a camera's pose counts as unconfirmed where most cameras share enough."""


@dataclass(frozen=True)
class Verdict:
    """The conclusion about a capture.

    faults: what to correct before reconstructing; empty if nothing speaks against it. expected: what new views will be like.
    """

    faults: list[str]
    expected: str = ""

    def text(self, command: str) -> str:
        """Return the closing lines for a user. command: how the capture would be reconstructed."""
        if self.faults:
            listed = "\n".join(f"  - {fault}" for fault in self.faults)
            return f"Do not reconstruct it as it is:\n{listed}\nTo try it all the same, run\n  {command}"
        return f"It can be reconstructed, {self.expected}. Run\n  {command}"


def judge(coverage: Coverage, misfits: list[str]) -> Verdict:
    """Judge a capture by its coverage. misfits: names of the cameras whose poses do not fit each other."""
    faults = []
    if misfits:
        faults.append(f"the poses or lenses of {', '.join(misfits)} do not fit each other: calibrate again")
    faults += [
        f"{one} and {other} have the same pose: correct one of the two, or leave that camera out"
        for one, other in coverage.twins
    ]
    typical = float(np.median(coverage.shared))
    if typical >= FEWEST_SHARED:
        faults += [
            f"{name} has {count} points in common with two other cameras, where {typical:.0f} are usual here: check its pose and its "
            f"video, or leave it out"
            for name, count in zip(coverage.names, coverage.shared, strict=True)
            if count < UNCONFIRMED
        ]
    elif not _tried_well(coverage):
        faults.append(
            f"the pictures do not confirm the poses: half of the cameras have {typical:.0f} points or fewer in common with two others. "
            f"The poses are wrong, or the cameras show too little in common: check the calibration, or add cameras in between"
        )
    return Verdict(faults, "" if faults else _expected(coverage))


def _tried_well(coverage: Coverage) -> bool:
    """Return whether the trial alone shows that the poses fit the pictures."""
    trial = coverage.trial
    return trial is not None and trial.holds and rating(trial.psnr) != "poor"


def _expected(coverage: Coverage) -> str:
    trial = coverage.trial
    if trial is None:
        return "but new views were not tried"
    if not trial.holds:
        return f"but only views within {coverage.angle:.0f} degrees of a camera will be usable"
    word = rating(trial.psnr)
    but = "but" if word == "poor" else "and"
    return f"{but} new views between the cameras will be {word} (about {trial.psnr:.0f} dB)"
