"""What a capture's poses may have been meant as, where they do not fit its pictures (beyond the paper).

Files hold camera to world where world to camera is asked for, or axes of OpenGL's. By themselves such matrices are as good as any; but
features of neighboring cameras then lie on no epipolar lines, or behind the cameras. Pictures that show the same, but not where poses
and lenses say, tell from those that show too little of what the others do.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.recon.init.features import Features, epipolar_lines, line_distances, match
from splatreel.recon.init.triangulate import intersect, neighbor_pairs
from splatreel.scene.camera import Camera

SEARCH_WIDTH, MATCH_PIXELS = 0.03, 0.7
"""How far off their lines features are looked for, of the picture's width; and how near they are where poses are right, pixels."""
FITS = 0.2
"""Share of the matches of nearest cameras that fit, from which on poses are taken as they are said to be."""
CLEAR_RATIO, FEWEST_MATCHES = 3.0, 60
"""Times as many matches that fit, against chance and against the poses as they are said to be; and how many of them, at least."""
SIMILAR, TOLERANCE, RELATED = 0.8, 1.0, 16
"""The second best match must be so much farther off, pixels off a line of whatever geometry, and how many matches then tell that two
pictures show the same: one in eight of those have as many that do not."""
Matches = dict[tuple[int, int], np.ndarray]
"""[M, 2] indices of features, by pairs of cameras."""

READINGS: dict[str, Callable[[list[Camera]], list[Camera]]] = {
    "camera to world": inverted,
    "world to camera in OpenGL's axes (y up, z backwards)": with_opengl_axes,
    "camera to world in OpenGL's axes (y up, z backwards)": lambda cameras: with_opengl_axes(inverted(cameras)),
}
"""By what the matrices are: the cameras that are meant."""


def misread(cameras: list[Camera], features: list[Features], matches: Matches) -> str | None:
    """What the poses are in truth, a name of `READINGS`, if the features of the cameras at a moment fit that and not what is said.

    matches: of nearest cameras, as they are said to stand.
    """
    said, _ = fitting(cameras, features, matches)
    if said > FITS:
        return None
    best, share, count = None, 0.0, 0
    for name, meant in READINGS.items():
        found, many = fitting(stood := meant(cameras), features, match_nearest(stood, features))
        if found > share:
            best, share, count = name, found, many
    chance = MATCH_PIXELS / (SEARCH_WIDTH * cameras[0].width)
    return (
        best
        if count >= FEWEST_MATCHES and share > CLEAR_RATIO * max(said, chance / 2) and share > 1.5 * chance
        else None
    )


def related(features: list[Features], pairs: list[tuple[int, int]]) -> bool:
    """Whether most pairs of pictures show the same things from somewhere, whatever is said of their cameras."""
    return 2 * sum(_show_the_same(features[i], features[j]) for i, j in pairs) > len(pairs)


def _show_the_same(a: Features, b: Features) -> bool:
    """Whether mutual best matches fit some epipolar geometry."""
    if min(len(a.pixels), len(b.pixels)) < RELATED:
        return False
    similarity = a.descriptors @ b.descriptors.T
    rows, best = np.arange(len(similarity)), similarity.argmax(1)
    mutual, first = similarity.argmax(0)[best] == rows, similarity[rows, best]
    similarity[rows, best] = -1
    apart, next_apart = (np.sqrt(np.maximum(2 - 2 * alike, 0)) for alike in (first, similarity.max(1)))
    found = mutual & (apart < SIMILAR * next_apart)
    if found.sum() < RELATED:
        return False
    here, there = a.pixels[found], b.pixels[best[found]]
    fits = cv2.findFundamentalMat(here, there, cv2.USAC_MAGSAC, TOLERANCE, 0.999, 2000)[1]
    return fits is not None and int(fits.sum()) >= RELATED


def match_nearest(cameras: list[Camera], features: list[Features]) -> Matches:
    """Of each camera and its nearest."""
    return {
        (i, j): match(cameras[i], cameras[j], features[i], features[j], SEARCH_WIDTH * cameras[i].width)
        for i, j in neighbor_pairs(cameras, 1)
    }


def fitting(cameras: list[Camera], features: list[Features], matches: Matches) -> tuple[float, int]:
    """Share of the matches of nearest cameras that lie on their epipolar lines and before both cameras, and how many do."""
    total, fits = 0, 0
    for i, j in neighbor_pairs(cameras, 1):
        a, b, found = cameras[i], cameras[j], matches[i, j]
        there, here = features[j].pixels[found[:, 1]], features[i].pixels[found[:, 0]]
        near = np.abs(line_distances(epipolar_lines(a, b, here), there)) < MATCH_PIXELS
        total += len(found)
        fits += int(_before(a, b, here[near], there[near]).sum())
    return fits / max(total, 1), fits


def _before(a: Camera, b: Camera, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """[M] bool: which places, seen by two cameras at pixels [M, 2], are before both."""
    projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in (a, b)])
    count = len(here)
    both = np.tile(np.arange(2), count)
    pixels = np.stack([here, there], 1).reshape(-1, 2)
    places = intersect(projections[both], pixels, np.repeat(np.arange(count), 2), count)
    depths = [places @ c.viewmat[2, :3].astype(np.float64) + float(c.viewmat[2, 3]) for c in (a, b)]
    return (depths[0] > 0) & (depths[1] > 0)
