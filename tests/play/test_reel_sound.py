"""Sound of a reel in Python: flashes and clicks of the golden reel coincide."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.opus_sound import encode_sound
from splatreel.play.server import serve
from splatreel.play.timeline import open_reel
from tests import flashes, golden
from tests.codec.reels import edit_manifest, give_sound, write_reel

RATE = 48000


def test_reel_sound_is_synchronized() -> None:
    reel = open_reel(flashes.GOLDEN)
    sound = reel.sound.samples(0, reel.duration)
    np.testing.assert_allclose(flashes.onsets(sound), flashes.CLICKS, atol=1e-3)
    for click in flashes.CLICKS:
        before, at, after = (_brightness(reel, click + away) for away in (-0.5 / flashes.FPS, 0, 0.5 / flashes.FPS))
        assert after > 5 * before
        assert at == pytest.approx((before + after) / 2, abs=0.05)


def _brightness(reel, seconds: float) -> float:
    return float(reel.render(reel.at(seconds), reel.manifest.camera.resized(40, 30)).mean())


def test_samples_do_not_depend_on_start(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 0.1, (6 * RATE, 2)).astype(np.float32)
    reel = write_reel(tmp_path)
    give_sound(reel, encode_sound([noise], 2), (1, 2, 3))
    sound = open_reel(reel).sound
    assert (sound.rate, sound.channels, sound.position, sound.duration) == (RATE, 2, (1, 2, 3), 6)
    whole = sound.samples(0, 6)
    assert whole.dtype == np.float32
    for start in (0.0, 0.7, 1.95, 2.0, 3.99, 4.03):
        part = sound.samples(start, 1.5)
        assert part.shape == (1.5 * RATE, 2)
        first = round(start * RATE)
        error = np.abs(part - whole[first : first + len(part)])
        assert error.max() < 0.02, start
        assert error[RATE // 20 :].max() < 1e-3, start


def test_samples_outside_of_sound_are_silent() -> None:
    sound = open_reel(flashes.GOLDEN).sound
    around = sound.samples(-1, 6)
    assert around.shape == (6 * RATE, 1)
    assert np.abs(around[:RATE]).max() == 0 == np.abs(around[5 * RATE :]).max()
    np.testing.assert_allclose(flashes.onsets(around) - 1, flashes.CLICKS, atol=1e-3)
    assert not sound.samples(100, 0.5).any()
    assert sound.samples(1, 0).shape == (0, 1)


def test_reel_sound_over_http() -> None:
    with serve(flashes.GOLDEN, port=0) as server:
        sound = open_reel(f"{server.url}reel/manifest.json").sound
        found = flashes.onsets(sound.samples(1, 2))
    np.testing.assert_allclose(found + 1, flashes.CLICKS[1:3], atol=1e-3)


def test_silent_reel_has_no_sound() -> None:
    assert open_reel(golden.GOLDEN).sound is None


def test_sound_with_false_claims_is_refused(tmp_path: Path) -> None:
    reel = tmp_path / "reel"
    shutil.copytree(flashes.GOLDEN, reel)
    edit_manifest(reel, lambda document: document["sound"].update(channels=2))
    with pytest.raises(ReelError, match=r"0000\.m4s.*expected 2"):
        open_reel(reel).sound.samples(0, 1)
    edit_manifest(reel, lambda document: document["sound"].update(channels=1, type='audio/mp4; codecs="mp4a.40.2"'))
    with pytest.raises(ReelError, match="only"):
        open_reel(reel).sound.samples(0, 1)
    edit_manifest(reel, lambda document: document["sound"].update(type='audio/mp4; codecs="opus"'))
    edit_manifest(reel, lambda document: document["sound"]["segments"][0].update(seconds=0.1))
    with pytest.raises(ReelError, match="longer than the manifest says"):
        open_reel(reel).sound.samples(0, 1)
    edit_manifest(reel, lambda document: document["sound"]["segments"][0].update(seconds=1e-3, bytes=1 << 20))
    with pytest.raises(ReelError, match="too many for Opus"):
        open_reel(reel).sound.samples(0, 1)
