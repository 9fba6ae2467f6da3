"""Where points meet their pictures closely, steps get finer, until encoding costs as little as elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.config import EncodeConfig
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.coverage.trial import Trial
from splatreel.recon.encode.fineness import FINEST, GROUP_LOSS, LAYER_LOSS, encode_group, encode_layer
from splatreel.recon.init.layout import Layout
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints
from tests.recon.captures import blots
from tests.recon.scenes import ring

FRAMES = 4
CLOSE = Trial("cam00", 10.0, 99.0, 12.0, 12.0)
"""A trial after which new views are no worse than others."""


def uneven(points: Gaussians) -> Gaussians:
    """Of other sizes and opacities: of equal ones, errors of rounding are equal as well."""
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
    """What the cameras see of both. noise: standard deviation, gray levels."""
    cameras = ring(4, width=96, height=64)
    blank = np.zeros((FRAMES, len(cameras), 64, 96, 3), np.uint8)
    layout = Layout(0.1, 4.0, [0.0, -1, 0], [[-3.0, -2, -1], [3, 2, 1]], background=(0.2, 0.3, 0.4))
    gains, late = np.full((len(cameras), 3), 1.1, np.float32), np.zeros(len(cameras))
    span, cpu = GroupSpan(0, 0, FRAMES, FRAMES), torch.device("cpu")
    data = GroupInput(span, blank, cameras, gains, late, None, layout, cpu, 0, False)
    rng, group = np.random.default_rng(0), moving()
    for frame in range(FRAMES):
        for c, camera in enumerate(cameras):
            picture = 255 * 1.1 * data.draw(Gaussians.concatenate([group.at(float(frame)), WALL]), camera)
            blank[frame, c] = np.rint(picture + rng.normal(0, noise, picture.shape)).clip(0, 255)
    return data


def lost(data: GroupInput, thing: Group, wall: Gaussians) -> float:
    """Decibels by which these are farther from the pictures than the points themselves, over all frames and cameras."""
    errors = []
    for group, resting in ((moving(), WALL), (thing, wall)):
        every = (Gaussians.concatenate([group.at(float(frame)), resting]) for frame in range(FRAMES))
        shown = [[np.clip(1.1 * data.draw(points, c), 0, 1) for c in data.cameras] for points in every]
        errors.append(np.square(np.array(shown) - data.images / 255).mean())
    return float(10 * np.log10(errors[1] / errors[0]))


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_a_layer_loses_little_however_close_it_is(noise: float) -> None:
    data, importance, encoder = seen(noise), np.ones((len(WALL), 3), np.float32), ReelEncoder(EncodeConfig())
    (file, order), fineness = encode_layer(encoder, data, WALL, THING, importance, CLOSE)
    assert FINEST <= fineness < 1
    assert sorted(order) == list(range(len(WALL)))
    usual = encoder.layer(0, 0, WALL, importance)[0]
    assert len(file) > len(usual)
    assert lost(data, moving(), decode_layer(usual, "layer")[1]) > 2 * LAYER_LOSS
    assert lost(data, moving(), decode_layer(file, "layer")[1]) < 1.5 * LAYER_LOSS


def test_a_group_loses_less_where_it_is_close() -> None:
    data, encoder, static = seen(1.0), ReelEncoder(EncodeConfig()), StaticPoints(WALL, np.ones(len(WALL), bool))
    importance, uri = np.ones((len(THING), 3), np.float32), "groups/0000.safetensors"
    files, fineness = encode_group(encoder, data, moving(), static, importance, CLOSE)
    assert FINEST <= fineness < 1
    usual = encoder.group(moving(), importance)[uri]
    assert len(files[uri]) > len(usual)
    losses = [lost(data, decode_group(made, "group"), WALL) for made in (usual, files[uri])]
    assert losses[0] > 2 * GROUP_LOSS
    assert losses[1] < 0.5 * losses[0]


def test_where_noise_hides_it_the_steps_are_the_usual_ones() -> None:
    data, importance, encoder = seen(40.0), np.ones((len(WALL), 3), np.float32), ReelEncoder(EncodeConfig())
    (file, _), fineness = encode_layer(encoder, data, WALL, THING, importance, CLOSE)
    assert fineness == 1
    assert file == encoder.layer(0, 0, WALL, importance)[0]


def test_what_new_views_hide_needs_no_finer_steps() -> None:
    data, importance, encoder = seen(1.0), np.ones((len(WALL), 3), np.float32), ReelEncoder(EncodeConfig())

    def fineness(trial: Trial | None) -> float:
        return encode_layer(encoder, data, WALL, THING, importance, trial)[1]

    assert fineness(CLOSE) < fineness(replace(CLOSE, psnr=44.0)) < 1
    assert fineness(replace(CLOSE, psnr=30.0)) == 1
    assert fineness(None) == 1


def test_the_papers_codec_has_the_paper_s_steps() -> None:
    data, encoder = seen(1.0), ReelEncoder(EncodeConfig(codec="h265"))
    assert encode_layer(encoder, data, WALL, THING, np.ones((len(WALL), 3), np.float32), CLOSE)[1] == 1
