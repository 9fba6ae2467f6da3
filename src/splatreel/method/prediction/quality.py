"""Measures of how well cameras cover a scene, the quality of novel views to expect, and the verdict of `capture check`.

Masks of a subject confirm poses as shared points do (`Silhouettes`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from splatreel.base.progress import Progress, listed
from splatreel.base.untrusted import is_number, numbers
from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.mask_shares import EMPTY, LARGE, mask_shares
from splatreel.capture.masks import LIKELY
from splatreel.method.init.layout import LEAST_DEGREES, clearance_of
from splatreel.method.init.triangulate import Tracks, triangulate
from splatreel.method.init.visual_hull import VisualHull
from splatreel.method.prediction.trial import Trial, leave_one_out, narrow_camera, resize_image
from splatreel.scene.camera import Camera, angles_apart, focus_point

MARKS = "20 dB is poor, 30 dB is good, 40 dB is hardly distinguishable"
SCALE = f"PSNR measures how close images are to the camera's: {MARKS}."
FAIR, GOOD, EXCELLENT = 24.0, 28.0, 38.0
"""Smallest PSNR in dB of fair, good and very good images. Below the first they are poor."""
WIDTH = 480
"""Largest width in pixels of the images that shared points are searched in."""
NEIGHBORS = 6
"""Number of nearest cameras that each camera is compared with."""
FEWEST_SHARED = 20
"""Number of points shared with two other cameras, below which a camera is named."""
SAME = 0.004
"""Distance below which two points are one, as a share of the scene's distance."""
TWIN_DEGREES, TWIN_SHARE = 0.01, 1e-4
"""Largest difference of two poses that are the same: degrees of rotation, and distance as a share of the scene's."""
UNCONFIRMED = 5
"""Number of points shared with two others, below which a pose is unconfirmed where most cameras share enough."""
SUBJECT_FITS = 2.0
"""Decibels by which the trial of a subject beats an image without reconstruction if the poses fit."""
MASKS_FIT = 0.9
"""Share of each camera's mask that the other masks must confirm if the poses fit."""
MASK_MISFIT, MASK_CONTRADICTS = 0.7, 0.5
"""Shares below which a camera is named because its mask does not fit the others, and below which no trial confirms the poses."""
NEAR = 20.0
"""Degrees between neighboring cameras, below which images with any detail have points in common if the poses are right."""
NAMED = 6
"""Number of cameras that a sentence names."""


def rating(psnr: float) -> str:
    """Return the word for a PSNR in dB: very good, good, fair or poor."""
    for least, word in ((EXCELLENT, "very good"), (GOOD, "good"), (FAIR, "fair")):
        if psnr >= least:
            return word
    return "poor"


GAIN_OF_DOUBLING = 0.6
"""Decibels, after a fit of colors, that a subject gains from twice as many cameras
(docs/experiments/2026-11-27-subjects-of-few-cameras.md)."""


def expected_gain(names: list[str], angles: Sequence[float] | np.ndarray) -> str:
    """Return sentences that say how many cameras more would bring how much to a subject.

    `angles`: degrees to the nearest other camera.
    """
    count, more = len(names), max(1, len(names) // 3)
    gain = GAIN_OF_DOUBLING * float(np.log2((count + more) / count))
    cameras, gaps = ("One more camera", "gap") if more == 1 else (f"{more} more cameras", "gaps")
    widest = ", ".join(names[place] for place in np.argsort(-np.array(angles), kind="stable")[:more])
    apart = f"The cameras are {np.median(angles):.0f} degrees apart."
    best = f"and twice as many cameras about {GAIN_OF_DOUBLING:.1f} dB"
    return f"{apart} {cameras} in the largest {gaps} (beside {widest}) would bring about {gain:.1f} dB, {best}."


@dataclass(frozen=True)
class Coverage:
    """Coverage of the scene by the training cameras.

    Attributes:
        angles: Degrees from each camera to the nearest other one, seen from the middle of the scene.
        shared: For each camera, the number of its points that at least two other cameras show.
        points: Number of points that at least three cameras show.
        twins: Pairs of names of cameras that have the same pose.
        pairs: Number of points in common of each two cameras, [C, C] int; None if a run's record gave the coverage.
        subject: True if the trial is about a subject that masks show.
        mask_fits: Share of each camera's mask that the other masks confirm, 0..1; None without masks.
        mask_doubt: Other poses that the masks fit as well or better, as the end of a sentence; empty if there are none. None if none
            were tried: without masks, where they do not fit, or where points tell enough.
        mask_share: Share of the images that the masks cover, 0..1, median of the cameras; None without masks.
    """

    names: list[str]
    angles: list[float]
    shared: list[int]
    points: int
    trial: Trial | None = None
    twins: list[list[str]] = field(default_factory=list)
    pairs: np.ndarray | None = field(default=None, compare=False)
    subject: bool = False
    mask_fits: list[float] | None = None
    mask_doubt: str | None = None
    mask_share: float | None = None

    @property
    def masks_fit(self) -> bool:
        """True if the masks of all cameras confirm each other's poses: they fit, and would not fit at wrong poses."""
        return _masks_agree(self.mask_fits) and self.mask_doubt == "" and not self.is_mostly_masked

    @property
    def is_mostly_masked(self) -> bool:
        """True if masks cover most of the images, so that they fit each other at any poses."""
        return self.mask_share is not None and self.mask_share > LARGE

    def misfitting(self, least: float) -> str:
        """Return the names of cameras whose masks fit the others less than a share, with that share; empty if there are none."""
        pairs = zip(self.names, self.mask_fits or [], strict=False)
        return listed([f"{name} ({fit:.0%})" for name, fit in pairs if 0 < fit < least])

    @property
    def angle(self) -> float | None:
        """Degrees from a camera within which novel views hold, where the trial of a whole scene failed; None for all others."""
        if self.trial is None or self.trial.holds or self.subject:
            return None
        return round(min(LEAST_DEGREES, self.trial.angle / 2), 2)

    def sentences(self) -> list[str]:
        """Return sentences that describe the coverage."""
        far, few = int(np.argmax(self.angles)), [c for c, count in enumerate(self.shared) if count < FEWEST_SHARED]
        least, most = f"{min(self.angles):.0f}", f"{max(self.angles):.0f}"
        sentences = [
            f"cameras are {least if least == most else f'{least} to {most}'} degrees from the nearest other one, seen from the middle "
            f"of the scene ({self.names[far]} is the farthest)",
            f"{self.points:,} {'point is' if self.points == 1 else 'points are'} seen by three or more cameras, and each camera "
            f"sees {min(self.shared):,} to {max(self.shared):,} of them",
        ]
        if few:
            some = ", ".join(f"{self.names[c]} ({self.shared[c]})" for c in few[:NAMED])
            more = f" and {len(few) - NAMED} more" if len(few) > NAMED else ""
            sentences.append(f"hardly any points in common with two other cameras: {some}{more}")
        sentences += [f"{one} and {other} have the same pose" for one, other in self.twins]
        if self.masks_fit:
            sentences.append(
                f"the poses are confirmed by the masks: those of all cameras fit each other, and would not if a camera were turned by "
                f"{TURN:.0f} degrees or two were exchanged"
            )
        sentences += [
            f"the mask of {name} does not fit those of the other cameras ({fit:.0%} of it does): look at it, and at the pose"
            for name, fit in zip(self.names, self.mask_fits or [], strict=False)
            if 0 < fit < MASK_MISFIT
        ]
        return sentences + self._trial_sentences()

    def _trial_sentences(self) -> list[str]:
        """Return sentences about the result of the trial."""
        if self.trial is None:
            return []
        trial = self.trial
        views = "novel views of the subject" if self.subject else "novel views"
        what = "Quick trial of the subject" if self.subject else "Quick trial"
        tried = f"{what} without {trial.camera}, {trial.angle:.0f} degrees from the nearest other camera: {trial.psnr:.1f} dB"
        without = f"the nearest camera's image has {trial.nearest:.1f} dB there, one flat color {trial.flat:.1f} dB"
        remedy = (
            expected_gain(self.names, self.angles)
            if self.subject
            else "Set the cameras closer together, or add some between them."
        )
        if not trial.holds and self.subject:
            return [
                f"{tried}, hardly better than no reconstruction ({without}): expect a blur between the cameras. {remedy}"
            ]
        if not trial.holds:
            return [
                f"{tried}, hardly better than no reconstruction ({without}): {views} more than {self.angle:.0f} degrees from "
                f"a camera will not be usable. {remedy}"
            ]
        word = rating(trial.psnr)
        found = (
            f"{tried} ({without}). Expect {views} between the cameras to be {word}, about {trial.psnr:.0f} dB: {MARKS}."
        )
        return [f"{found} {remedy}" if word == "poor" else found]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without `pairs`."""
        return {name: value for name, value in asdict(self).items() if name != "pairs"}

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Coverage:
        """Return the coverage from plain data. Other data raise an AttributeError, KeyError, TypeError or ValueError."""
        plain = dict(value)
        trial = plain.pop("trial", None)
        names = plain["names"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise TypeError("names are not a list of texts")
        for field_name in ("angles", "shared"):
            numbers(plain[field_name], len(names))
        if not all(isinstance(name, str) for pair in plain.get("twins", []) for name in pair):
            raise TypeError("twins are not names")
        if trial is not None and not all(is_number(trial[name]) for name in ("angle", "psnr", "flat", "nearest")):
            raise TypeError("the trial holds a value that is not a number")
        if (fits := plain.get("mask_fits")) is not None:
            numbers(fits, len(names))
        if not isinstance(plain.get("mask_doubt", ""), str | None):
            raise TypeError("mask_doubt is not a text")
        if (share := plain.get("mask_share")) is not None and not is_number(share):
            raise TypeError("mask_share is not a number")
        return Coverage(**plain, trial=None if trial is None else Trial(**trial))


def cover(
    cameras: list[Camera],
    images: np.ndarray,
    *,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    with_trial: bool = True,
    progress: Progress,
    alpha: np.ndarray | None = None,
) -> Coverage:
    """Measure how well cameras cover what they show at one moment.

    `points` are the capture's sparse points, if any. `with_trial` leaves a camera out and predicts its view. `alpha`
    [M, C, H, W] is the subject's opacity at that moment and at others; None for the whole scene.
    """
    small = [narrow_camera(camera, WIDTH) for camera in cameras]
    progress.stage("matching points that several cameras show", len(cameras))
    shown = np.stack([resize_image(image, camera) for image, camera in zip(images, small, strict=True)])
    tracks = triangulate(small, shown, NEIGHBORS)
    progress.update(len(cameras))
    seen = tracks.points if points is None else np.asarray(points, np.float64)
    focus = np.array(clearance_of(cameras, seen).focus) if len(seen) >= FEWEST_SHARED else focus_point(cameras)
    trial = None
    if with_trial:
        given, subject = (points, point_colors, near), None if alpha is None else alpha[0]
        trial = leave_one_out(cameras, shown, focus, *given, progress, subject)
    distance = float(np.median([np.linalg.norm(camera.center - focus) for camera in cameras]))
    seen_by = _places(tracks, distance)
    fits, doubt = None, None
    if alpha is not None:
        silhouettes = Silhouettes(cameras, alpha, focus, near or 0.0)
        fits = silhouettes.fits
        if np.median(seen_by.sum(0)) < FEWEST_SHARED and _masks_agree(fits):
            doubt = silhouettes.wrong_poses_that_fit()
    return Coverage(
        [camera.name for camera in cameras],
        [round(float(angle), 2) for angle in angles_apart(cameras, focus).min(1)],
        [int(count) for count in seen_by.sum(0)],
        len(seen_by),
        trial,
        _twins(cameras, distance),
        seen_by.T.astype(np.int64) @ seen_by,
        alpha is not None,
        fits,
        doubt,
        None if alpha is None else float(np.median(mask_shares(alpha[0]))),
    )


def _masks_agree(fits: list[float] | None) -> bool:
    """Return True if the masks of all cameras fit each other."""
    return fits is not None and min(fits) >= MASKS_FIT


def _places(tracks: Tracks, distance: float) -> np.ndarray:
    """Return [P, C] bool: which cameras show each place. Points of several cameras at one place are one."""
    cells = np.floor(tracks.points / (SAME * distance)).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    index = index.reshape(-1)
    seen = np.zeros((int(index.max(initial=-1)) + 1, tracks.seen.shape[1]), bool)
    np.logical_or.at(seen, index, tracks.seen)
    return seen


def _twins(cameras: list[Camera], distance: float) -> list[list[str]]:
    """Return pairs of names of cameras that have the same pose. `distance` is that of the scene in world units."""
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    turns = np.stack([camera.viewmat[:3, :3] for camera in cameras]).astype(np.float64)
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    apart = np.linalg.norm(turns[:, None] - turns[None], axis=(2, 3)) / np.sqrt(2)  # radians, for small angles
    same = (gaps < TWIN_SHARE * distance) & (apart < np.radians(TWIN_DEGREES))
    return [[cameras[i].name, cameras[j].name] for i, j in zip(*np.nonzero(np.triu(same, 1)), strict=True)]


@dataclass(frozen=True)
class CaptureVerdict:
    """Result of a check.

    Attributes:
        faults: What is wrong and must be corrected before reconstructing.
        expected: Quality of novel views to expect.
        unconfirmed: Sentences that say why nothing confirms the poses; empty if something does, or if they are wrong.
        needs_masks: True if masks may confirm them.
    """

    faults: list[str]
    expected: str = ""
    unconfirmed: str = ""
    needs_masks: bool = False

    def text(self, command: str, with_masks: Sequence[str] = ()) -> str:
        """Return the closing lines of the check.

        Args:
            command: Command that reconstructs the capture.
            with_masks: Commands that make masks and check the capture with them.
        """
        if self.faults:
            lines = "\n".join(f"  - {fault}" for fault in self.faults)
            return f"Do not reconstruct it as it is:\n{lines}\nTo try anyway, run\n  {command}"
        if not self.unconfirmed:
            return f"It can be reconstructed, {self.expected}. Run\n  {command}"
        lines = [f"It can be read, but {self.unconfirmed}"]
        if self.needs_masks:
            lines += ["Make masks, then check with --masks:", *(f"  {one}" for one in with_masks)]
        return "\n".join([*lines, "To reconstruct it as it is, run", f"  {command}"])


def judge_capture(coverage: Coverage, misfits: list[str]) -> CaptureVerdict:
    """Judge a capture by its coverage, and by the names of cameras whose poses do not fit each other."""
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
    poses = judge_poses(coverage)
    faults += poses.faults
    return poses if not faults else CaptureVerdict(faults)


def judge_poses(coverage: Coverage) -> CaptureVerdict:
    """Judge whether points, the trial or masks confirm the poses, and whether masks contradict each other.

    Cameras far apart share no points, whatever their poses. Such poses are unconfirmed, and not called wrong.
    """
    expected, typical = _expectation(coverage), float(np.median(coverage.shared))
    if coverage.mask_share is not None and coverage.mask_share < EMPTY:
        return CaptureVerdict(["the masks are black: they show no subject. Make them again, or leave out --masks"])
    if typical >= FEWEST_SHARED or coverage.masks_fit or _trial_confirms_poses(coverage):
        if apart := coverage.misfitting(MASK_CONTRADICTS):
            wrong = "Other evidence confirms the poses, so the masks are wrong: of another capture, shifted, or of other frames?"
            return CaptureVerdict([f"{_CONTRADICT} {apart}. {wrong} Correct them, or make them again"])
        return CaptureVerdict([], expected)
    if apart := coverage.misfitting(MASK_MISFIT):
        remedy = (
            "The masks or the poses are wrong: look at the masks (--page). If they show the subject, calibrate again"
        )
        return CaptureVerdict([f"{_CONTRADICT} {apart}. {remedy}"])
    few = f"{typical:.0f} point{'s' * (typical >= 1.5)} or fewer" if typical >= 1 else "no points"
    common = f"half of the cameras have {few} in common with two others"
    if coverage.mask_fits is None and (apart_by := float(np.median(coverage.angles))) < NEAR:
        near = f"though they are only {apart_by:.0f} degrees apart"
        remedy = "The poses are wrong, or the images show too little detail: check the calibration"
        return CaptureVerdict([f"the images do not confirm the poses: {common}, {near}. {remedy}"])
    masks = f". {_why_masks_confirm_nothing(coverage)}" if coverage.mask_fits else "."
    unconfirmed = f"the poses cannot be confirmed by images this far apart: {common}{masks}"
    return CaptureVerdict([], expected, unconfirmed, coverage.mask_fits is None)


_CONTRADICT = "masks contradict each other. Only a part of these masks fits those of the other cameras:"


def _why_masks_confirm_nothing(coverage: Coverage) -> str:
    fits = dict(zip(coverage.names, coverage.mask_fits or [], strict=False))
    if coverage.is_mostly_masked:
        return (
            f"Nor do the masks confirm them: they cover {coverage.mask_share:.0%} of the images, and large masks fit at any poses. Are "
            f"they inverted, or white everywhere?"
        )
    if blank := [name for name, fit in fits.items() if not fit]:
        return f"Nor do the masks confirm them: those of {', '.join(blank)} hardly show the subject."
    if coverage.mask_doubt:
        return f"Nor do the masks confirm them: they would fit {coverage.mask_doubt}."
    if apart := coverage.misfitting(MASKS_FIT):
        return f"Nor do the masks confirm them: {apart} fit the others in part only. Look at these masks, and at the poses."
    return "Nor do the masks confirm them: whether they would fit other poses as well was not tried."


def _trial_confirms_poses(coverage: Coverage) -> bool:
    """Return True if the trial alone shows that the poses fit the images."""
    trial = coverage.trial
    if trial is None or not trial.holds:
        return False
    if coverage.misfitting(MASK_CONTRADICTS):
        return False
    # Cameras far apart share hardly any points, whatever their poses. Silhouettes that fit make a subject.
    is_small = coverage.subject and not coverage.is_mostly_masked
    return trial.psnr > max(trial.flat, trial.nearest) + SUBJECT_FITS if is_small else rating(trial.psnr) != "poor"


def _expectation(coverage: Coverage) -> str:
    trial = coverage.trial
    if coverage.is_mostly_masked:
        return f"but the masks cover {coverage.mask_share:.0%} of the images: are they inverted?"
    if trial is None:
        return "but no trial of novel views was made"
    if not trial.holds and coverage.subject:
        return f"but the subject will be a blur between the cameras. {expected_gain(coverage.names, coverage.angles)}".removesuffix(
            "."
        )
    if not trial.holds:
        near = f"but only views within {coverage.angle:.0f} degrees of a camera will be usable"
        return f"{near}; a person alone holds further between the cameras (--masks auto)"
    word = rating(trial.psnr)
    but = "but" if word == "poor" else "and"
    views = "novel views of the subject" if coverage.subject else "novel views"
    return f"{but} {views} between the cameras will be {word} (about {trial.psnr:.0f} dB)"


RAYS, STEPS = 200, 64
"""Number of pixels of each mask that are examined, and of places on the ray of each."""
SMALLEST = 0.1
"""Smallest size of a mask, as a share of the median. With a wrong pose, masks without weights keep only a small part that fits."""
NO_FIT = 0.001
"""Fit of a mask of which nothing fits the others."""
NEAREST, FARTHEST = 0.1, 1.9
"""Ends of the rays, as shares of the camera's distance from the focus."""
TURN = 7.0
"""Degrees by which a camera is turned to get a wrong pose."""
CLEAR = 0.1
"""Smallest difference between the share of a mask that fits and the one that fits at a wrong pose
(docs/experiments/2026-11-28-poses-confirmed-by-masks.md)."""
NEARER, BETTER = 0.2, 0.01
"""Share of its distance by which a camera is moved towards the focus and away from it, and by how much more of the masks then fits
on average if its pose is wrong. Masks hardly fit less if it is right."""


@dataclass(frozen=True)
class _WrongPoses:
    """Poses that are not the given ones.

    Attributes:
        text: The end of a sentence that says what is wrong.
        changed: Numbers of the cameras whose poses differ.
        order: For each camera, the number of its masks.
    """

    text: str
    changed: list[int]
    cameras: list[Camera]
    order: list[int]


class Silhouettes:
    """Masks [M, C, H, W] of a subject at M moments, whose fit to each other is measured at the given poses and at wrong ones.

    The mask of each camera must fit the visual hull of the others. Large masks fit at any poses. So masks confirm poses only if
    they would not fit at wrong ones.
    """

    def __init__(self, cameras: Sequence[Camera], masks: np.ndarray, focus: np.ndarray, near: float) -> None:
        self._cameras = list(cameras)
        self._focus, self._near = focus, near
        sizes = (masks >= LIKELY).sum((2, 3))
        self._usable = sizes > SMALLEST * np.median(sizes, 1, keepdims=True)
        self._hulls = [VisualHull(self._cameras, moment, near) for moment in masks]
        self._pixels = [[_chosen_pixels(mask) for mask in moment] for moment in masks]
        given = list(range(len(self._cameras)))
        self._given = [self._fits(self._cameras, given, c) for c in given]

    @property
    def fits(self) -> list[float]:
        """Share of each camera's mask, 0..1, whose pixels show a place within the hull of the other masks, on average of the moments.

        With right poses it is 1 but for errors of the masks. One pose that is wrong by ten degrees has 0.4 to 0.8 in the worst camera.
        A mask smaller than `SMALLEST` of the median confirms nothing and has 0. So has each of fewer than three: two masks fit for
        most poses. Other masks have at least `NO_FIT`.
        """
        if len(self._cameras) < MIN_CAMERAS:
            return [0.0] * len(self._cameras)
        return [max(float(np.nanmean(fit)), NO_FIT) if not np.isnan(fit).all() else 0.0 for fit in self._given]

    def wrong_poses_that_fit(self) -> str:
        """Return poses that fit the masks as well as the given ones, as the end of a sentence; an empty text if there are none."""
        for wrong in self._wrong_poses():
            others = [c for c in range(len(self._cameras)) if c not in wrong.changed]
            if not any(self._is_worse(wrong, c) for c in [*wrong.changed, *others]):
                return f"as well if {wrong.text}"
        return next((f"better if {moved.text}" for moved in self._moved() if self._is_better(moved)), "")

    def _is_better(self, moved: _WrongPoses) -> bool:
        """Return True if more of the masks fits at other poses."""
        fits = [self._fits(moved.cameras, moved.order, c) for c in moved.order]
        return bool(np.nanmean(fits) > np.nanmean(self._given) + BETTER)

    def _is_worse(self, wrong: _WrongPoses, c: int) -> bool:
        """Return True if the mask of a camera fits clearly less at wrong poses, at one moment."""
        drops = self._given[c] - self._fits(wrong.cameras, wrong.order, c)
        return bool((drops >= CLEAR).any())

    def _wrong_poses(self) -> Iterator[_WrongPoses]:
        given = list(range(len(self._cameras)))
        for c, camera in enumerate(self._cameras):
            for yaw, pitch in ((TURN, 0), (-TURN, 0), (0, TURN), (0, -TURN)):
                cameras = [*self._cameras[:c], _turned(camera, yaw, pitch), *self._cameras[c + 1 :]]
                yield _WrongPoses(f"{camera.name} were turned by {TURN:.0f} degrees", [c], cameras, given)
        for c, camera in enumerate(self._cameras):
            for other in range(c):
                order = given.copy()
                order[c], order[other] = other, c
                names = f"{self._cameras[other].name} and {camera.name}"
                yield _WrongPoses(f"{names} were exchanged", [c, other], self._cameras, order)

    def _moved(self) -> Iterator[_WrongPoses]:
        """Yield poses at which one camera is nearer to the focus, or farther away."""
        for c, camera in enumerate(self._cameras):
            depth = camera.viewmat[2, :3] @ self._focus + camera.viewmat[2, 3]
            for share, word in ((NEARER, "farther away"), (-NEARER, "nearer")):
                viewmat = camera.viewmat.copy()
                viewmat[2, 3] += share * depth
                cameras = [*self._cameras[:c], replace(camera, viewmat=viewmat), *self._cameras[c + 1 :]]
                yield _WrongPoses(f"{camera.name} were {NEARER:.0%} {word}", [c], cameras, list(range(len(cameras))))

    def _fits(self, cameras: list[Camera], order: list[int], c: int) -> np.ndarray:
        """Return the share [M] of a camera's mask that fits the others at each moment, NaN where it is small."""
        found = np.full(len(self._hulls), np.nan)
        others = [other for other in range(len(cameras)) if other != c]
        for moment, hull in enumerate(self._hulls):
            if self._usable[moment, order[c]]:
                places = self._places(cameras[c], self._pixels[moment][order[c]])
                inside = hull.of([cameras[k] for k in others], [order[k] for k in others]).contains(places)
                found[moment] = inside.any(1).mean()
        return found

    def _places(self, camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """Return places [R, STEPS, 3] on the rays of pixels [R, 3]."""
        directions = pixels @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
        distance = float(np.linalg.norm(camera.center - self._focus))
        depths = np.linspace(max(self._near, NEAREST * distance), FARTHEST * distance, STEPS)
        return camera.center + directions[:, None] * depths[:, None]


def _chosen_pixels(mask: np.ndarray) -> np.ndarray:
    """Return the middles [R, 3] of pixels of a mask [H, W] uint8, homogeneous."""
    rows, columns = np.nonzero(mask >= LIKELY)
    chosen = np.linspace(0, len(rows) - 1, min(RAYS, len(rows))).round().astype(int)
    return np.stack([columns[chosen] + 0.5, rows[chosen] + 0.5, np.ones(len(chosen))], -1)


def _turned(camera: Camera, yaw: float, pitch: float) -> Camera:
    """Return a camera that is turned by degrees around its vertical and its horizontal axis."""
    a, b = np.radians(yaw), np.radians(pitch)
    turn = np.eye(4)
    turn[:3, :3] = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]) @ np.array(
        [[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]
    )
    return replace(camera, viewmat=turn @ camera.viewmat)
