"""The oracle on a wall with a moving cluster: measurement, continuation, refusals, and comparison with a reel."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.microbenchmarks import cloud, front_camera
from bench.oracle import draw_single_frame, oracle
from splatreel.base.errors import UsageError
from splatreel.base.progress import Silent, Span
from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config, EncodeConfig
from splatreel.method.encode.compression import weigh
from splatreel.method.init.layout import Layout
from splatreel.method.train.single_frame import reconstruct_single_frame
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.method.captures import WallCapture
from tests.method.small import small

CONFIG = small({"keyframe.first_iterations": 20})
FRAMES = 7


class HeldOutWall(WallCapture):
    """Wall capture whose second camera is held out."""

    def __init__(self, held_out: str | None = "cam01") -> None:
        super().__init__(FRAMES, cameras=5)
        self.held_out = [] if held_out is None else [held_out]


class Trace(Silent):
    """Progress that records stages and stops a run before a given one."""

    def __init__(self, stop: str | None = None) -> None:
        self.stop, self.stages = stop, []

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        if name == self.stop:
            raise KeyboardInterrupt
        self.stages.append((name, total, span))


def without_seconds(file: Path) -> dict:
    record = json.loads(file.read_text())
    for frame in record["frames"]:
        assert frame.pop("seconds") > 0
    return record


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("oracle")
    oracle(HeldOutWall(), folder, CONFIG, [0, 6], device="cpu")
    return folder


def test_oracle_measures_each_frame_independently(out: Path) -> None:
    record = json.loads((out / "oracle.json").read_text())
    assert [frame["frame"] for frame in record["frames"]] == [0, 6]
    assert record["reel"] is None
    for frame in record["frames"]:
        whole, moving = frame["score"]["whole"], frame["score"]["moving"]
        assert 10 < whole["psnr"] <= whole["psnr_per_channel"]
        assert whole["psnr"] != moving["psnr"]
        assert abs(frame["decoded"]["psnr"] - whole["psnr"]) < 1
        assert frame["points"] > 100
        assert frame["bytes"] > frame["points"]
    assert record["frames"][0]["score"] != record["frames"][1]["score"]
    assert "| mean |" in (out / "oracle.md").read_text()


def test_veil_in_front_of_a_held_out_camera_is_hidden_as_in_a_reel() -> None:
    camera = front_camera(64, 48)
    wall, veil = cloud(100, seed=7), cloud(20, seed=8)
    near = camera.center + 0.05 * camera.forward
    veil = replace(veil, means=(near + 0.001 * veil.means).astype(np.float32), opacities=np.full(20, 0.9, np.float32))
    both = Gaussians.concatenate([wall, veil])
    focus = camera.center + 3.0 * camera.forward
    layout = Layout(near=0.01, unit=3.0, up=[0, -1, 0], bounds=[[-1, -1, -1], [1, 1, 1]])
    clear = replace(layout, clearance=Clearance((focus[0], focus[1], focus[2]), 0.1))
    expected = draw_single_frame(layout, False, wall, camera)
    assert np.abs(draw_single_frame(layout, False, both, camera) - expected).mean() > 0.05
    np.testing.assert_array_equal(draw_single_frame(clear, False, both, camera), expected)


def test_oracle_continues_a_killed_run(out: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        oracle(HeldOutWall(), tmp_path, CONFIG, [0, 6], device="cpu", progress=Trace("frame 6 by itself (2 of 2)"))
    assert [frame["frame"] for frame in json.loads((tmp_path / "oracle.json").read_text())["frames"]] == [0]
    trace = Trace()
    oracle(HeldOutWall(), tmp_path, CONFIG, [0, 6], device="cpu", progress=trace)
    assert trace.stages == [("frame 6 by itself (1 of 1)", 20, (0, 1))]
    assert without_seconds(tmp_path / "oracle.json") == without_seconds(out / "oracle.json")


@pytest.mark.parametrize(
    ("capture", "config", "difference"),
    [
        (HeldOutWall(), small({"keyframe.first_iterations": 20, "seed": 1}), "config.seed is 0 there, 1 now"),
        (HeldOutWall("cam02"), CONFIG, r'capture.held_out is \["cam01"\] there, \["cam02"\] now'),
    ],
)
def test_oracle_refuses_folder_of_another_configuration(
    out: Path, capture: HeldOutWall, config: Config, difference: str
) -> None:
    before = (out / "oracle.json").read_bytes()
    with pytest.raises(UsageError, match=f"oracle.json: .*{difference}.*Choose another --out"):
        oracle(capture, out, config, [0], device="cpu")
    assert (out / "oracle.json").read_bytes() == before


def test_oracle_names_a_damaged_record(tmp_path: Path, out: Path) -> None:
    record = json.loads((out / "oracle.json").read_text())
    del record["frames"][0]["points"]
    (tmp_path / "oracle.json").write_text(json.dumps(record))
    with pytest.raises(UsageError, match=r"oracle\.json: is damaged .*Delete it"):
        oracle(HeldOutWall(), tmp_path, CONFIG, [0], device="cpu")


def test_oracle_refuses_capture_without_held_out_cameras(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"wall: no camera is held out.*--hold-out NAME,NAME"):
        oracle(HeldOutWall(None), tmp_path, CONFIG, [0], device="cpu")


@pytest.mark.parametrize("frames", [[], [0, FRAMES], [-1]])
def test_oracle_refuses_missing_frames(frames: list[int], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"wall has frames 0 to 6\. Choose among these"):
        oracle(HeldOutWall(), tmp_path, CONFIG, frames, device="cpu")


def still_reel(path: Path, capture: HeldOutWall, cameras: str = "training") -> Path:
    """Write a static reel that always shows frame 0."""
    views = capture.training_cameras if cameras == "training" else capture.cameras
    images = capture.read(0, 1, [c.name for c in capture.training_cameras])[0]
    gaussians, layout = reconstruct_single_frame(capture.training_cameras, images, CONFIG)
    header = ReelHeader(
        fps=capture.fps,
        group_length=FRAMES,
        overlap=0,
        sh_degree=1,
        bounds=np.array(layout.bounds),
        up=np.array(layout.up),
        near=layout.near,
        antialias=CONFIG.antialias,
        background=layout.background,
        camera=views[0],
        cameras=views,
    )
    writer = ReelWriter(path, header, config=EncodeConfig())
    shows = weigh([gaussians], capture.training_cameras, layout.near, CONFIG.antialias)
    writer.add_layer(0, 0, gaussians, shows)
    nothing = gaussians[:0]
    offsets = np.zeros((FRAMES, 0, 3), np.float32), np.zeros((FRAMES, 0, 4), np.float32)
    writer.add_group(Group(0, 0, nothing, *offsets, np.ones(len(gaussians), bool)))
    writer.finish()
    return path


def test_oracle_matches_a_static_reel_at_its_frame(out: Path, tmp_path: Path) -> None:
    """At frame 0 the reel scores like the decoded oracle, because both are encoded alike. Later it is wrong."""
    capture, trace = HeldOutWall(), Trace()
    reel, copy = still_reel(tmp_path / "reel", capture), shutil.copytree(out, tmp_path / "copy")
    before = json.loads((out / "oracle.json").read_text())["frames"]
    result = oracle(capture, copy, CONFIG, [0, 6], reel=reel, device="cpu", progress=trace)
    assert trace.stages == []  # measured already
    assert result.reel[0].whole == result.frames[0].decoded
    assert result.reel[1].whole != result.frames[1].decoded
    record = json.loads((copy / "oracle.json").read_text())
    assert record["frames"] == before
    assert record["reel"]["distance"] == result.distance()
    first = record["reel"]["frames"][0]
    assert first["distance"]["whole"] == pytest.approx(before[0]["score"]["whole"]["psnr"] - first["whole"]["psnr"])
    assert "how far it is below" in (copy / "oracle.md").read_text()


def test_oracle_refuses_reel_trained_on_held_out_cameras(tmp_path: Path) -> None:
    reel = still_reel(tmp_path / "reel", HeldOutWall(), "all")
    with pytest.raises(UsageError, match="was trained on cam01, so they are not held out"):
        oracle(HeldOutWall(), tmp_path / "out", CONFIG, [0], reel=reel, device="cpu")
    assert not (tmp_path / "out").exists()
