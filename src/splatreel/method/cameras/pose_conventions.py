"""Recognition of poses that follow another convention than the required one (beyond the paper).

Some files hold camera-to-world matrices, or OpenGL's axes. Such matrices look like any others, but features of neighboring cameras then
lie off their epipolar lines, or behind the cameras. Cameras that show the same things, but not at the given poses, are told apart from
cameras that have too little in common.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.method.init.features import Features, epipolar_lines, line_distances, match
from splatreel.method.init.triangulate import intersect, neighbor_pairs
from splatreel.scene.camera import Camera

SEARCH_WIDTH, MATCH_PIXELS = 0.03, 0.7
"""Distance from epipolar lines within which features are matched, as a share of the image width; and their distance in pixels where
poses are right."""
FITS = 0.2
"""Share of the matches of nearest cameras that fit, above which the poses are believed."""
CLEAR_RATIO, FEWEST_MATCHES = 3.0, 60
"""Smallest number of fitting matches, as a multiple of those by chance and at the given poses, and as a count."""
SIMILAR, TOLERANCE, ENOUGH_MATCHES = 0.8, 1.0, 16
"""Largest ratio of the best to the second best descriptor distance; largest error in pixels; and matches that two images of the same
things have. One in eight pairs of images of different things has as many."""
Matches = dict[tuple[int, int], np.ndarray]
"""Indices of features [M, 2] by pairs of cameras."""

CONVENTIONS: dict[str, Callable[[list[Camera]], list[Camera]]] = {
    "camera to world": inverted,
    "world to camera in OpenGL's axes (y up, z backwards)": with_opengl_axes,
    "camera to world in OpenGL's axes (y up, z backwards)": lambda cameras: with_opengl_axes(inverted(cameras)),
}
"""Functions from the given cameras to the intended ones, by the convention of the file."""


def recognize_convention(cameras: list[Camera], features: list[Features], matches: Matches) -> str | None:
    """Return the name of the convention that the poses follow, if the features fit it and do not fit the required one.

    Args:
        cameras: Cameras at the given poses.
        features: Their features at one moment.
        matches: Matches of nearest cameras at the given poses.
    """
    said, _ = share_of_fitting(cameras, features, matches)
    if said > FITS:
        return None
    best, share, count = None, 0.0, 0
    for name, meant in CONVENTIONS.items():
        found, many = share_of_fitting(stood := meant(cameras), features, match_nearest(stood, features))
        if found > share:
            best, share, count = name, found, many
    chance = MATCH_PIXELS / (SEARCH_WIDTH * cameras[0].width)
    return (
        best
        if count >= FEWEST_MATCHES and share > CLEAR_RATIO * max(said, chance / 2) and share > 1.5 * chance
        else None
    )


def show_the_same(features: list[Features], pairs: list[tuple[int, int]]) -> bool:
    """Return True if most pairs of images show the same things, at any poses."""
    return 2 * sum(_images_match(features[i], features[j]) for i, j in pairs) > len(pairs)


def _images_match(a: Features, b: Features) -> bool:
    """Return True if mutual best matches fit some epipolar geometry."""
    if min(len(a.pixels), len(b.pixels)) < ENOUGH_MATCHES:
        return False
    similarity = a.descriptors @ b.descriptors.T
    rows, best = np.arange(len(similarity)), similarity.argmax(1)
    mutual, first = similarity.argmax(0)[best] == rows, similarity[rows, best]
    similarity[rows, best] = -1
    apart, next_apart = (np.sqrt(np.maximum(2 - 2 * alike, 0)) for alike in (first, similarity.max(1)))
    found = mutual & (apart < SIMILAR * next_apart)
    if found.sum() < ENOUGH_MATCHES:
        return False
    here, there = a.pixels[found], b.pixels[best[found]]
    fits = cv2.findFundamentalMat(here, there, cv2.USAC_MAGSAC, TOLERANCE, 0.999, 2000)[1]
    return fits is not None and int(fits.sum()) >= ENOUGH_MATCHES


def match_nearest(cameras: list[Camera], features: list[Features]) -> Matches:
    """Match the features of each camera and its nearest one."""
    return {
        (i, j): match(cameras[i], cameras[j], features[i], features[j], SEARCH_WIDTH * cameras[i].width)
        for i, j in neighbor_pairs(cameras, 1)
    }


def share_of_fitting(cameras: list[Camera], features: list[Features], matches: Matches) -> tuple[float, int]:
    """Return the share and the number of matches of nearest cameras that lie on epipolar lines and in front of both cameras."""
    total, fits = 0, 0
    for i, j in neighbor_pairs(cameras, 1):
        a, b, found = cameras[i], cameras[j], matches[i, j]
        there, here = features[j].pixels[found[:, 1]], features[i].pixels[found[:, 0]]
        near = np.abs(line_distances(epipolar_lines(a, b, here), there)) < MATCH_PIXELS
        total += len(found)
        fits += int(_in_front(a, b, here[near], there[near]).sum())
    return fits / max(total, 1), fits


def _in_front(a: Camera, b: Camera, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return [M] bool: which places, seen by two cameras at pixels [M, 2], are in front of both."""
    projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in (a, b)])
    count = len(here)
    both = np.tile(np.arange(2), count)
    pixels = np.stack([here, there], 1).reshape(-1, 2)
    places = intersect(projections[both], pixels, np.repeat(np.arange(count), 2), count)
    depths = [places @ c.viewmat[2, :3].astype(np.float64) + float(c.viewmat[2, 3]) for c in (a, b)]
    return (depths[0] > 0) & (depths[1] > 0)
