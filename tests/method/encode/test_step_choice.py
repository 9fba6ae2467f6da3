"""Choice of steps by slope: as fine as held-out views need."""

from dataclasses import asdict, astuple, replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.predictive.precision import STEPS, Steps
from splatreel.config import EncodeConfig
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.step_choice import (
    COARSEST,
    FINEST,
    SECTIONS,
    Slope,
    attribute_bytes,
    encode_group_by_slope,
    encode_layer_by_slope,
    equal_slopes,
    in_order,
    with_decoded,
    with_decoded_at,
)
from splatreel.method.init.layout import Layout
from splatreel.method.prediction.trial import Trial
from splatreel.run.store import Store, StoredGroup, StoredLayer, load_arrays, save_arrays
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan
from tests.any_threads import assert_same_on_any_threads
from tests.golden import random_gaussians, random_motion, random_shade
from tests.method.captures import blots
from tests.method.scenes import ring

FRAMES = 4
CLOSE = Trial("cam00", 10.0, 99.0, 12.0, 12.0)
"""A trial after which novel views are no worse than others."""


def uneven(points: Gaussians) -> Gaussians:
    """Return points of different sizes and opacities, so that their rounding errors differ."""
    rng = np.random.default_rng(2)
    scales = points.scales * rng.uniform(0.7, 1.3, points.scales.shape)
    return Gaussians(points.means, points.quats, scales, rng.uniform(0.6, 0.99, len(points)), points.sh)


WALL = uneven(blots(200, [-3, -2, 0.5], [3, 2, 2.0], 0.1, 0))
THING = uneven(blots(30, [-1.6, -0.6, -0.6], [-0.6, 0.6, 0.2], 0.08, 1))


def moving() -> Group:
    dx = np.zeros((FRAMES, len(THING), 3), np.float32)
    dx[:, :, 0] = 0.2 * np.arange(FRAMES)[:, None]
    dq = np.tile(np.array([1, 0, 0, 0], np.float32), (FRAMES, len(THING), 1))
    return Group(0, 0, THING, dx, dq, np.ones(len(WALL), bool))


def seen(noise: float) -> GroupInput:
    """Draw both for all cameras. noise: standard deviation, gray levels."""
    cameras = ring(4, width=96, height=64)
    blank = np.zeros((FRAMES, len(cameras), 64, 96, 3), np.uint8)
    layout = Layout(0.1, 4.0, [0.0, -1, 0], [[-3.0, -2, -1], [3, 2, 1]], background=(0.2, 0.3, 0.4))
    rig = replace(Rig.of(cameras), gains=np.full((len(cameras), 3), 1.1, np.float32))
    data = GroupInput(GroupSpan(0, 0, FRAMES, FRAMES), blank, rig, None, layout, 0, False)
    rng, group = np.random.default_rng(0), moving()
    for frame in range(FRAMES):
        for c, camera in enumerate(cameras):
            image = 255 * 1.1 * data.draw(Gaussians.concatenate([group.at(float(frame)), WALL]), camera)
            blank[frame, c] = np.rint(image + rng.normal(0, noise, image.shape)).clip(0, 255)
    return data


def lost(data: GroupInput, thing: Group, wall: Gaussians) -> float:
    """Return the loss of PSNR, dB, relative to the original points, over all frames and cameras."""
    errors = []
    for group, resting in ((moving(), WALL), (thing, wall)):
        every = (Gaussians.concatenate([group.at(float(frame)), resting]) for frame in range(FRAMES))
        shown = [[np.clip(1.1 * data.draw(points, c), 0, 1) for c in data.cameras] for points in every]
        errors.append(np.square(np.array(shown) - data.images / 255).mean())
    return float(10 * np.log10(errors[1] / errors[0]))


def size(steps: Steps) -> float:
    """Return the geometric mean of the steps that every file has, in multiples of the default steps."""
    chosen, usual = (np.array(astuple(some)) for some in (steps, STEPS))
    kept = [name not in ("rest", "motion", "turn", "shade") for name in asdict(STEPS)]
    return float(np.exp(np.log(chosen / usual)[kept].mean()))


def layer(noise: float, trial: Trial | None = CLOSE, config: EncodeConfig | None = None) -> tuple[bytes, Steps]:
    data, importance = seen(noise), np.ones((len(WALL), 3), np.float32)
    encoder = ReelEncoder(config or EncodeConfig())
    ((file,), order), steps = encode_layer_by_slope(encoder, data, WALL, THING, len(THING), importance, trial)
    assert sorted(order) == list(range(len(WALL)))
    return file, steps


def test_layer_loss_is_small_at_any_distance() -> None:
    losses = {}
    for noise in (1.0, 12.0):
        file, steps = layer(noise)
        losses[noise] = size(steps), lost(seen(noise), moving(), decode_layer(file, "layer")[1])
    assert losses[1.0][0] < 0.7 * losses[12.0][0]
    assert max(loss for _, loss in losses.values()) < 0.3


def test_files_are_the_same_on_any_threads() -> None:
    data, importance = seen(5.0), np.ones((len(THING), 3), np.float32)
    static = StaticPoints(WALL, np.ones(len(WALL), bool))
    assert_same_on_any_threads(lambda: layer(5.0))
    assert_same_on_any_threads(
        lambda: [
            *encode_group_by_slope(ReelEncoder(EncodeConfig()), data, moving(), static, importance, CLOSE)[0].items()
        ]
    )


def test_noisy_views_give_coarser_steps() -> None:
    file, steps = layer(40.0)
    (usual,), _ = ReelEncoder(EncodeConfig()).layer(0, 0, WALL, np.ones((len(WALL), 3), np.float32))
    assert size(steps) > 1.3
    assert len(file) < len(usual)


def test_near_group_loses_less() -> None:
    data, encoder, static = seen(1.0), ReelEncoder(EncodeConfig()), StaticPoints(WALL, np.ones(len(WALL), bool))
    importance, uri = np.ones((len(THING), 3), np.float32), "groups/0000.safetensors"
    files, steps = encode_group_by_slope(encoder, data, moving(), static, importance, CLOSE)
    assert size(steps) < 1
    usual = encoder.group(moving(), importance)[uri]
    losses = [lost(data, decode_group(made, "group"), WALL) for made in (usual, files[uri])]
    assert losses[1] < 0.5 * losses[0]


def test_steps_follow_trial_error() -> None:
    close, far, farther = (size(layer(1.0, replace(CLOSE, psnr=psnr))[1]) for psnr in (99.0, 40.0, 30.0))
    assert close < far < farther


def test_steps_are_finer_for_small_share_of_reel() -> None:
    """The price is per 10 % of the reel. If groups take most bytes, a layer's bytes are cheap."""
    data, importance, encoder = seen(6.0), np.ones((len(WALL), 3), np.float32), ReelEncoder(EncodeConfig())
    few, many = (
        size(encode_layer_by_slope(encoder, data, WALL, THING, n, importance, CLOSE)[1]) for n in (0, 20 * len(WALL))
    )
    assert many < 0.7 * few


def test_group_without_dynamic_points_uses_default_steps() -> None:
    data, encoder, static = seen(1.0), ReelEncoder(EncodeConfig()), StaticPoints(WALL, np.ones(len(WALL), bool))
    still = Group(0, 0, THING[:0], np.zeros((4, 0, 3), np.float32), np.zeros((4, 0, 4), np.float32), static.alive)
    files, steps = encode_group_by_slope(encoder, data, still, static, np.zeros((0, 3), np.float32), CLOSE)
    assert steps == STEPS
    assert files == encoder.group(still)


def test_steps_without_trial_use_training_views() -> None:
    """Held-out views are assumed to have twice the error of training views, so that steps are larger."""
    tried, untried = size(layer(6.0)[1]), size(layer(6.0, None)[1])
    assert 1.2 * tried < untried < 3 * tried


def test_coarseness_multiplies_chosen_steps() -> None:
    """Measuring at another coarseness would compensate it."""
    usual, coarse = (layer(6.0, CLOSE, EncodeConfig(coarseness=value)) for value in (0.65, 1.95))
    assert usual[1] == coarse[1]
    assert len(coarse[0]) < 0.95 * len(usual[0])


def test_equal_slopes_gives_attributes_same_slope() -> None:
    slopes = {"shape": Slope(900.0, 4e-7), "color": Slope(100.0, 9e-7), "rest": Slope(400.0, 1e-8)}
    price = 8e-10
    steps = equal_slopes(STEPS, slopes, price)
    for attribute in ("shape", "color"):
        factor = getattr(steps, attribute) / getattr(STEPS, attribute)
        # The error is error * factor^2 and the bytes fall by saved * d factor / factor.
        assert 2 * slopes[attribute].error * factor**2 / slopes[attribute].saved == pytest.approx(price)
    assert steps.rest == pytest.approx(4 * STEPS.rest)
    assert (steps.position, steps.motion) == (STEPS.position, STEPS.motion)


def test_equal_slopes_clamps_steps() -> None:
    slopes = {"shape": Slope(1.0, 1.0), "color": Slope(1e6, 0.0)}
    steps = equal_slopes(STEPS, slopes, 1e-9)
    assert steps.shape == pytest.approx(FINEST * STEPS.shape)
    assert steps.color == pytest.approx(COARSEST * STEPS.color)


def test_paper_codec_uses_default_steps() -> None:
    assert layer(1.0, CLOSE, EncodeConfig(codec="h265"))[1] == STEPS


def test_checkpoint_keeps_steps(tmp_path: Path) -> None:
    store = Store(tmp_path).group(0)
    store.save_layer(StoredLayer(WALL, WALL, None, STEPS.scaled(0.3)))
    store.save_group(StoredGroup(moving(), None, replace(STEPS, rest=0.05)))
    assert store.layer().steps == STEPS.scaled(0.3)
    assert store.group().steps == replace(STEPS, rest=0.05)


def test_old_checkpoint_has_one_factor_or_none(tmp_path: Path) -> None:
    store = Store(tmp_path).group(0)
    store.save_layer(StoredLayer(WALL, WALL))
    file = store.folder / "layer.safetensors"
    arrays = load_arrays(file)
    del arrays["steps"]
    save_arrays(file, arrays)
    assert store.layer().steps == STEPS
    save_arrays(file, arrays | {"fineness": np.array([0.5])})
    assert store.layer().steps == STEPS.scaled(0.5)


STATIC = ("position", "shape", "opacity", "color", "rest")


def group(seed: int) -> Group:
    rng = np.random.default_rng(seed)
    points = random_gaussians(rng, 40, 1, (0, 0, 0))
    return Group(0, 0, points, *random_motion(rng, points, 5), np.zeros(0, bool), random_shade(rng, 40, 5))


def differing(attribute: str, trained: Group, other: Group) -> Group:
    """Return `trained` with one attribute of another group."""
    points, theirs = trained.dynamic, other.dynamic
    if attribute == "motion":
        return replace(trained, dx=other.dx)
    if attribute == "turn":
        return replace(trained, dq=other.dq)
    if attribute == "shade":
        return replace(trained, shade=other.shade)
    sh = points.sh.copy()
    bands = {"color": slice(0, 1), "rest": slice(1, None)}.get(attribute, slice(0, 0))
    sh[:, bands] = theirs.sh[:, bands]
    changed = {"position": {"means": theirs.means}, "shape": {"scales": theirs.scales}}.get(attribute, {})
    if attribute == "opacity":
        changed = {"opacities": np.clip(theirs.opacities, 0.4, 0.6)}
    return replace(trained, dynamic=replace(points, sh=sh, **changed))


def assert_equal(one: Gaussians, other: Gaussians) -> None:
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-5)
    same = np.abs((one.quats * other.quats).sum(1))  # q and -q are the same rotation
    np.testing.assert_allclose(same, 1, atol=1e-5)


@pytest.mark.parametrize("attribute", SECTIONS)
def test_with_decoded_at_replaces_one_attribute(attribute: str) -> None:
    trained = group(0)
    assert trained.shade is not None
    trained = replace(trained, shade=None if attribute == "opacity" else 0.2 * trained.shade)
    decoded = differing(attribute, trained, group(1))
    assert_equal(with_decoded_at(attribute, trained, decoded, 2.0), decoded.at(2.0))
    for unlike in set(SECTIONS) - {attribute}:
        assert_equal(with_decoded_at(unlike, trained, decoded, 2.0), trained.at(2.0))


@pytest.mark.parametrize("attribute", STATIC)
def test_with_decoded_replaces_one_attribute(attribute: str) -> None:
    trained = group(0)
    decoded = differing(attribute, trained, group(1)).dynamic
    assert_equal(with_decoded(attribute, trained.dynamic, decoded), decoded)
    for unlike in set(STATIC) - {attribute}:
        assert_equal(with_decoded(unlike, trained.dynamic, decoded), trained.dynamic)


def test_decoded_shape_with_other_axes_keeps_rotation() -> None:
    """The codec may reorder axes. Rotation offsets refer to the axes of their own file."""
    trained, quarter = group(0), np.array([0.5**0.5, 0.5**0.5, 0, 0], np.float32)
    quats = rotations.multiply(trained.dynamic.quats, np.tile(quarter, (40, 1)))
    back = quarter * np.array([1, -1, -1, -1], np.float32)
    dq = rotations.multiply(
        rotations.multiply(np.broadcast_to(back, trained.dq.shape), trained.dq), quarter[None, None]
    )
    decoded = replace(trained, dynamic=replace(trained.dynamic, quats=quats), dq=dq.astype(np.float32))
    for attribute in ("shape", "turn"):
        seen = with_decoded_at(attribute, trained, decoded, 3.0)
        expected = decoded.at(3.0) if attribute == "shape" else trained.at(3.0)
        assert_equal(seen, expected)


def test_attribute_bytes_sum_sections() -> None:
    whole = group(0)
    file, order = encode_group(whole, EncodeConfig())
    assert set(attribute_bytes(file)) == set(SECTIONS)
    assert 0.5 * len(file) < sum(attribute_bytes(file).values()) < len(file)
    assert set(attribute_bytes(encode_layer(0, 0, whole.dynamic, EncodeConfig())[0])) == set(STATIC)
    np.testing.assert_array_equal(in_order(whole, order).at(1.0).means, whole.at(1.0).means[order])
