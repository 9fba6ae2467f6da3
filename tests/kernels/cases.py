"""Kernels and their readable torch versions on the same inputs. The versions import torch when they run."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from splatreel.kernels import deform, harmonics, hashgrid, motion, photometric, project, splat
from splatreel.kernels.splat import Projection, Splats
from tests.kernels.compare import Kernel, camera, floats, gaussians, splats

CENTER = np.array([0.3, -0.2, -3.0], np.float32)
RESOLUTIONS = np.array([[4, 4, 3], [8, 9, 5], [33, 32, 16]])
"""Cells of a hash grid with two dense levels and a hashed one."""
WEIGHTS = np.array([0.1, 0.5, 0.3, 0.1], np.float32)
"""Weights of the four knots of a spline that count at a time."""


class Case(NamedTuple):
    """A kernel on given inputs.

    name: its first word is the file of recorded arrays. twin: takes float64 tensors and returns the outputs. tolerance: relative to the
    largest value. step: of finite differences, relative to an input's size; None where the outputs jump or have too many kinks.
    """

    name: str
    kernel: Kernel
    twin: Callable[..., Any]
    inputs: list[np.ndarray]
    tolerance: float = 1e-5
    step: float | None = 1e-3
    recorded: bool = True

    def __repr__(self) -> str:
        return self.name


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.RandomState(seed).randn(*shape).astype(np.float32)


def uniform(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.RandomState(seed).rand(*shape).astype(np.float32)


def doubles(array: np.ndarray) -> Any:
    """Return a tensor of float64, or of the array's own type if it holds no floats."""
    import torch

    tensor = torch.from_numpy(array)
    return tensor.double() if tensor.is_floating_point() else tensor


def projections() -> Iterator[Case]:
    def kernel(view, means, quats, scales):
        *found, radii = project.forward(means, quats, scales, view)
        _, conics, _ = found
        return (*found, radii), lambda d: project.backward(means, quats, scales, conics, *d, radii=radii, view=view)

    def twin(view, *points):
        from tests.kernels import twin

        antialias = view.blur == project.FINE_BLUR
        return twin.project(*points, view.viewmat, view.K, view.width, view.height, view.near, antialias)

    for distance in (3.0, 0.5):  # at 0.5 many points are behind the camera or far outside the view
        for blur in (project.BLUR, project.FINE_BLUR):
            view = project.Pinhole(*camera(37, 29, distance), 37, 29, 0.2, blur)
            name = f"project at {distance:g} with a blur of {blur:g}"
            yield Case(name, partial(kernel, view), partial(twin, view), gaussians(120)[:3], step=None)
    view = project.Pinhole(*camera(37, 29, 6.0), 37, 29, 0.2, project.FINE_BLUR)
    means, quats, scales, *_ = gaussians(60)
    inside = [0.4 * means, quats, scales]  # no point comes or goes
    yield Case("project inside of the image", partial(kernel, view), partial(twin, view), inputs=inside, step=1e-4)


def bands_of_harmonics() -> Iterator[Case]:
    def kernel(degree):
        def run(directions, coefficients):
            colors = harmonics.forward(degree, directions, coefficients)
            return (colors,), lambda d: harmonics.backward(degree, directions, coefficients, *d, to_directions=True)

        return run

    def twin(degree):
        def run(directions, coefficients):
            from tests.kernels import twin

            return (twin.spherical_harmonics(degree, directions, coefficients),)

        return run

    for degree in range(4):
        for bands in {(degree + 1) ** 2, 16}:  # exactly what the degree needs, and more
            inputs = [normal(50, 3, seed=degree), normal(50, bands, 3, seed=9)]
            name = f"harmonics of degree {degree}, {bands} bands"
            yield Case(name, kernel(degree), twin(degree), inputs, recorded=bands < 16 or degree == 3)


def view_colors() -> Iterator[Case]:
    means, center = normal(100, 3), np.array([0.3, -2.0, 4.0], np.float32)

    def kernel(base, rest):
        colors = harmonics.colors(means, center, base, rest)
        return (colors,), lambda d: harmonics.colors_backward(means, center, colors, rest, *d)

    def twin(base, rest):
        from tests.kernels import twin

        return (twin.view_colors(doubles(means), doubles(center), base, rest),)

    for bands in (1, 4, 9, 16):
        inputs = [3 * normal(100, 1, 3, seed=bands), 0.3 * normal(100, bands - 1, 3, seed=bands + 1)]
        yield Case(f"harmonics as colors, {bands} bands", kernel, twin, inputs, recorded=bands in (4, 16))


def moment(count: int, bands: int = 4, seed: int = 0) -> list[np.ndarray]:
    """Return unconstrained points, dx, dq and shade."""
    means, quats, scales, _, sh = gaussians(count, bands, seed)
    state = np.random.RandomState(seed + 1)
    logits, dx, dq, shade = (state.randn(count, *rest) for rest in ((), (3,), (4,), (4,)))
    points = means, quats, np.log(scales), logits, sh[:, :1], sh[:, 1:]
    arrays = *points, 0.2 * dx, 3 * dq, 0.3 * shade
    return [np.ascontiguousarray(array, np.float32) for array in arrays]


def deformed_points() -> Iterator[Case]:
    width, height, near = 60, 40, 0.5

    def kernel(antialias):
        view = project.Pinhole(
            *camera(width, height), width, height, near, project.FINE_BLUR if antialias else project.BLUR
        )

        def run(*parts):
            points = deform.DeformedPoints(*parts)
            opacities, seen = deform.forward(points, CENTER, view)

            def gradient(d):
                *to_points, d_dq, d_shade = deform.backward(points, seen, CENTER, view, *d)
                d_dx = to_points[0] if len(points.dx) else np.zeros_like(points.dx)
                return *to_points, d_dx, d_dq, d_shade

            return (seen.means2d, seen.conics, seen.colors, opacities), gradient

        return run

    def twin(antialias):
        def run(*parts):
            from tests.kernels import twin

            *points, dx, dq, shade = parts
            moved, shaded = (dx, dq) if len(dx) else None, shade if len(shade) else None
            pinhole = *camera(width, height), width, height
            return tuple(twin.deformed(points, moved, shaded, pinhole, doubles(CENTER), near, antialias)[:4])

        return run

    for antialias in (False, True):
        kinds = {f"{count} points, {bands} bands": moment(count, bands) for count, bands in KINDS}
        plain, thin = moment(60), moment(60)
        kinds["no shade"] = [*plain[:-1], plain[-1][:0]]
        kinds["no offsets"] = [*moment(40, 9)[:6], *(array[:0] for array in plain[6:])]
        kinds["thin splats"] = [*thin[:2], thin[2] - 3, *thin[3:]]
        for name, inputs in kinds.items():
            recorded = not name.startswith(("0", "1 ", "60 points, 1 "))
            title = f"deform, {name}" + (", antialiased" if antialias else "")
            yield Case(title, kernel(antialias), twin(antialias), inputs, 5e-5, 1e-4, recorded)


KINDS = ((60, 1), (60, 4), (20, 16), (1, 4), (0, 4))
"""Numbers of points and of bands."""


def drawings() -> Iterator[Case]:
    def case(name, inputs, width, height, tolerance=3e-5, step=None, recorded=False):
        *values, depths, radii = inputs

        def kernel(*leaves):
            given = Splats(*leaves, depths, radii)
            image, alpha = splat.rasterize(given, width, height)

            def gradient(d):
                found = splat.rasterize_gradient(given, width, height, image, alpha, *d)
                return found.means2d, found.conics, found.colors, found.opacities

            return (image, alpha), gradient

        def twin(*leaves):
            from tests.kernels import twin

            return twin.rasterize(twin.Splats(*leaves, doubles(depths), doubles(radii)), width, height)

        return Case(f"rasterize {name}", kernel, twin, values, tolerance, step, recorded)

    for channels in (1, 2, 3, 5, 6):
        for width, height in ((37, 29), (16, 32), (1, 1), (5, 50)):
            recorded = (channels, width) in ((1, 16), (3, 37), (5, 5), (6, 16))
            title = f"{channels} channels of {width} x {height} pixels"
            yield case(title, splats(150, channels, width, height, seed=channels), width, height, recorded=recorded)
    for opacity in (
        0.97,
        0.9999,
        1.0,
    ):  # alphas exceed the clamp at 0.999, and pixels are full long before the last splat
        inputs = splats(300, 3, 40, 30)
        inputs.opacities[:] = opacity
        yield case(f"full pixels at {opacity:g}", inputs, 40, 30, 1e-4)
    inputs = splats(40, 3, 50, 34)
    inputs.conics[:5], inputs.means2d[:2] = (1e-6, 0, 1e-6), (1e4, -1e4)
    yield case("huge splats", inputs, 50, 34)
    wide = splats(6, 4, 8, 8)  # no pixel is near the cut at 1/255, or full
    wide.means2d[:], wide.radii[:] = 4 + normal(6, 2), 1
    wide.conics[:] = np.array([0.02, 0.005, 0.03]) * (1 + uniform(6, 1))
    wide.opacities[:] = 0.2 + 0.5 * uniform(6, seed=4)
    yield case("wide splats", wide, 8, 8, step=1e-3, recorded=True)


def among_frozen() -> Iterator[Case]:
    width, height = 60, 50

    def kernel(static, depths, radii):
        def run(*leaves):
            given, frozen = Splats(*leaves, depths, radii), splat.freeze(static, width, height)
            image, alpha = splat.rasterize(given, width, height, frozen)

            def gradient(d):
                found = splat.rasterize_gradient(given, width, height, image, alpha, *d, frozen)
                return found.means2d, found.conics, found.colors, found.opacities

            return (image, alpha), gradient

        return run

    def twin(static, depths, radii):
        def run(*leaves):
            import torch

            from tests.kernels import twin

            moving = *leaves, doubles(depths), doubles(radii)
            both = [torch.cat([mine, doubles(other)]) for mine, other in zip(moving, static, strict=True)]
            return twin.rasterize(twin.Splats(*both), width, height)

        return run

    for seed in range(3):
        static, moving = splats(200, 3, width, height, seed), splats(30, 3, 20, 20, seed + 100)
        static.depths[:20] = moving.depths[:20]  # at equal depth, moving splats are in front
        static.opacities[:] *= 0.3
        *values, depths, radii = moving
        arguments = static, depths, radii
        yield Case(f"among frozen {seed}", kernel(*arguments), twin(*arguments), values, 3e-5, None, seed == 0)


def sums_over_splats() -> Iterator[Case]:
    for channels, width, height, opacity in GATHERED:
        found = splats(200, 3, width, height, seed=channels)
        if opacity:
            found.opacities[:] = opacity
        projection = Projection(found.means2d, found.conics, found.depths, found.radii)

        def kernel(images, projection=projection, found=found):
            return (splat.gather(projection, found.opacities, images),), lambda _: (None,)

        def twin(images, found=found, width=width, height=height):
            import torch

            from tests.kernels import twin

            colors = torch.zeros(len(found.radii), images.shape[2], dtype=torch.float64, requires_grad=True)
            rows = twin.Splats(*(doubles(array) for array in found))._replace(colors=colors)
            return torch.autograd.grad(twin.rasterize(rows, width, height)[0], colors, images.detach())

        name = f"gather {channels} channels of {width} x {height} pixels" + (" that are full" if opacity else "")
        yield Case(name, kernel, twin, [normal(height, width, channels)], 3e-5, None, width == 16)


GATHERED = (
    (1, 37, 29, None),
    (2, 16, 32, 0.9999),  # pixels are full long before the last splat
    (12, 1, 1, None),
    (13, 5, 50, None),
    (36, 16, 8, None),
)


def images(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return an image and a target like it."""
    target = uniform(height, width, 3, seed=seed)
    return np.clip(target + 0.1 * normal(height, width, 3, seed=seed + 50), 0, 1), target


def photometric_losses() -> Iterator[Case]:
    def kernel(target, weight, *image_and_gain):
        found = photometric.loss_and_gradient(image_and_gain[0], target, weight, *image_and_gain[1:])

        def gradient(d):
            return tuple(d[0] * slope for slope in (found.d_image, found.d_gain)[: len(image_and_gain)])

        return (np.array(found.loss),), gradient

    def twin(target, weight, *image_and_gain):
        from tests.kernels import twin

        return (twin.photometric_loss(image_and_gain[0], doubles(target), weight, *image_and_gain[1:]),)

    def case(name, target, weight, inputs, recorded):
        of, step = (target, weight), 1e-3 if weight == 1 else None  # the absolute difference has kinks
        return Case(f"similarity {name}", partial(kernel, *of), partial(twin, *of), inputs, 2e-5, step, recorded)

    for weight in (0.0, 0.2, 1.0):
        for height, width in ((29, 37), (1, 1), (4, 40), (40, 3), (12, 11)):
            image, target = images(height, width)
            yield case(f"{weight:g}, {height} x {width}", target, weight, [image], width in (37, 11) and weight > 0)
    gain = np.array([0.9, 1.0, 1.2], np.float32)
    for height, width in ((29, 37), (40, 130)):
        image, target = images(height, width)
        for kind, wanted in (("bytes", np.rint(255 * target).astype(np.uint8)), ("floats", target)):
            yield case(f"with a gain, {kind}, {height} x {width}", wanted, 0.2, [image, gain], width == 37)


def hash_grids() -> Iterator[Case]:
    def kernel(coords, table):
        def gradient(d):
            given = coords, table, *d, RESOLUTIONS
            return hashgrid.coords_gradient(*given), hashgrid.table_gradient(*given)

        return (hashgrid.forward(coords, table, RESOLUTIONS),), gradient

    def twin(coords, table):
        from tests.kernels import twin

        return (twin.hashgrid(coords, table, RESOLUTIONS),)

    for features in (1, 2, 4):
        table = normal(3, 1024, features, seed=features)
        inputs = [uniform(200, 3, seed=features), table]
        yield Case(f"hashgrid of {features} features", kernel, twin, inputs, step=None, recorded=features == 2)
    ends = np.array([[0.0, 0, 0], [1, 1, 1], [1.5, 0.3, 0.2], [0.1, -2, 0.3], [0.3, 1, 0]], np.float32)

    def forward(coords, table):
        return kernel(coords, table)[0], lambda _: (None, None)

    table = normal(3, 1024, 2)
    yield Case("hashgrid at and beyond the ends", forward, twin, [ends, table], step=None, recorded=False)


def moving(nodes: int, points: int) -> tuple[list[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the control values of nodes and points, and their skin."""
    state, size = np.random.RandomState(1), (points, min(4, nodes))
    skin = state.randint(max(nodes, 1), size=size), state.rand(*size).astype(np.float32)
    return [normal(7, nodes, 7, seed=nodes), normal(7, points, 7, seed=points)], skin


def offsets() -> Iterator[Case]:
    def kernel(skin, knot, nodes, points):
        some = slice(knot, knot + 4)

        def gradient(d):
            found = motion.offsets_gradient(*d, skin, nodes.shape[1], 2.5)
            levels = [np.zeros_like(nodes), np.zeros_like(points)]
            for level, slope in zip(levels, found, strict=True):
                level[some] = WEIGHTS[:, None, None] * slope
            return tuple(levels)

        return motion.offsets(nodes[some], points[some], WEIGHTS, skin, 2.5), gradient

    def twin(skin, knot, nodes, points):
        from tests.kernels import twin

        return twin.offsets((nodes, points), knot, WEIGHTS, (doubles(skin[0]), doubles(skin[1])), 2.5)

    for nodes, points in ((0, 90), (5, 90), (64, 300), (1, 1), (2, 0)):
        for knot in (0, 3):
            inputs, skin = moving(nodes, points)
            name = f"motion of {points} points by {nodes} nodes at knot {knot}"
            of, recorded = (skin, knot), (points, knot) == (90, 3)
            yield Case(name, partial(kernel, *of), partial(twin, *of), inputs, step=1e-2, recorded=recorded)


def rigidity() -> Iterator[Case]:
    means, neighbor = normal(300, 3), np.random.RandomState(2).randint(300, size=300)
    neighbor[:3] = np.arange(3)  # neighbors at distance zero
    weights = uniform(300, seed=3)
    inputs = [0.3 * normal(300, 3, seed=4), floats([1, 0, 0, 0]) + 0.3 * normal(300, 4, seed=5)]
    for unit in (1.0, 5.0):

        def kernel(dx, dq, unit=unit):
            loss, *gradients = motion.arap(means, dx, dq, neighbor, weights, unit)
            return (np.array(loss),), lambda d: tuple(d[0] * gradient for gradient in gradients)

        def twin(dx, dq, unit=unit):
            from tests.kernels import twin

            return (twin.arap(doubles(means), dx, dq, doubles(neighbor), doubles(weights), unit),)

        yield Case(f"arap in units of {unit:g}", kernel, twin, inputs, 3e-5, 1e-4)


def splines() -> Iterator[Case]:
    for knot in (0, 5):

        def kernel(controls, knot=knot):
            return (motion.spline(controls[knot : knot + 4], WEIGHTS),), lambda _: (None,)

        def twin(controls, knot=knot):
            from tests.kernels import twin

            return (twin.spline(controls, knot, WEIGHTS),)

        yield Case(f"motion along a spline at knot {knot}", kernel, twin, [normal(9, 40, 4)], 1e-6, None, knot == 5)


CASES: list[Case] = [
    *projections(),
    *bands_of_harmonics(),
    *view_colors(),
    *deformed_points(),
    *drawings(),
    *among_frozen(),
    *sums_over_splats(),
    *photometric_losses(),
    *hash_grids(),
    *offsets(),
    *splines(),
    *rigidity(),
]
