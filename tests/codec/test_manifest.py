"""manifest.json: round trip, forward compatibility, hostile content."""

import contextlib
import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import ReelError
from splatreel.codec.header import BLACK
from splatreel.codec.manifest import MAX_BYTES, parse_manifest
from splatreel.scene.clearance import NONE, Clearance
from tests.golden import GOLDEN

TEXT = (GOLDEN / "manifest.json").read_text()


def edited(change) -> bytes:
    document = json.loads(TEXT)
    change(document)
    return json.dumps(document).encode()


def test_manifest_round_trips():
    assert parse_manifest(TEXT.encode(), "m").to_json() == TEXT


def test_cameras_round_trip_in_few_digits():
    manifest = parse_manifest(TEXT.encode(), "m")
    rng = np.random.default_rng(0)
    viewmat, K = rng.normal(size=(4, 4)).astype(np.float32), (1000 * rng.random((3, 3))).astype(np.float32)
    camera = dataclasses.replace(manifest.camera, viewmat=viewmat, K=K)
    text = dataclasses.replace(manifest, cameras=(camera,)).to_json()
    found = parse_manifest(text.encode(), "m").cameras[0]
    np.testing.assert_array_equal(found.viewmat, viewmat)
    np.testing.assert_array_equal(found.K, K)
    line = next(line for line in text.splitlines() if line.startswith('{"name"'))
    assert len(line) < 60 + 13 * 25


def test_unknown_manifest_fields_are_ignored():
    def change(d):
        d["mood"] = "blue"
        d["groups"][0]["weather"] = 3

    assert parse_manifest(edited(change), "m").to_json() == TEXT


def test_clearance_round_trips_and_defaults_to_none():
    manifest = parse_manifest(TEXT.encode(), "m")
    assert manifest.clearance == NONE
    assert "clearance" not in manifest.to_json()
    found = dataclasses.replace(manifest, clearance=Clearance((1.0, -2.5, 0.0), 0.25))
    assert parse_manifest(found.to_json().encode(), "m").clearance == found.clearance


def test_origin_round_trips_in_64_bits_and_defaults_to_zero():
    manifest = parse_manifest(TEXT.encode(), "m")
    assert not manifest.origin.any()
    assert "origin" not in manifest.to_json()
    found = dataclasses.replace(manifest, origin=np.array([5411000.123456789, -1e-9, 3]))
    assert parse_manifest(found.to_json().encode(), "m").origin.tolist() == [5411000.123456789, -1e-9, 3]
    for wrong in ([1, 2], [1, 2, "3"], "here"):
        with pytest.raises(ReelError, match="origin"):
            parse_manifest(edited(lambda d, value=wrong: d.update(origin=value)), "m")


def test_background_round_trips_and_defaults_to_black():
    manifest = parse_manifest(TEXT.encode(), "m")
    assert manifest.background == BLACK
    assert "background" not in manifest.to_json()
    found = dataclasses.replace(manifest, background=(0.25, 1.0, 0.0))
    assert parse_manifest(found.to_json().encode(), "m").background == found.background


def test_static_points():
    manifest = parse_manifest(TEXT.encode(), "m")
    assert [manifest.static_points(g) for g in (0, 1)] == [150, 200]


@pytest.mark.parametrize(
    "uri",
    [
        "../x",
        "/etc/passwd",
        "a/../b",
        "http://e.org/x",
        "//e.org/x",
        "a\\b",
        "a//b",
        ".hidden",
        "a/",
        "",
        "C:/x",
        "a?b",
        "a\n",
        7,
    ],
)
def test_uris_outside_the_reel_are_refused(uri):
    with pytest.raises(ReelError, match=r"^m: groups\[1\] has the uri"):
        parse_manifest(edited(lambda d: d["groups"][1].update(uri=uri)), "m")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(version=3), "version 3"),
        (lambda d: d.update(version=True), "version True"),
        (lambda d: d.update(format="mp4"), "not the manifest"),
        (lambda d: d.update(fps=0), "fps"),
        (lambda d: d.update(fps=float("nan")), "NaN is not a finite number"),
        (lambda d: d.update(fps=10**400), "not a finite number"),
        (lambda d: d.update(frames=-1), "frames"),
        (lambda d: d.update(background=[0.1, 0.2]), "background"),
        (lambda d: d.update(background=[0.1, 0.2, 1.2]), "background"),
        (lambda d: d.update(background="gray"), "background"),
        (lambda d: d.update(clearance=0.3), "clearance"),
        (lambda d: d.update(clearance={"focus": [0, 0, 0]}), "share"),
        (lambda d: d.update(clearance={"focus": [0, 0, 0], "share": 1.5}), "share"),
        (
            lambda d: d.update(clearance={"focus": [0, float("inf"), 0], "share": 0.3}),
            "Infinity is not a finite number",
        ),
        (lambda d: d.update(frames=1.5), "frames"),
        (lambda d: d.update(live="no"), "live"),
        (lambda d: d.update(sh_degree=4), "sh_degree"),
        (lambda d: d.update(bounds=[[0, 0, 0]]), "bounds"),
        (lambda d: d.update(bounds=[[1, 1, 1], [0, 0, 0]]), "bounds"),
        (lambda d: d.update(bounds=[[0, 0, float("nan")], [1, 1, 1]]), "NaN is not a finite number"),
        (lambda d: d.update(up=[0, 1]), "up"),
        (lambda d: d.update(camera=None), "camera"),
        (lambda d: d["cameras"][0].update(K=[1] * 8), "camera 'cam00' has K"),
        (lambda d: d["cameras"][0].update(width=0), "width"),
        (lambda d: d.update(groups=[]), "no group|layer of group"),
        (lambda d: d["groups"].reverse(), "order"),
        (lambda d: d["layers"].reverse(), "order"),
        (lambda d: d["layers"][1].update(group=2), "layer of group 2"),
        (lambda d: d["layers"][0].update(sha256="00"), r"layers\[0\] has the sha256"),
        (lambda d: d["groups"][0].update(bytes=1 << 60), r"groups\[0\] has bytes"),
        (lambda d: d["groups"][0].update(points=-3), r"groups\[0\] has points"),
        (lambda d: d.update(groups=["x"]), r"groups\[0\] is not an object"),
        (lambda d: d.pop("overlap"), "overlap"),
    ],
)
def test_hostile_manifest_fields_are_refused(change, message):
    with pytest.raises(ReelError, match=message):
        parse_manifest(edited(change), "m")


def with_renditions(d):
    digest = "0" * 64
    for i, group in enumerate(d["groups"]):
        low = {"uri": f"groups/{i}.low", "bytes": 100 + i, "sha256": digest, "points": 7}
        group["renditions"] = {"low": low, "unknown": None}
    sizes = {"high": sum(g["bytes"] for g in d["groups"]), "low": 201}
    d["renditions"] = [{"name": name, "bytes": size} for name, size in sizes.items()]


def test_renditions_round_trip():
    manifest = parse_manifest(edited(with_renditions), "m")
    assert manifest.renditions == ("high", "low")
    again = parse_manifest(manifest.to_json().encode(), "m")
    assert (again.renditions, again.groups) == (manifest.renditions, manifest.groups)
    assert len(manifest.files) == len(manifest.layers) + 4
    low = manifest.select_rendition("low")
    assert [(g.uri, g.bytes, g.points, g.first_frame) for g in low.groups] == [
        (f"groups/{i}.low", 100 + i, 7, group.first_frame) for i, group in enumerate(manifest.groups)
    ]
    assert (low.renditions, low.layers) == ((), manifest.layers)
    assert [g.uri for g in manifest.select_rendition("high").groups] == [g.uri for g in manifest.groups]
    with pytest.raises(ReelError, match="no rendition 'medium'; it has high, low"):
        manifest.select_rendition("medium")
    with pytest.raises(ReelError, match="has no renditions"):
        low.select_rendition("high")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["groups"][1].pop("renditions"), r"groups\[1\] lacks one of"),
        (lambda d: d["groups"][0].update(renditions=[]), r"groups\[0\] lacks one of"),
        (lambda d: d["groups"][0]["renditions"]["low"].update(uri="../x"), r"groups\[0\] has the uri"),
        (
            lambda d: d["groups"][0]["renditions"]["low"].update(bytes=99),
            "rendition low has 201 bytes; its groups have 200",
        ),
        (lambda d: d["renditions"][0].update(bytes=1), "rendition high has 1 bytes"),
        (lambda d: d["renditions"][1].update(name="high"), "names"),
        (lambda d: d["renditions"][1].update(name="../x"), "names"),
        (lambda d: d["renditions"][1].update(name=["low"]), "names"),
        (lambda d: d.update(renditions=["high", "low"]), "names"),
        (lambda d: d.update(renditions={}), "renditions that are not a list"),
    ],
)
def test_hostile_renditions_are_refused(change, message):
    def both(d):
        with_renditions(d)
        change(d)

    with pytest.raises(ReelError, match=message):
        parse_manifest(edited(both), "m")


@pytest.mark.parametrize("data", [b"", b"[]", b"null", b"{", b"\xff\xfe", b"[" * 100_000, b" " * (MAX_BYTES + 1)])
def test_other_json_is_refused(data):
    with pytest.raises(ReelError, match=r"^m: "):
        parse_manifest(data, "m")


@settings(deadline=None)
@given(st.data())
def test_damaged_manifest_raises_reel_error_or_parses(data):
    text = bytearray(TEXT.encode())
    for at in data.draw(st.lists(st.integers(0, len(text) - 1), min_size=1, max_size=3)):
        text[at] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ReelError):
        parse_manifest(bytes(text), "m")
