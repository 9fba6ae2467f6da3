"""Sound round trips through a reel at the reel's times."""

import dataclasses
import json
from itertools import pairwise

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.mp4 import RATE
from splatreel.codec.opus_sound import decode_sound, describe_sound, encode_sound, write_sound
from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import open_reel
from tests import flashes
from tests.codec.reels import edit_manifest, give_sound, new_group, new_writer, points, write_reel

TIMES = (0.5, 1.2345, 1.99, 2.1, 3.3, 3.99, 5.55)
MILLISECOND = 1e-3


def decoded(sound, first: int = 0) -> np.ndarray:
    """Return the whole sound of a stream of segments from `first` on."""
    parts = list(decode_sound(sound.init, list(sound.segments[first:]), sound.channels))
    assert parts[0][0] == round(sound.span(first)[0] * RATE), "the stream starts where its first segment does"
    assert all(b[0] == a[0] + len(a[1]) for a, b in pairwise(parts))
    return np.concatenate([part for _, part in parts])


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_clicks_keep_their_times_from_any_segment(channels: int, first: int) -> None:
    sound = encode_sound(np.array_split(flashes.clicks(TIMES, 6.5, channels), 11), channels)
    assert [sound.span(i) for i in range(4)] == [(0, 2), (2, 2), (4, 2), (6, 0.5)]
    start = sound.span(first)[0]
    expected = [time - start for time in TIMES if time >= start]
    np.testing.assert_allclose(flashes.onsets(decoded(sound, first)), expected, atol=MILLISECOND)


def test_speech_round_trips() -> None:
    rng = np.random.default_rng(0)
    waves = [np.sin(np.arange(3 * RATE) * 2 * np.pi * f / RATE + rng.random()) for f in (140, 280, 560, 1120)]
    tone = np.sum(waves, axis=0) / 8
    sound = encode_sound([tone[:, None]], 1)
    error = decoded(sound)[: len(tone), 0][4800:] - tone[4800:]
    assert 10 * np.log10((tone**2).mean() / (error**2).mean()) > 20
    rate = 8 * sum(map(len, sound.segments)) / 3
    assert rate < 100_000


def test_last_packet_is_padded() -> None:
    sound = encode_sound([np.ones((961, 1), np.float32)], 1)
    assert (sound.samples, sound.span(0)) == (1920, (0, 0.04))


def test_sound_bytes_do_not_depend_on_blocks() -> None:
    samples = flashes.clicks(TIMES, 6.5, 2)
    assert encode_sound(np.array_split(samples, 7), 2) == encode_sound([samples], 2)


def test_encoding_no_samples_is_an_error() -> None:
    with pytest.raises(ReelError, match="no sound"):
        encode_sound([], 1)


def test_write_sound_adds_and_removes_sound(tmp_path) -> None:
    reel = write_reel(tmp_path)
    before = (reel / "manifest.json").read_bytes()
    give_sound(reel, encode_sound([flashes.clicks()], 1), (1, 2, 3))
    sound = ReelReader(reel).manifest.presentation.sound
    assert sound.position == (1, 2, 3)
    assert [s.start for s in sound.segments] == [0, 2]
    assert verify_reel(reel).strangers == []
    give_sound(reel, encode_sound([flashes.clicks((0.2,), 1.0, 2)], 2))
    assert ReelReader(reel).manifest.presentation.sound.channels == 2
    assert verify_reel(reel).strangers == [], "the second segment of the first sound is gone"
    give_sound(reel, None)
    assert (reel / "manifest.json").read_bytes() == before, "no sound, no bytes"
    assert not list((reel / "sound").glob("*"))


def test_live_reel_has_sound_from_the_first_group(tmp_path) -> None:
    sound = encode_sound([flashes.clicks()], 1)
    writer = new_writer(tmp_path)
    write_sound(writer, sound)
    assert not (tmp_path / "manifest.json").exists()
    writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(0, 15, 20))
    manifest = ReelReader(tmp_path).manifest
    assert manifest.live
    assert len(manifest.presentation.sound.segments) == 2
    verify_reel(tmp_path)
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.m*")}
    write_sound(new_writer(tmp_path, resume=True), sound)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.m*")} == stamps, "it is there already"
    (tmp_path / "sound" / "0001.m4s").unlink()
    write_sound(new_writer(tmp_path, resume=True), sound)
    verify_reel(tmp_path)


def test_verify_finds_damaged_sound(tmp_path) -> None:
    reel = write_reel(tmp_path)
    give_sound(reel, encode_sound([flashes.clicks()], 1))
    file = reel / "sound" / "0001.m4s"
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + b"\0")
    with pytest.raises(ReelError, match=r"0001\.m4s.*sha256") as error:
        verify_reel(reel)
    assert str(error.value).count("\n") == 0
    file.unlink()
    with pytest.raises(ReelError, match=r"0001\.m4s"):
        verify_reel(reel)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"channels": 2}, "1 channels.*expected 2"),
        ({"segments": [{}, {"start": 2.5}]}, "has sound at 2.000 s, expected 2.500 s"),
        ({"segments": [{"seconds": 1}, {}]}, "holds sound up to"),
        ({"segments": [{}, {"seconds": 3000}]}, "up to 4.000 s, not 3002.000 s"),
    ],
)
def test_verify_finds_wrong_sound_times(tmp_path, change, said) -> None:
    reel = write_reel(tmp_path)
    give_sound(reel, encode_sound([flashes.clicks()], 1))

    def forge(document):
        segments = [a | b for a, b in zip(document["sound"]["segments"], change.get("segments", [{}, {}]), strict=True)]
        document["sound"] |= change | {"segments": segments}

    edit_manifest(reel, forge)
    with pytest.raises(ReelError, match=said):
        verify_reel(reel)


@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"RIFF" + bytes(60)], ids=["empty", "zeros", "other"])
def test_data_without_sound_is_refused(data) -> None:
    sound = encode_sound([flashes.clicks()], 1)
    with pytest.raises(ReelError):
        list(decode_sound(data, list(sound.segments), 1))


def test_removing_sound_keeps_point_files(tmp_path) -> None:
    """A manifest may name any file as sound. Removing the sound must not delete a group."""
    reel = write_reel(tmp_path)
    give_sound(reel, encode_sound([flashes.clicks()], 1))

    def forge(document):
        group = document["groups"][1]
        document["sound"]["segments"][1] |= {name: group[name] for name in ("uri", "bytes", "sha256")}
        document["sound"]["init"]["uri"] = "manifest.json"

    edit_manifest(reel, forge)
    give_sound(reel, encode_sound([flashes.clicks((0.1,), 0.5)], 1))
    assert verify_reel(reel).groups == 2
    edit_manifest(reel, lambda d: d["sound"]["init"].update({k: d["layers"][0][k] for k in ("uri", "bytes", "sha256")}))
    give_sound(reel, None)
    assert verify_reel(reel).groups == 2


def test_damaged_sound_raises_reel_error_or_decodes(tmp_path) -> None:
    """With any changed bytes, decoding raises `ReelError` or continues, in bounded time."""
    rng = np.random.default_rng(0)
    init, data = ((flashes.GOLDEN / "sound" / name).read_bytes() for name in ("init.mp4", "0001.m4s"))
    for _ in range(300):
        spoilt = bytearray(init + data)
        for at in rng.integers(0, len(init) + 600, 3):
            spoilt[at] = rng.integers(256)
        length = 0
        try:
            for _, part in decode_sound(bytes(spoilt[: len(init)]), [bytes(spoilt[len(init) :])], 1):
                assert part.shape[1] == 1
                length += len(part)
        except ReelError:
            continue
        assert length <= 120 * 100 * RATE // 1000


def test_verify_finds_truncated_segments(tmp_path) -> None:
    reel = write_reel(tmp_path)
    sound = encode_sound([flashes.clicks()], 1)
    give_sound(reel, dataclasses.replace(sound, segments=(sound.segments[0], sound.segments[1][:5000])))
    with pytest.raises(ReelError, match=r"0001\.m4s"):
        verify_reel(reel)


def test_golden_sound_is_unchanged() -> None:
    """The committed bytes, and a new encoding, decode to clicks at the times of the flashes."""
    assert verify_reel(flashes.GOLDEN).groups == 4
    manifest = ReelReader(flashes.GOLDEN).manifest
    sound = manifest.presentation.sound
    assert (sound.type, sound.rate, sound.channels) == ('audio/mp4; codecs="opus"', RATE, 1)
    assert sound.position == flashes.POSITION
    files = [(flashes.GOLDEN / asset.uri).read_bytes() for asset in manifest.presentation.assets]
    found = np.concatenate([part for _, part in decode_sound(files[0], files[1:], 1)])
    np.testing.assert_allclose(flashes.onsets(found), flashes.CLICKS, atol=MILLISECOND)
    fresh = decoded(encode_sound([flashes.clicks()], 1))
    np.testing.assert_allclose(flashes.onsets(fresh), flashes.CLICKS, atol=MILLISECOND)
    assert fresh.shape == found.shape


def test_golden_sound_manifest_is_unchanged() -> None:
    document = json.loads((flashes.GOLDEN / "manifest.json").read_text())
    entry = document["sound"]["segments"][1]
    assert (entry["uri"], entry["start"], entry["seconds"]) == ("sound/0001.m4s", 2, 2)
    assert dataclasses.asdict(ReelReader(flashes.GOLDEN).manifest.presentation)["sound"]["segments"][1]["start"] == 2


def test_retention_drops_sound_but_keeps_one_earlier_segment(tmp_path) -> None:
    """Groups have two frames at 2 frames per second, so group g starts at g seconds."""
    sound = encode_sound([flashes.clicks(TIMES, 9.5, 1)], 1)

    def kept() -> list[float]:
        heard = ReelReader(tmp_path).manifest.presentation.sound
        assert heard is not None
        assert sorted(path.name for path in (tmp_path / "sound").iterdir()) == sorted(
            asset.uri.removeprefix("sound/") for asset in heard.assets
        )
        return [segment.start for segment in heard.segments]

    writer = new_writer(tmp_path, fps=2)
    write_sound(writer, sound)
    for index in range(8):
        writer.add_group(new_group(index, 3, 0))
    assert kept() == [0, 2, 4, 6, 8]
    writer.drop_before(3)
    assert kept() == [0, 2, 4, 6, 8]
    writer.drop_before(5)
    assert kept() == [2, 4, 6, 8]
    writer = new_writer(tmp_path, fps=2, resume=True)
    write_sound(writer, sound)  # as whoever resumes does
    assert kept() == [2, 4, 6, 8]
    writer.drop_before(7)
    assert kept() == [4, 6, 8]
    heard = open_reel(tmp_path).sound
    assert heard is not None
    np.testing.assert_allclose(flashes.onsets(heard.samples(5, 4)), [0.55], atol=MILLISECOND)
    assert verify_reel(tmp_path).strangers == []


def test_trimmed_sound_keeps_its_last_segment() -> None:
    said = describe_sound(encode_sound([flashes.clicks(TIMES, 6.5, 1)], 1), None)
    assert [segment.start for segment in said.trimmed_before(100).segments] == [6]
    assert said.trimmed_before(0) == said
