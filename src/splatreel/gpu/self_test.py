"""A test of an opened GPU: a small drawing, whose results the kernels of the CPU know."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.gpu.device import Gpu
from splatreel.gpu.drawing import WHOLE, Drawing, fill_view, new_draw
from splatreel.kernels import binning, deform, project, rasterize

POINTS, WIDTH, HEIGHT, NEAR = 1500, 56, 40, 0.01
"""Size of the test: several tiles, one of them with more pairs than shared memory sorts, and sums over several workgroups."""
CLOSE = 2e-3
"""Largest difference of a color or an alpha, and largest relative difference of gradients."""


def check_device(gpu: Gpu) -> None:
    """Compare sums, order, picture and gradients of a scene with the CPU's.

    The scene has what drivers and compilers get wrong: thin splats, for which products cancel; tiles in which the threads of a
    subgroup leave the loop over splats at different ones; values outside of the image.

    Raises:
        GpuError: The device computes something else, or fails.
    """
    arrays = _points()
    count, K = len(arrays[0]), np.array([[50, 0, WIDTH / 2], [0, 50, HEIGHT / 2], [0, 0, 1]], np.float32)
    pose, rng = np.eye(4, dtype=np.float32), np.random.default_rng(1)
    slopes = rng.normal(size=(HEIGHT, WIDTH, 4)).astype(np.float32)

    no_offsets = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), np.zeros((0, 4), np.float32)
    view = project.Pinhole(pose, K, WIDTH, HEIGHT, NEAR, project.FINE_BLUR)
    opacities, seen = deform.forward(deform.DeformedPoints._make([*arrays, *no_offsets]), np.zeros(3, np.float32), view)
    bins = binning.bin_splats(seen.means2d, seen.conics, opacities, seen.depths, seen.radii, WIDTH, HEIGHT)
    image, alpha = rasterize.forward(bins, seen.colors)
    color_slopes, alpha_slopes = (np.ascontiguousarray(slopes[..., part]) for part in (slice(3), 3))
    expected = rasterize.backward(bins, seen.colors, image, color_slopes, alpha, alpha_slopes)

    drawing, draw = Drawing(gpu), new_draw()
    drawing.set_points(np.concatenate([array.reshape(count, -1).T for array in arrays]))
    drawing.set_size(WIDTH, HEIGHT)
    drawing.fit_pairs(len(bins.ids) + count)
    fill_view(draw, pose, K, WIDTH, HEIGHT, NEAR, antialias=True)
    draw["counts"] = count, arrays[5].shape[1], 0, drawing.capacity
    draw["numbers"][0] |= WHOLE
    gpu.write(drawing.buffers["draw"], draw)
    gpu.write(drawing.buffers["d_image"], slopes)
    recording, buffers = gpu.record(), drawing.alone()
    drawing.record_pairs(recording, buffers)
    drawing.record_image(recording, buffers)
    drawing.record_splat_gradients(recording, buffers)
    recording.submit()

    def fail(what: str) -> GpuError:
        return GpuError(f"{gpu.adapter.name}: a test of its {what} failed.")

    first = gpu.read(buffers["first"], np.uint32, (count + 1,))
    offsets = gpu.read(buffers["tile_offsets"], np.uint32, (len(bins.offsets),))
    if abs(int(first[-1]) - len(bins.ids)) > 0.01 * len(bins.ids) or first[-1] != offsets[-1]:
        raise fail("sums")
    keys = gpu.read(buffers["keys"], np.uint32, (int(first[-1]), 2))
    order = (keys[:, 0].astype(np.uint64) << np.uint64(32)) | keys[:, 1]
    starts = np.zeros(len(keys), bool)
    starts[offsets[:-1][offsets[:-1] < len(keys)]] = True
    if not np.all((order[1:] > order[:-1]) | starts[1:]):
        raise fail("order of splats")
    drawn = gpu.read(buffers["image"], np.float32, (HEIGHT, WIDTH, 4))
    if not np.allclose(drawn, np.dstack([image, alpha]), rtol=0, atol=CLOSE):
        raise fail("picture")
    found = gpu.read(buffers["d_splats"], np.float32, (count, 12))
    for columns, value in ((slice(0, 2), expected.means2d), (slice(6, 9), expected.colors)):
        if not np.linalg.norm(found[:, columns] - value) <= CLOSE * np.linalg.norm(value):
            raise fail("gradients")
    gpu.forget_buffers()


def _points() -> list[np.ndarray]:
    """Return means, quaternions, log scales, logits, base colors and higher SH bands of the scene, most of it in one tile."""
    rng = np.random.default_rng(0)
    means = rng.normal(0, 0.05, (POINTS, 3))
    means[::5, :2] *= 12
    means[:, 2] = rng.uniform(1, 4, POINTS)
    means[::50, 2] *= -1  # behind the camera
    scales = rng.normal(-4.5, 0.5, (POINTS, 3))
    scales[::7, 0] = 0.0  # long and thin
    arrays = (
        means,
        rng.normal(size=(POINTS, 4)),
        scales,
        rng.normal(-3.0, 1.0, POINTS),
        rng.normal(0, 1, (POINTS, 1, 3)),
        rng.normal(0, 0.2, (POINTS, 3, 3)),
    )
    return [np.ascontiguousarray(array, np.float32) for array in arrays]
