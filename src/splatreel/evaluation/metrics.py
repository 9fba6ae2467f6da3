"""Image metrics of float images [H, W, 3], sRGB 0..1, over all pixels or those in a mask `where` [H, W] bool."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import correlate1d, uniform_filter1d

from splatreel.base.errors import UsageError
from splatreel.codec.manifest import Manifest

PSNR_MAX = 100.0
"""PSNR of two equal images. Infinity would break means and JSON."""

_SSIM_WINDOW = 11
_SSIM_SIGMA = 1.5
UNIFORM_WINDOW = 7


def psnr(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB over all pixels and channels. Raise `UsageError` if the shapes differ."""
    check_images(image, truth, where)
    return mean_decibel(squared_error(image, truth), where)


def psnr_per_channel(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    """Return the mean of the PSNR of each channel in dB, as in Dynamic 3D Gaussians. It is never below `psnr`."""
    check_images(image, truth, where)
    return mean_decibel_per_channel(squared_error(image, truth), where)


def psnr_color_fitted(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    """Return the PSNR in dB after the best gain for each channel, over the pixels that the gains are fitted to.

    Cameras differ in color by a gain for each channel (`Config.correct_colors`), and that of a held-out camera is unknown. This PSNR
    measures everything else. It is never below `psnr`.

    Raises:
        UsageError: The shapes differ.
    """
    return mean_decibel(squared_error(fit_colors(image, truth, where), truth), where)


def fit_colors(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> np.ndarray:
    """Return the image times the gain of each channel that minimizes the squared error over some pixels, clipped to 0..1."""
    check_images(image, truth, where)
    x, y = (np.reshape(i if where is None else i[where], (-1, 3)).astype(np.float64) for i in (image, truth))
    power = (x * x).sum(0)
    gains = np.where(power > 0, (x * y).sum(0) / np.where(power > 0, power, 1), 1.0)
    return np.clip(image * gains, 0, 1)


def ssim(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    """Return the structural similarity with an 11x11 Gaussian window of sigma 1.5, averaged over pixels and channels.

    Borders are padded with zeros as in the 3DGS code, which makes the values comparable. With a mask, windows reach
    beyond it.

    Raises:
        UsageError: The shapes differ.
    """
    check_images(image, truth, where)
    similarity = gaussian_moments(image, truth).similarity(1.0)
    return float(np.mean(similarity if where is None else similarity[where]))


def ssim_skimage(
    image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None, data_range: float = 1.0
) -> float | None:
    """Return the structural similarity as scikit-image computes it by default.

    The window is a uniform square of 7x7 pixels, variances are those of a sample, and windows that cross the border do not
    count. With a mask, windows reach beyond it.

    Args:
        image: Image to measure.
        truth: Image to compare with.
        where: Pixels to measure; None means all.
        data_range: Range of values that the constants of SSIM assume: 1 for these images, 2 for DSSIM2.

    Returns:
        The similarity, or None if no window lies inside the image around a pixel to measure.

    Raises:
        UsageError: The shapes differ.
    """
    check_images(image, truth, where)
    if min(image.shape[:2]) < UNIFORM_WINDOW:
        return None
    return mean_inside(uniform_moments(image, truth).similarity(data_range), where)


def mean_inside(similarity: np.ndarray, where: np.ndarray | None) -> float | None:
    """Return the mean of a map [H, W, 3] over the pixels whose uniform window lies inside the image; None if there are none."""
    inside = (slice(UNIFORM_WINDOW // 2, -(UNIFORM_WINDOW // 2)),) * 2
    if where is not None and not where[inside].any():
        return None
    return float(np.mean(similarity[inside] if where is None else similarity[inside][where[inside]]))


def dssim(similarity: float | None) -> float | None:
    """Return the structural dissimilarity (1 - SSIM) / 2. DSSIM1 and DSSIM2 use skimage's SSIM with a data range of 1 and 2."""
    return None if similarity is None else (1 - similarity) / 2


Mean = Callable[[np.ndarray], np.ndarray]
"""Function that returns the mean of the window around each pixel."""


@dataclass(frozen=True)
class Moments:
    """Means, variances and covariance of two images in the window around each pixel, each [H, W, 3]."""

    mean_x: np.ndarray
    mean_y: np.ndarray
    var_x: np.ndarray
    var_y: np.ndarray
    covariance: np.ndarray

    @staticmethod
    def of(x: np.ndarray, y: np.ndarray, mean: Mean, correction: float) -> Moments:
        """Measure two images. `correction` multiplies variances, as of a sample."""
        mean_x, mean_y = mean(x), mean(y)
        var_x = correction * (mean(x * x) - mean_x**2)
        var_y = correction * (mean(y * y) - mean_y**2)
        return Moments(mean_x, mean_y, var_x, var_y, correction * (mean(x * y) - mean_x * mean_y))

    def similarity(self, data_range: float) -> np.ndarray:
        """Return the structural similarity of each pixel and channel, with the constants of a range of values."""
        c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
        above = (2 * self.mean_x * self.mean_y + c1) * (2 * self.covariance + c2)
        below = (self.mean_x**2 + self.mean_y**2 + c1) * (self.var_x + self.var_y + c2)
        return above / below


def gaussian_moments(image: np.ndarray, truth: np.ndarray) -> Moments:
    """Return the moments in the Gaussian windows of `ssim`."""
    return Moments.of(image.astype(np.float32), truth.astype(np.float32), _gaussian_mean, 1.0)


def uniform_moments(image: np.ndarray, truth: np.ndarray) -> Moments:
    """Return the moments in the uniform windows of `ssim_skimage`."""
    count = UNIFORM_WINDOW**2
    return Moments.of(image.astype(np.float64), truth.astype(np.float64), _uniform_mean, count / (count - 1))


def _gaussian_mean(image: np.ndarray) -> np.ndarray:
    offsets = np.arange(_SSIM_WINDOW) - _SSIM_WINDOW // 2
    window = np.exp(-(offsets**2) / (2 * _SSIM_SIGMA**2))
    window /= window.sum()
    rows = correlate1d(image, window, axis=0, mode="constant")
    return correlate1d(rows, window, axis=1, mode="constant")


def _uniform_mean(image: np.ndarray) -> np.ndarray:
    return uniform_filter1d(uniform_filter1d(image, UNIFORM_WINDOW, axis=0), UNIFORM_WINDOW, axis=1)


def squared_error(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the squared error of each pixel and channel, [H, W, 3] float64."""
    return (image.astype(np.float64) - truth.astype(np.float64)) ** 2


def mean_decibel(error: np.ndarray, where: np.ndarray | None) -> float:
    """Return the PSNR of a map of squared errors [H, W, 3], over all pixels or those in a mask."""
    return _decibel(float(np.mean(error if where is None else error[where])))


def mean_decibel_per_channel(error: np.ndarray, where: np.ndarray | None) -> float:
    """Return the mean over channels of the PSNR of a map of squared errors [H, W, 3]."""
    means = np.mean((error if where is None else error[where]).reshape(-1, 3), axis=0)
    return float(np.mean([_decibel(float(mean)) for mean in means]))


def check_images(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None) -> None:
    """Raise `UsageError` unless two float images have the same shape [H, W, 3], and a mask chooses some of their pixels."""
    if image.shape != truth.shape or image.ndim != 3 or image.shape[-1] != 3:
        raise UsageError(
            f"An image of shape {image.shape} cannot be compared with one of {truth.shape}; give [H, W, 3]."
        )
    if image.dtype.kind != "f" or truth.dtype.kind != "f":
        raise UsageError(f"Images of {image.dtype} and {truth.dtype} cannot be compared; divide by 255 to floats 0..1.")
    if where is not None and (where.shape != image.shape[:2] or where.dtype != bool or not where.any()):
        raise UsageError(
            f"A mask of {where.dtype} and shape {where.shape} with {int(where.sum())} pixels does not choose pixels of an "
            f"image of shape {image.shape}; give bool {image.shape[:2]} with one pixel at least."
        )


def _decibel(mean_squared_error: float) -> float:
    floor = 10 ** (-PSNR_MAX / 10)
    return -10 * math.log10(max(mean_squared_error, floor))


class Flicker:
    """Flicker of images added in order of frames.

    Attributes:
        borders: Frames that fade from one group to the next.
    """

    def __init__(self, borders: set[int]) -> None:
        self.borders = borders
        self.steps: dict[tuple[int, str], float] = {}
        self._last: dict[str, tuple[int, np.ndarray]] = {}

    def add(self, frame: int, camera: str, image: np.ndarray, truth: np.ndarray) -> None:
        """Add an image and its truth, float32 [H, W, 3] 0..1. Without the previous frame nothing is measured."""
        off = image - truth
        before, there = self._last.get(camera, (None, off))
        if before == frame - 1:
            self.steps[frame, camera] = 255 * float(np.abs(off - there).mean())
        self._last[camera] = frame, off

    def mean(self, at_borders: bool) -> float | None:
        """Return the mean absolute error of the changes in gray levels of 255, at borders or elsewhere; None without any."""
        values = [step for (frame, _), step in self.steps.items() if (frame in self.borders) == at_borders]
        return float(np.mean(values)) if values else None


def border_frames(manifest: Manifest) -> set[int]:
    """Return the frames reached by a step of a cross-fade, or by the cut between groups without overlap."""
    steps = range(1, manifest.overlap + 1) if manifest.overlap else range(1)
    return {group.first_frame + step for group in manifest.groups[1:] for step in steps}
