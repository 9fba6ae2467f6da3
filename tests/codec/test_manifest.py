"""manifest.json: round trip, forward compatibility, hostile content."""

import contextlib
import dataclasses
import gzip
import hashlib
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import ReelError
from splatreel.codec.header import BLACK
from splatreel.codec.inspection import verify_reel
from splatreel.codec.manifest import MAX_BYTES, MAX_PAGE_BYTES, PAGE, FileEntry, Manifest, make_page, parse_manifest
from splatreel.codec.reader import ReelReader
from splatreel.scene.clearance import NONE, Clearance
from tests.codec.reels import edit_manifest, write_chapters
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


PLAIN = parse_manifest((GOLDEN / "manifest.json").read_bytes(), "m")
NAMES = "high", "low"


def entry(kind: str, number: int, more: str = "", **fields) -> FileEntry:
    digest = hashlib.sha256(f"{kind} {number} {more}".encode()).hexdigest()
    frames: dict[str, Any] = {"frames": 8} if kind == "groups" else {"frames": 0}
    plain: dict[str, Any] = {
        "uri": f"{kind}/{number:04d}{more}.safetensors",
        "bytes": 5000 + number,
        "sha256": digest,
        "points": 20,
    }
    return FileEntry(**(plain | frames | {"first_frame": 6 * number, "group": number} | fields))  # pyright: ignore[reportArgumentType]


def paged(layers, groups, page: int, first: int = 0, names=()) -> tuple[Manifest, dict[str, bytes]]:
    """Return the manifest of some files as a writer splits it, and its pages by URI."""
    manifest = dataclasses.replace(PLAIN, renditions=names, first_group=first).with_files(layers, groups)
    count = max(len(groups) // page - 1, 0) if page else 0
    made = [make_page(layers, manifest.groups[i * page : (i + 1) * page], names) for i in range(count)]
    return dataclasses.replace(manifest, pages=tuple(p for p, _ in made)), {p.uri: data for p, data in made}


def parsed(manifest: Manifest, files: dict[str, bytes]) -> Manifest:
    return parse_manifest(manifest.to_json().encode(), "m", lambda uri, limit: files[uri][: limit + 1])


@st.composite
def reels(draw):
    """Generate layers with any lifetimes and groups, with or without renditions, and positions of the first group and the pages."""
    first, count = draw(st.integers(0, 5)), draw(st.integers(1, 12))
    names = draw(st.sampled_from([(), NAMES]))
    groups = [entry("groups", first + i) for i in range(count)]
    if names:
        groups = [dataclasses.replace(g, renditions={"low": entry("groups", g.group, ".low", bytes=7)}) for g in groups]
    layers = []
    for born in range(first + count):
        lives = draw(st.lists(st.none() | st.integers(max(born, first) + 1, first + count + 3), max_size=3))
        lives.sort(key=lambda until: -(1 << 41) if until is None else -until)
        layers += [entry("layers", born, f".{i}", until=until) for i, until in enumerate(lives)]
    return layers, groups, draw(st.integers(1, 4)), first, names


@settings(deadline=None, max_examples=150)
@given(reels())
def test_pages_join_to_the_same_manifest(reel):
    layers, groups, page, first, names = reel
    manifest, files = paged(layers, groups, page, first, names)
    found = parsed(manifest, files)
    assert (found.layers, found.pages) == (tuple(layers), manifest.pages)
    assert [g.uri for g in found.groups] == [g.uri for g in groups]
    assert [g.group for g in found.groups] == list(range(first, first + len(groups)))
    assert found.to_json() == manifest.to_json()
    for group in groups:
        living = [i for i, x in enumerate(layers) if x.lives_at(group.group)]
        assert found.living_layers(group.group) == living
        assert found.static_points(group.group) == 20 * len(living)


@settings(deadline=None, max_examples=100)
@given(reels(), st.data())
def test_one_page_and_the_manifest_suffice_for_its_groups(reel, data):
    """A player that starts late uses the layers of the manifest and of one page, in order of birth."""
    layers, groups, page, first, names = reel
    manifest, files = paged(layers, groups, page, first, names)
    if not files:
        return
    index = data.draw(st.integers(0, len(files) - 1))
    own = json.loads(manifest.to_json())["layers"]
    there = json.loads(files[manifest.pages[index].uri])["layers"]
    known = sorted([*own, *(x for x in there if x not in own)], key=lambda x: x["group"])
    start = first + sum(p.groups for p in manifest.pages[:index])
    for number in range(start, start + manifest.pages[index].groups):
        lives = [x["uri"] for x in known if x["group"] <= number < x.get("until", 1 << 50)]
        assert lives == [layers[i].uri for i in manifest.living_layers(number)]


def test_version_is_as_low_as_possible():
    assert json.loads(PLAIN.to_json())["version"] == 1
    groups = [entry("groups", i) for i in range(2)]
    for layers, first, version in (
        ([entry("layers", 0), entry("layers", 1)], 0, 1),
        ([entry("layers", 0, until=1)], 0, 2),
        ([entry("layers", 0), entry("layers", 0, ".1")], 0, 2),
        ([entry("layers", 0)], 3, 2),
    ):
        moved = [dataclasses.replace(g, group=g.group + first) for g in groups]
        manifest, _ = paged(layers, moved, 0, first)
        assert json.loads(manifest.to_json())["version"] == version
        assert parsed(manifest, {}).layers == tuple(layers)


def test_version_1_ignores_fields_of_version_2():
    """Readers of version 1 ignore unknown fields and refuse two layers of one group."""
    layers = [entry("layers", 0, until=1), entry("layers", 1)]
    document = json.loads(paged(layers, [entry("groups", i) for i in range(2)], 0)[0].to_json())
    document |= {"version": 1, "first_group": 7, "pages": "none"}
    found = parse_manifest(json.dumps(document).encode(), "m")
    assert (found.first_group, found.pages, found.layers[0].until) == (0, (), None)
    document["layers"][1]["group"] = 0
    with pytest.raises(ReelError, match="layers that are not in order"):
        parse_manifest(json.dumps(document).encode(), "m")


def test_manifest_of_an_hour_is_small():
    """10,000 groups in chapters of ten: a shared layer, one per chapter, and one for every second group, retired with it."""
    layers = [entry("layers", 0)]
    for i in range(10_000):
        if i % 2 == 0:
            layers.append(entry("layers", i, ".1" if i == 0 else "", until=i // 10 * 10 + 10))
    manifest, files = paged(layers, [entry("groups", i) for i in range(10_000)], PAGE)
    text = manifest.to_json().encode()
    assert len(gzip.compress(text)) < 100_000
    assert len(text) < 1_000_000
    found = parsed(manifest, files)
    assert (len(found.groups), len(found.pages), len(found.layers)) == (10_000, 155, 5001)


@pytest.fixture(scope="module")
def reel(tmp_path_factory):
    return write_chapters(tmp_path_factory.mktemp("chapters") / "reel", groups=9)


def forged(reel, tmp_path, change, page=None):
    """Return a copy of the manifest with a change; a changed page gets matching length and digest."""
    files = {p.relative_to(reel).as_posix(): p.read_bytes() for p in (reel / "pages").iterdir()}
    document = json.loads((reel / "manifest.json").read_text())
    if page is None:
        change(document)
    else:
        said = document["pages"][page]
        inside = json.loads(files[said["uri"]])
        change(inside)
        data = files[said["uri"]] = json.dumps(inside).encode()
        said.update(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
    return parse_manifest(json.dumps(document).encode(), "m", lambda uri, limit: files[uri][: limit + 1])


def test_unchanged_forged_manifest_is_read(reel, tmp_path):
    for page in (None, 0, 2):
        assert len(forged(reel, tmp_path, lambda d: None, page).pages) == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(pages={}), "pages that are not a list"),
        (lambda d: d.update(pages=[3]), r"pages\[0\] is not an object"),
        (lambda d: d.update(pages=d["pages"] * 6000), "pages that are not a list"),
        (lambda d: d["pages"][0].update(uri="../x"), r"pages\[0\] has the uri"),
        (lambda d: d["pages"][0].update(bytes=MAX_PAGE_BYTES + 1), r"pages\[0\] has bytes"),
        (lambda d: d["pages"][0].update(bytes=10), "pages/000000.json: is damaged"),
        (lambda d: d["pages"][1].update(sha256="0" * 64), "pages/000002.json: is damaged"),
        (lambda d: d["pages"][0].update(groups=0), r"pages\[0\] has groups"),
        (lambda d: d["pages"][0].update(groups=1 << 40), r"pages\[0\] has groups"),
        (lambda d: d["pages"][0].update(groups=3), "groups that are not a list of 3"),
        (lambda d: d["pages"][0].update(first_frame=1), "first frame"),
        (lambda d: d["pages"][0].update(frames=6), "first frame"),
        (lambda d: d["pages"].pop(0), "lists other layers|layer of group"),
        (lambda d: d["pages"].reverse(), "lists other layers|order"),
        (lambda d: d["pages"].extend([d["pages"][0] | {"bytes": MAX_PAGE_BYTES}] * 70), "pages of more than"),
        (lambda d: d.update(groups=[]), "no group"),
        (lambda d: d["groups"].pop(0), "lists other layers"),
        (lambda d: (d["groups"].pop(), d["layers"].pop()), "frames"),
        (lambda d: d.update(first_group=-1), "first_group"),
        (lambda d: d.update(first_group=1.5), "first_group"),
        (lambda d: d.update(first_group=1 + (1 << 31)), "first_group"),
        (lambda d: d["pages"][0].update(frames=1 + (1 << 31)), r"pages\[0\] has frames"),
        (lambda d: d.update(first_group=1), "lists other layers"),
        (lambda d: d["layers"][1].update(until=4), r"layers\[1\] has until"),
        (lambda d: d["layers"][1].update(until="8"), r"layers\[1\] has until"),
        (lambda d: d["layers"][1].update(until=7), "different things"),
        (lambda d: d["layers"][1].update(bytes=7), "different things|more points"),
        (lambda d: d["layers"].reverse(), "order of birth"),
        (lambda d: d["layers"].append(d["layers"][-1]), "order of birth"),
        (lambda d: d["layers"].pop(1), "lists other layers in the manifest itself"),
        (lambda d: d["layers"][0].update(until=4), "lists other layers"),
    ],
)
def test_hostile_version_2_manifests_are_refused(reel, tmp_path, change, message):
    with pytest.raises(ReelError, match=f"^m: .*({message})"):
        forged(reel, tmp_path, change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.clear(), "pages/000002.json: has layers that are not a list"),
        (lambda d: d.update(groups=[]), "groups that are not a list of 2"),
        (lambda d: d["groups"].reverse(), "first frame"),
        (lambda d: d["groups"][0].update(uri="/etc/passwd"), r"pages/000002.json: groups\[0\] has the uri"),
        (lambda d: d["groups"][1].update(frames=1 << 30), r"pages/000002.json: groups\[1\] has frames"),
        (lambda d: d["groups"][1].update(points=1 << 30), r"pages/000002.json: groups\[1\] has points"),
        (lambda d: d["layers"].pop(), "lists other layers in the page of groups 2 to 3"),
        (lambda d: d["layers"].reverse(), "order of birth"),
        (lambda d: d["layers"][0].pop("until"), "different things"),
        (lambda d: [x.update(points=131_000) for x in d["layers"]], r"pages/000002.json: has layers of more points"),
        (lambda d: d["layers"].append(d["layers"][1]), "order of birth"),
        (lambda d: d["layers"].append(d["layers"][1] | {"uri": "x", "group": 4, "until": 8}), "lists other layers"),
    ],
)
def test_hostile_pages_are_refused(reel, tmp_path, change, message):
    with pytest.raises(ReelError, match=f"^m: .*({message})"):
        forged(reel, tmp_path, change, page=1)


def test_page_with_an_unlisted_layer_is_refused(reel, tmp_path):
    """All lists must describe a layer identically and name it wherever it lives."""

    def extend(document):
        document["layers"].insert(0, document["layers"][0] | {"uri": "layers/x", "group": 0, "until": 7})

    with pytest.raises(ReelError, match="lists other layers in the page of groups 0 to 1"):
        forged(reel, tmp_path, extend, page=1)


def test_manifest_with_pages_needs_fetch():
    manifest, _ = paged([], [entry("groups", i) for i in range(8)], 2)
    with pytest.raises(ReelError, match="m: has pages, and is not read alone"):
        parse_manifest(manifest.to_json().encode(), "m")


def test_rendition_bytes_include_all_pages():
    groups = [entry("groups", i, renditions={"low": entry("groups", i, ".low", bytes=7)}) for i in range(8)]
    manifest, files = paged([], groups, 2, names=NAMES)
    found = parsed(manifest, files)
    assert found.rendition_bytes() == {"high": sum(5000 + i for i in range(8)), "low": 56}
    assert [page.rendition_bytes["low"] for page in found.pages] == [14, 14, 14]
    low = found.select_rendition("low")
    assert ([g.uri for g in low.groups], low.pages) == ([f"groups/{i:04d}.low.safetensors" for i in range(8)], ())
    document = json.loads(manifest.to_json())
    document["pages"][1]["rendition_bytes"]["low"] = 15
    with pytest.raises(ReelError, match=r"pages/000002\.json: has renditions of"):
        parse_manifest(json.dumps(document).encode(), "m", lambda uri, limit: files[uri])
    del document["pages"][1]["rendition_bytes"]
    with pytest.raises(ReelError, match=r"pages\[1\] has high"):
        parse_manifest(json.dumps(document).encode(), "m", lambda uri, limit: files[uri])


def test_paged_reel_is_read_and_verified(reel):
    found = verify_reel(reel)
    assert (found.groups, found.layers, found.strangers) == (9, 6, [])
    reader = ReelReader(reel)
    assert [len(reader.static(g)[0]) for g in range(9)] == [10, 12, 12, 12] * 2 + [10]
    assert reader.static(5)[1].tolist() == [0] * 6 + [4] * 4 + [5] * 2


def test_verify_names_missing_and_damaged_pages(tmp_path):
    reel = write_chapters(tmp_path, groups=6)
    page = reel / "pages" / "000002.json"
    page.write_bytes(page.read_bytes().replace(b"layers/", b"lairs//", 1))
    with pytest.raises(ReelError, match=r"000002\.json: is damaged"):
        verify_reel(reel)
    page.unlink()
    with pytest.raises(ReelError, match=r"000002\.json: does not exist"):
        verify_reel(reel)


def test_alive_covers_the_living_layers(tmp_path):
    reel = write_chapters(tmp_path, groups=3, chapter=2, page=4)
    edit_manifest(reel, lambda d: d["layers"][1].update(until=3))
    with pytest.raises(
        ReelError, match=r"0002\.safetensors: section 'alive' holds 10 bits, the layers that live at the group 14"
    ):
        verify_reel(reel)
