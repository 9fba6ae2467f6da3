"""Kernels of the GPU against those of the CPU: pairs, order, image, loss and gradients."""

import ctypes
from collections.abc import Callable

import numpy as np
import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu import drawing as drawing_module
from splatreel.gpu.device import Gpu
from splatreel.gpu.drawing import DRAW, WHOLE, Drawing, StaticScene, fill_view, new_draw
from splatreel.gpu.wgpu_device import WgpuGpu
from splatreel.kernels import binning, deform, photometric, project, rasterize
from tests.gpu.devices import DEVICES, emulated_gpu, software_adapter, software_gpu
from tests.gpu.emulated import emulated_libraries

NEAR, LAMBDA = 0.01, 0.2
GAIN = np.array([0.9, 1.0, 1.1], np.float32)
NONE = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), np.zeros((0, 4), np.float32)


def points(count: int, seed: int = 0, bands: int = 15, spread: float = 1.0) -> list[np.ndarray]:
    """Return means, quats, log scales, logits, base colors and higher SH bands."""
    rng = np.random.default_rng(seed)
    means = rng.normal(0, spread, (count, 3))
    means[:, 2] = rng.uniform(-0.5, 6, count)  # some behind the camera
    arrays = (
        means,
        rng.normal(size=(count, 4)),
        rng.normal(-3.0, 0.7, (count, 3)),
        rng.normal(0, 2, count),
        rng.normal(0, 1, (count, 1, 3)),
        rng.normal(0, 0.2, (count, bands, 3)),
    )
    return [np.ascontiguousarray(array, np.float32) for array in arrays]


SMALLEST = {
    "max-storage-buffers-per-shader-stage": 8,
    "max-compute-workgroup-storage-size": 16384,
    "max-storage-buffer-binding-size": 1 << 27,
    "max-buffer-size": 1 << 28,
    "max-compute-invocations-per-workgroup": 256,
    "max-compute-workgroup-size-x": 256,
}
"""Limits that every WebGPU device has."""


class Case:
    """A drawing on the GPU of points at one image size, and what the CPU computes for them."""

    def __init__(self, gpu: Gpu, arrays: list[np.ndarray], width: int, height: int, antialias: bool = True) -> None:
        self.gpu, self.arrays, self.size, count = gpu, arrays, (width, height), len(arrays[0])
        K = np.array([[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1]], np.float32)
        pose = np.eye(4, dtype=np.float32)
        self.drawing = drawing = Drawing(gpu)
        drawing.set_points(np.concatenate([array.reshape(count, int(np.prod(array.shape[1:]))).T for array in arrays]))
        drawing.set_size(width, height)
        drawing.fit_pairs(12 * count + 16)
        self.draw = draw = new_draw()
        fill_view(draw, pose, K, width, height, NEAR, antialias)
        draw["counts"] = count, arrays[5].shape[1], 0, drawing.capacity
        draw["numbers"][0] |= WHOLE
        draw["loss"][:2] = (1 - LAMBDA) / (3 * width * height), LAMBDA / (3 * width * height)
        gpu.write(drawing.buffers["draw"], draw)
        self.target = np.random.default_rng(1).integers(0, 256, (height, width, 4)).astype(np.uint8)
        self.target[..., 3] = 0
        self.buffers = drawing.alone() | {"targets": gpu.upload(self.target), "gains": gpu.upload(GAIN)}
        self.view = project.Pinhole(pose, K, width, height, NEAR, project.FINE_BLUR if antialias else project.BLUR)

    def run(self) -> None:
        recording = self.gpu.record()
        self.drawing.record_pairs(recording, self.buffers)
        self.drawing.record_image(recording, self.buffers)
        self.drawing.record_loss(recording, self.buffers)
        self.drawing.record_splat_gradients(recording, self.buffers)
        self.drawing.record_point_gradients(recording, self.buffers)
        recording.submit()

    def read(self, name: str, dtype: type, *shape: int) -> np.ndarray:
        return self.gpu.read(self.drawing.buffers[name], dtype, shape)

    def check(self, tolerance: float = 1e-4) -> None:
        """Compare everything that was computed with the CPU. tolerance: relative, of gradients."""
        (width, height), count = self.size, len(self.arrays[0])
        center = np.zeros(3, np.float32)
        moment = deform.DeformedPoints._make([*self.arrays, *NONE])
        opacities, seen = deform.forward(moment, center, self.view)
        bins = binning.bin_splats(seen.means2d, seen.conics, opacities, seen.depths, seen.radii, width, height)
        image, alpha = rasterize.forward(bins, seen.colors)
        target = np.ascontiguousarray(self.target[..., :3])
        loss = photometric.loss_and_gradient(image, target, LAMBDA, GAIN)
        nothing = np.zeros_like(alpha)
        slopes = rasterize.backward(bins, seen.colors, image, loss.d_image, alpha, nothing)
        expected = deform.backward(moment, seen, center, self.view, *slopes[:2], slopes.colors, slopes.opacities)

        first = self.read("first", np.uint32, count + 1)
        offsets = self.read("tile_offsets", np.uint32, len(bins.offsets))
        pairs = int(first[-1])
        assert abs(pairs - int(bins.first[-1])) <= 1e-3 * pairs  # rounding may move a border of a splat
        keys, owners = self.read("keys", np.uint32, pairs, 2), self.read("owners", np.uint32, pairs)
        for tile in range(len(offsets) - 1):
            ordered = keys[offsets[tile] : offsets[tile + 1]].astype(np.int64)
            assert np.all(np.diff(ordered[:, 0] * 2**32 + ordered[:, 1]) > 0)
        if pairs == bins.first[-1] and np.array_equal(offsets, bins.offsets):
            assert np.mean(owners[keys[:, 1]] != bins.ids) < 1e-2 if pairs else True
        drawn = self.read("image", np.float32, height, width, 4)
        np.testing.assert_allclose(drawn[..., :3], image, atol=2e-4)
        np.testing.assert_allclose(drawn[..., 3], alpha, atol=2e-4)
        close(self.read("d_image", np.float32, height, width, 4)[..., :3], loss.d_image, 1e-4)
        sums = self.read("sums", np.float32, len(offsets) - 1, 5).sum(0, dtype=np.float64)
        found = LAMBDA + (1 - LAMBDA) / image.size * sums[1] - LAMBDA / image.size * sums[0]
        assert found == pytest.approx(loss.loss, rel=1e-5)
        np.testing.assert_allclose(sums[2:], loss.d_gain, rtol=1e-3, atol=1e-6)
        splats = self.read("d_splats", np.float32, count, 12)
        for columns, value in (
            (slice(0, 2), slopes.means2d),
            (slice(6, 9), slopes.colors),
            (slice(9, 11), slopes.absolute),
        ):
            close(splats[:, columns], value, tolerance)
        gradients = self.read("gradients", np.float32, self.drawing.columns, count)
        start = 0
        for value in expected[:6]:
            width_ = int(np.prod(value.shape[1:]))
            close(gradients[start : start + width_].T.reshape(value.shape), value, tolerance)
            start += width_


def close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare the largest difference with the norm, since a pixel at the limit of an alpha may change a single gradient."""
    size = float(np.linalg.norm(expected))
    assert float(np.linalg.norm(found - expected)) <= tolerance * size + 1e-9


SLOW = pytest.mark.slow  # kernels are compiled anew for each size


@pytest.mark.parametrize("group", [64, pytest.param(128, marks=SLOW), pytest.param(256, marks=SLOW)])
@pytest.mark.parametrize("subgroups", [True, pytest.param(False, marks=SLOW)], ids=["subgroups", "shared memory"])
@pytest.mark.parametrize("device", DEVICES)
def test_kernels_are_those_of_the_cpu(device: Callable[..., Gpu], group: int, subgroups: bool) -> None:
    """A ragged image size, with workgroups and subgroups of several sizes."""
    case = Case(device(group, subgroups), points(600), 53, 37)
    case.run()
    case.check()


@pytest.mark.parametrize(
    ("count", "width", "height", "bands"), [(0, 16, 16, 15), (1, 7, 5, 0), (2, 17, 33, 3), (65, 80, 16, 8)]
)
@pytest.mark.parametrize("device", DEVICES)
def test_few_points_and_odd_images(device: Callable[..., Gpu], count: int, width: int, height: int, bands: int) -> None:
    case = Case(device(), points(count, 2, bands, 0.3), width, height, antialias=False)
    case.run()
    case.check()


@pytest.mark.parametrize("group", [64, 256])
@pytest.mark.parametrize("device", DEVICES)
def test_tiles_of_any_length_are_sorted(device: Callable[..., Gpu], group: int) -> None:
    """Tiles within a block of shared memory, of a whole block, and of several blocks. Many depths are equal."""
    gpu, rng, draw = device(group), np.random.default_rng(0), new_draw()
    counts = np.array([0, 1, 2, 3, 700, 1023, 1024, 1025, 2048, 2049, 5000])
    keys = [np.stack([rng.integers(0, 50, count), rng.permutation(count)], 1).astype(np.uint32) for count in counts]
    draw["size"] = 16 * len(counts), 16, len(counts), 1
    ends = counts.cumsum()
    buffers = {
        "draw": gpu.uniform(draw),
        "tile_offsets": gpu.upload(np.concatenate([[0], ends]).astype(np.uint32)),
        "status": gpu.zeros(8),
        "keys": gpu.upload(np.concatenate(keys)),
    }
    recording = gpu.record()
    recording.run(gpu.kernel("sort"), (len(counts), 1, 1), buffers)
    recording.submit()
    found = np.split(gpu.read(buffers["keys"], np.uint32, (int(ends[-1]), 2)), ends[:-1])
    for tile, expected in zip(found, keys, strict=True):
        np.testing.assert_array_equal(tile, expected[np.lexsort((expected[:, 1], expected[:, 0]))], str(len(tile)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_images_whose_maps_exceed_a_buffer(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits between the bytes of the image and those of the maps of all channels: the channels follow one another."""
    rng, gpu = np.random.default_rng(seed), software_gpu()
    width, height = (int(size) for size in rng.integers(100, 130, 2))
    monkeypatch.setattr(gpu, "largest", int(rng.integers(16, 36) * width * height))
    case = Case(gpu, points(100, seed, 0), width, height)
    case.run()
    case.check()
    assert case.drawing.buffers["maps"].size < 13 * width * height
    monkeypatch.setattr(gpu, "largest", 15 * width * height)
    with pytest.raises(GpuError, match=f"image of {width}x{height} pixels takes 0 MB, and a buffer may have 0 MB"):
        Case(gpu, points(100, seed, 0), width, height)


@pytest.mark.slow
def test_many_points() -> None:
    arrays = points(200_000, 4, 0, 1.5)
    arrays[2] -= 1.5
    case = Case(software_gpu(), arrays, 64, 48)
    case.run()
    case.check(0.02)  # behind a thousand splats little light is left, and float32 rounds it


@pytest.mark.parametrize("length", [1, 255, 257, 70_001])
@pytest.mark.parametrize("device", DEVICES)
def test_sums_of_any_length(device: Callable[..., Gpu], length: int) -> None:
    """Sums over one workgroup, over several, and over more blocks than a workgroup has threads."""
    gpu = device()
    drawing, values = Drawing(gpu), np.random.default_rng(length).integers(0, 9, length).astype(np.uint32)
    buffer, recording = gpu.upload(values), gpu.record()
    drawing.record_scan(recording, buffer, length)
    recording.submit()
    found = gpu.read(buffer, np.uint32, (length,))
    np.testing.assert_array_equal(found, np.cumsum(values) - values)


@pytest.mark.parametrize("device", DEVICES)
def test_more_pairs_than_fit_are_reported(device: Callable[..., Gpu], monkeypatch: pytest.MonkeyPatch) -> None:
    """The buffers are as small as the number of pairs that they are said to hold. The emulated GPU finds what lies outside."""
    case = Case(device(), points(300, 6, 0, 0.2), 48, 32)
    needed = binning_pairs(case)
    monkeypatch.setattr(drawing_module, "FEWEST_PAIRS", 1)
    case.drawing.capacity, case.drawing._static_capacity = 0, -1
    case.drawing.fit_pairs(4)
    assert case.drawing.buffers["list"].size == 64
    case.buffers = case.drawing.alone() | {name: case.buffers[name] for name in ("targets", "gains")}
    offset = DRAW.fields["counts"][1] + 12
    case.gpu.write(case.drawing.buffers["draw"], np.array([case.drawing.capacity], np.uint32), offset)
    case.run()
    assert case.drawing.needed_pairs() == pytest.approx(needed, rel=0.01)
    case.drawing.grow(needed)
    assert case.drawing.capacity >= needed
    assert case.drawing.needed_pairs() == 0


def test_pairs_fill_a_buffer_where_there_is_no_room_to_spare(monkeypatch: pytest.MonkeyPatch) -> None:
    drawing = Drawing(software_gpu())
    monkeypatch.setattr(drawing.gpu, "largest", 36 * 10_000 + 64)
    drawing.fit_pairs(9000)
    assert drawing.capacity == 10_000
    drawing.fit_pairs(10_000)
    with pytest.raises(GpuError, match="the gradients of the pairs takes"):
        drawing.fit_pairs(10_100)


def draw_in_order(gpu: Gpu, library: ctypes.CDLL, order: int) -> dict[str, np.ndarray]:
    """Draw moving splats among static ones, which get no gradients, and return picture and gradients."""
    library.emulatorSetOrder(order)
    arrays, still = points(120, 6, 0, 0.4), points(120, 7, 0, 0.4)
    arrays[3] -= 2
    still[3] -= 2
    case = Case(gpu, arrays, 40, 32)
    scene = StaticScene(gpu, np.concatenate([array.reshape(120, -1).T for array in still]))
    scene.set_alive(np.ones(120, bool), np.zeros(120, bool))
    draw = case.draw
    view = scene.view(0, draw, case.drawing)
    case.drawing.fit_pairs(0, scene.pairs)
    draw["counts"][2:] = 120, case.drawing.capacity
    gpu.write(case.drawing.buffers["draw"], draw)
    case.buffers = case.drawing.alone() | {name: case.buffers[name] for name in ("targets", "gains")} | view
    gpu.write(case.drawing.buffers["d_image"], np.random.default_rng(2).normal(size=(32, 40, 4)).astype(np.float32))
    recording = gpu.record()
    case.drawing.record_pairs(recording, case.buffers)
    case.drawing.record_image(recording, case.buffers)
    case.drawing.record_splat_gradients(recording, case.buffers)
    recording.submit()
    assert case.drawing.needed_pairs() == 0
    return {"image": case.read("image", np.float32, 32, 40, 4), "d_splats": case.read("d_splats", np.float32, 120, 12)}


@pytest.mark.parametrize("subgroups", [True, pytest.param(False, marks=SLOW)], ids=["subgroups", "shared memory"])
def test_results_do_not_depend_on_the_order_of_threads(subgroups: bool) -> None:
    """Threads forwards, backwards, one warp ahead, at random: the same bits. Static splats among moving ones have no sums."""
    gpu, library = emulated_gpu(64, subgroups), ctypes.CDLL(str(emulated_libraries()))
    try:
        expected, *others = (draw_in_order(gpu, library, order) for order in range(4))
    finally:
        library.emulatorSetOrder(4)
    assert np.count_nonzero(expected["d_splats"]) > 500
    for found in others:
        for name, value in expected.items():
            np.testing.assert_array_equal(found[name], value)


@pytest.mark.parametrize("device", DEVICES)
def test_static_points_that_are_removed_leave_the_views(device: Callable[..., Gpu]) -> None:
    """Views are the same as those of a scene that never had the points, and nothing is read back or sorted again."""
    gpu, count = device(), 200
    case = Case(gpu, points(10, 6, 0, 0.4), 40, 32)
    params = np.concatenate([array.reshape(count, -1).T for array in points(count, 7, 0, 0.4)])
    alive = np.random.default_rng(3).random(count) < 0.5
    changed, fresh = StaticScene(gpu, params), StaticScene(gpu, params)
    changed.set_alive(np.ones(count, bool), np.zeros(count, bool))
    before = changed.view(0, case.draw, case.drawing)
    whole = gpu.read(before["frozen"], np.float32, (32, 40, 4))
    changed.set_alive(alive, alive)
    fresh.set_alive(alive, alive)
    views = [scene.view(0, case.draw, case.drawing) for scene in (changed, fresh)]
    images = [gpu.read(view["frozen"], np.float32, (32, 40, 4)) for view in views]
    np.testing.assert_array_equal(images[0], images[1])
    assert np.abs(images[0] - whole).max() > 0.1
    assert views[0] is before
    np.testing.assert_array_equal(gpu.read(views[0]["chosen"], np.uint32, (count,)), alive)
    changed.set_alive(np.ones(count, bool), alive)  # points that return are sorted again
    again = gpu.read(changed.view(0, case.draw, case.drawing)["frozen"], np.float32, (32, 40, 4))
    np.testing.assert_array_equal(again, whole)


def binning_pairs(case: Case) -> int:
    moment = deform.DeformedPoints._make([*case.arrays, *NONE])
    opacities, seen = deform.forward(moment, np.zeros(3, np.float32), case.view)
    return int(binning.bin_splats(seen.means2d, seen.conics, opacities, seen.depths, seen.radii, *case.size).first[-1])


@pytest.mark.parametrize(
    ("array", "value"), [(0, np.nan), (1, np.inf), (2, np.nan), (3, np.nan), (4, -np.inf), (5, np.nan)]
)
@pytest.mark.parametrize("device", DEVICES)
def test_values_that_are_not_finite_are_found(device: Callable[..., Gpu], array: int, value: float) -> None:
    arrays = points(40)
    arrays[array].reshape(-1)[5] = value
    case = Case(device(), arrays, 24, 24)
    case.run()
    assert case.read("status", np.uint32, 2)[1] == 1


@pytest.mark.slow
def test_the_smallest_limits_of_webgpu_are_enough() -> None:
    """An adapter that grants no more than every WebGPU device has."""
    gpu = WgpuGpu(software_adapter(), group=256, subgroups=False, limits=SMALLEST)
    assert {name: gpu.device.limits[name] for name in SMALLEST} == SMALLEST
    case = Case(gpu, points(200), 40, 24)
    case.run()
    case.check()
    with pytest.raises(GpuError, match="may have 134 MB"):
        gpu.zeros(1 << 28, "the images")


def test_uniforms_have_the_layout_of_the_kernels() -> None:
    """The last field of a block arrives where the kernels read it."""
    source = """// reads the end of the block
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read_write> found: array<vec4f>;
@compute @workgroup_size(1) fn main() { found[0] = draw.adam[9]; found[1] = draw.weights[7]; found[2] = draw.meters; }"""
    from splatreel.gpu.device import read_shader

    gpu = software_gpu()
    module = gpu.device.create_shader_module(code=f"const GROUP = 64u;\n{read_shader('common')}\n{source}")
    pipeline = gpu.device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
    draw = new_draw()
    draw["adam"][9], draw["weights"][7], draw["meters"] = (1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12)
    buffers = {0: gpu.uniform(draw), 1: gpu.zeros(48)}
    entries = [{"binding": number, "resource": {"buffer": buffer}} for number, buffer in buffers.items()]
    encoder = gpu.device.create_command_encoder()
    computing = encoder.begin_compute_pass()
    computing.set_pipeline(pipeline)
    computing.set_bind_group(0, gpu.device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries))
    computing.dispatch_workgroups(1)
    computing.end()
    gpu.device.queue.submit([encoder.finish()])
    np.testing.assert_array_equal(gpu.read(buffers[1], np.float32, (12,)), np.arange(1, 13))
