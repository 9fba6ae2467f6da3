"""Networks of people: made-up ones, which see the colors of the scene's body, and a tiny one that LiteRT runs."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError
from splatreel.base.threads import map_parallel
from splatreel.method.images import people
from splatreel.method.images.people import People, Square, find_people, network_of, people_free, squares_around
from splatreel.segmentation.segmenter import fit_subject
from tests.segmentation import scenes

ANCHORS = 2254
ODDS = 8.0


def body(crop: np.ndarray) -> np.ndarray:
    """Return where a crop [S, S, 3], 0..1, shows the colors of the scene's body, [S, S] bool."""
    return crop.min(-1) < 70 / 255


def detect(crop: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
    """Return the outputs of a detection that sees one body: its middle, and a point above it at half of its height."""
    odds, points = np.full((ANCHORS, 1), -ODDS, np.float32), np.zeros((ANCHORS, 12), np.float32)
    rows, columns = np.nonzero(body((crop + 1) / 2))
    if len(rows) > 20:
        middle = np.array([columns.mean(), (rows.min() + rows.max()) / 2])
        up = np.array([0, rows.max() - rows.min()]) / 2
        anchor = people._anchors()[100] * people.DETECTION_INPUT
        odds[100], points[100, 4:8] = ODDS, np.concatenate([middle - anchor, middle - up - anchor])
    return {(ANCHORS, 1): odds, (ANCHORS, 12): points}


def networks(presence: float = 1.0) -> People:
    return People(
        {
            "pose_detection": detect,
            "pose_landmark_full": lambda crop: {
                (256, 256, 1): np.where(body(crop), ODDS, -ODDS)[..., None],
                (1,): np.array([presence]),
            },
            "selfie_segmentation": lambda crop: {(256, 256, 1): body(crop).astype(np.float32)[..., None]},
        }
    )


def scene(at: tuple[int, int] = (60, 40), size: tuple[int, int] = (160, 90)) -> tuple[np.ndarray, np.ndarray]:
    """Return an image with a body and its mask."""
    image = np.full((size[1], size[0], 3), 150, np.uint8)
    mask = np.zeros(size[::-1], np.uint8)
    cv2.ellipse(image, at, (8, 20), 0, 0, 360, (200, 40, 40), -1)
    cv2.ellipse(mask, at, (8, 20), 0, 0, 360, 1, -1)
    return image, mask > 0


def test_a_person_is_found_once_in_the_whole_image_and_its_parts() -> None:
    (square,) = networks().find(scene()[0])
    assert np.allclose((square.x, square.y), (60, 40), atol=2)
    assert square.side == pytest.approx(40, rel=0.15)
    assert abs(square.angle) < 0.1


def test_a_detection_that_the_second_network_denies_is_no_person() -> None:
    assert networks(presence=0.1).find(scene()[0]) == []


def test_people_lie_in_images_of_a_camera_on_its_side() -> None:
    image, _ = scene()
    (square,) = networks().find(np.rot90(image, 1), angle=-np.pi / 2)
    assert np.allclose((square.x, square.y), (40, 100), atol=2)
    assert square.angle == pytest.approx(-np.pi / 2, abs=0.1)


def test_probability_is_known_around_people_only() -> None:
    image, mask = scene()
    probability, known = networks().probability(image, [Square(60, 40, 40), Square(140, 40, 20)])
    assert probability[mask].mean() > 0.9
    assert probability[~mask].mean() < 0.02
    assert known[mask].all()
    assert known[40, 100]  # the widest square has 2.5 times the person's side
    assert not known[:, 115:].any()  # the second square holds nobody


def test_landmarks_are_pixels_of_the_image_however_the_square_lies() -> None:
    """A network that finds all landmarks in the middle of the body; the circle around the body ends at its upper end."""

    def look(crop: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
        rows, columns = np.nonzero(body(crop))
        out = np.zeros((39, 5), np.float32)
        out[:, :2], out[34, :2] = (columns.mean(), rows.mean()), (columns.mean(), rows.min())
        out[:, 3] = ODDS
        return {(195,): out.ravel(), (1,): np.array([1.0])}

    image, _ = scene()
    for square in (Square(60, 40, 60), Square(70, 45, 80)):
        found = People({"pose_landmark_full": look}).landmarks(image, square)
        assert found is not None
        assert found.points.shape == (33, 2)
        assert np.allclose(found.points, (60.5, 40.5), atol=0.5)
        assert found.side == pytest.approx(40, rel=0.1)
        assert (found.visible > 0.99).all()
    nobody = People({"pose_landmark_full": lambda crop: {(1,): np.array([0.1])}})
    assert nobody.landmarks(image, Square(60, 40, 60)) is None


def test_squares_enclose_large_parts_of_a_mask() -> None:
    mask = scene()[1]
    mask[5, 5] = True
    (square,) = squares_around(mask)
    assert (square.x, square.y) == pytest.approx((60.5, 40.5), abs=1)
    assert square.side == pytest.approx(45, abs=1)


def test_backgrounds_learn_nothing_from_people() -> None:
    image, mask = scene()
    free = people_free(networks(), np.stack([image, np.full_like(image, 150)]))
    assert not free[0][mask].any()
    assert free[0].mean() > 0.85
    assert free[1].all()


def test_a_body_that_never_moves_is_found_without_a_clean_plate() -> None:
    images, truth = scenes.film(3, 4, at=(0.3, -0.2))
    model = fit_subject(scenes.ring(4), images, people=networks())
    found = model.masks(images[:1]) > 127
    assert scenes.overlap(found, truth[:1]) > 0.85
    assert max(model.moving_shares) > 0.01


def test_cameras_without_an_image_say_nothing() -> None:
    """An image of another time step stands in for the missing one. It shows a body somewhere else."""
    images, _ = scenes.film(3, 4, at=(0.3, -0.2))
    model = fit_subject(scenes.ring(4), images, people=networks())
    there = np.array([True, True, True, False])
    other = images[0].copy()
    other[3] = scenes.film(1, 4, at=(-0.8, 0.6))[0][0, 3]
    found, elsewhere = model.masks(images[:1], there[None]), model.masks(other[None], there[None])
    assert np.array_equal(found[:, :3], elsewhere[:, :3])


def test_what_moves_and_is_no_person_stays() -> None:
    """Animals and balls: the networks see nobody there, and the masks are those without networks."""
    images, truth = scenes.film(6, 4)
    nobody = People({name: lambda crop, run=run: run(crop * 0 + 1) for name, run in networks()._networks.items()})
    without, unchanged, found = (
        fit_subject(scenes.ring(4), images, people=each).masks(images[:1]) for each in (None, nobody, networks())
    )
    assert np.array_equal(unchanged, without)
    assert scenes.overlap(found > 127, truth[:1]) > scenes.overlap(without > 127, truth[:1])


def test_networks_that_are_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither the package, nor a version of it without networks, nor a damaged file."""
    find = importlib.util.find_spec
    package = tmp_path / "mediapipe" / "__init__.py"
    there: dict[str, object] = {"mediapipe": None, "ai_edge_litert": object()}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: there[name] if name in there else find(name))
    assert find_people() is None
    there["mediapipe"] = SimpleNamespace(origin=str(package))
    assert find_people() is None
    for name in people.FILES:
        file = package.parent / "modules" / name.replace("_full", "") / f"{name}.tflite"
        file.parent.mkdir(parents=True)
        file.write_bytes(b"damaged")
    with pytest.raises(MissingDependencyError, match=r"pose_detection.tflite: its SHA-256 is .*force-reinstall"):
        find_people()
    there["ai_edge_litert"] = None
    assert find_people() is None


def test_litert_runs_a_network_in_several_threads() -> None:
    pytest.importorskip("ai_edge_litert.interpreter")
    run = network_of(tiny_network())
    image = np.zeros((256, 256, 3), np.float32)
    image[:, :128, 0] = 1
    for outputs in map_parallel(run, [image, image, image * 0, image]):
        assert set(outputs) == {(256, 256, 1)}
    assert run(image)[256, 256, 1][0, 0, 0] == pytest.approx(32)
    assert run(image)[256, 256, 1][0, 200, 0] == pytest.approx(-8)


def tiny_network() -> bytes:
    """Return a network of one convolution, 40 R - 20 G - 20 B - 8, in the format of TensorFlow Lite."""
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    def tensor(shape: tuple[int, ...], buffer: int = 0) -> "schema.TensorT":
        out = schema.TensorT()
        out.shape, out.type, out.buffer = list(shape), schema.TensorType.FLOAT32, buffer
        return out

    def buffer(values: list[float]) -> "schema.BufferT":
        out = schema.BufferT()
        out.data = list(np.array(values, np.float32).tobytes()) if values else None
        return out

    options = schema.Conv2DOptionsT()
    options.padding = schema.Padding.SAME
    options.strideW = options.strideH = options.dilationWFactor = options.dilationHFactor = 1
    step = schema.OperatorT()
    step.opcodeIndex, step.inputs, step.outputs = 0, [0, 1, 2], [3]
    step.builtinOptionsType, step.builtinOptions = schema.BuiltinOptions.Conv2DOptions, options
    code = schema.OperatorCodeT()
    code.builtinCode = code.deprecatedBuiltinCode = schema.BuiltinOperator.CONV_2D
    code.version = 1
    graph = schema.SubGraphT()
    graph.tensors = [tensor((1, 256, 256, 3)), tensor((1, 1, 1, 3), 1), tensor((1,), 2), tensor((1, 256, 256, 1))]
    graph.inputs, graph.outputs, graph.operators = [0], [3], [step]
    model = schema.ModelT()
    model.version, model.subgraphs, model.operatorCodes = 3, [graph], [code]
    model.buffers = [buffer([]), buffer([40, -20, -20]), buffer([-8])]
    builder = flatbuffers.Builder(1024)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())
