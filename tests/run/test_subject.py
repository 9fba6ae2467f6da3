"""Reconstructions of a subject before a wall: by masks, and by a region."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.base.progress import Silent, Span
from splatreel.capture.base import Capture
from splatreel.capture.masks import MaskedCapture
from splatreel.codec.reader import ReelReader
from splatreel.config import Config, EncodeConfig
from splatreel.evaluation.evaluate import evaluate
from splatreel.kernels.image import render_image
from splatreel.play.timeline import open_reel
from splatreel.run import preparation
from splatreel.run.output.reencode import reencode
from splatreel.run.pipeline import reconstruct
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.reel_source import ReelSource
from tests.method.captures import HEIGHT, WIDTH, WallCapture, blots
from tests.method.scenes import ring
from tests.method.small import small

CAMERAS, FRAMES, SPEED = 6, 3, 0.15
HELD_OUT = "cam02"
LOW, HIGH = np.array([-1.9, -0.9, -0.7]), np.array([0.0, 0.9, 0.5])
"""Box around the cluster in all frames. The wall is at z = 0.9 and behind."""
REGION = "box:-1.9,-0.9,-0.7,0,0.9,0.5"
CONFIG = small({"keyframe.first_iterations": 120, "keyframe.densify_every": 30, "check_poses": False})


class ClusterMasks:
    """Soft masks of the cluster of a `WallCapture`."""

    have_doubts, notes = False, list[str]()

    def __init__(self, darkness: int = 0) -> None:
        self.darkness = darkness

    def read(self, first: int, count: int, name: str) -> np.ndarray:
        camera = next(view for view in ring(CAMERAS, width=WIDTH, height=HEIGHT) if view.name == name)
        found = []
        for frame in range(first, first + count):
            thing = blots(60, [-1.6, -0.6, -0.4], [-0.6, 0.6, 0.2], 0.09, 1)
            thing.means[:, 0] += SPEED * frame
            white = Gaussians(thing.means, thing.quats, thing.scales, thing.opacities, 0 * thing.sh + 0.5 / C0)
            found.append(np.clip(render_image(white, camera).mean(-1) * 255 - self.darkness, 0, 255))
        return np.stack(found).round().astype(np.uint8)

    def sources(self, first: int, count: int) -> list[Path]:
        return []

    def digest(self, first: int, count: int) -> str:
        return f"cluster {self.darkness}"

    def close(self) -> None:
        """Nothing is open."""


def wall() -> Capture:
    capture = WallCapture(FRAMES, cameras=CAMERAS, speed=SPEED)
    capture.held_out = [HELD_OUT]
    return capture


def subject(background: tuple[float, float, float] | None = None, darkness: int = 0) -> Capture:
    return MaskedCapture(wall(), ClusterMasks(darkness), background)


def outside(reel: Path) -> float:
    """The share of what a reel shows that is outside of the box, by opacity and size."""
    shares = []
    for frame in range(FRAMES):
        points = open_reel(reel).at(frame / 30)
        weight = points.opacities * points.scales.max(1) ** 2
        away = ~((points.means >= LOW) & (points.means <= HIGH)).all(1)
        shares.append(weight[away].sum() / weight.sum())
    return max(shares)


class StopAt(Silent):
    """Progress that stops a run in a stage."""

    def __init__(self, name: str) -> None:
        self.name = name

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        if self.name in name:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def masked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was interrupted and continued."""
    out = tmp_path_factory.mktemp("masked")
    with pytest.raises(KeyboardInterrupt):
        reconstruct(subject(), out, CONFIG, progress=StopAt("group 1/1: training the motion"))
    return reconstruct(subject(), out, CONFIG).reel


def test_masked_reel_shows_the_subject_alone(masked: Path) -> None:
    assert ReelReader(masked).manifest.transparent
    assert ReelReader(masked).manifest.source == ReelSource(0, (HELD_OUT,), part="masks")
    assert outside(masked) < 0.02


def test_networks_of_people_are_advised_before_few_cameras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Notes(StopAt):
        said: ClassVar[list[str]] = []

        def note(self, text: str) -> None:
            self.said.append(text)

    monkeypatch.setattr(preparation, "find_people", lambda: None)
    monkeypatch.setattr(preparation, "is_sparse", lambda cameras: True)
    with pytest.raises(KeyboardInterrupt):
        reconstruct(subject(), tmp_path, CONFIG, progress=Notes("training the first keyframe"))
    assert [sentence for sentence in Notes.said if "Networks of people find skeletons too: pip install" in sentence]


def test_evaluation_names_cameras_without_masks(masked: Path) -> None:
    capture = MaskedCapture(wall(), ClusterMasks(), (0.0, 0.0, 0.0), unmasked=[HELD_OUT])
    with pytest.raises(UsageError, match=rf"there are no masks of {HELD_OUT}, so the subject cannot be compared"):
        evaluate(masked, capture, lpips_every=0)
    capture.unmasked = ["cam04"]
    report = evaluate(masked, capture, cameras=["cam03", "cam04"], lpips_every=0)
    assert [camera["name"] for camera in report.cameras] == ["cam03"]
    assert report.unmasked == ["cam04"]
    assert "Not compared, because there are no masks of them: cam04." in report.to_markdown()


def test_masked_reel_is_as_its_masked_held_out_view(masked: Path) -> None:
    report = evaluate(masked, subject((0.0, 0.0, 0.0)), lpips_every=0)
    assert report.held_out == [HELD_OUT]
    assert report.psnr > 17
    share = (ClusterMasks().read(0, FRAMES, HELD_OUT) > 0).mean()
    assert report.masked_share == pytest.approx(share)
    assert "within the masks" in report.to_markdown()


def test_subject_is_opaque_and_everything_else_is_clear(masked: Path) -> None:
    """Per-camera backgrounds teach the opacity."""
    timeline, camera = open_reel(masked), subject().camera(HELD_OUT)
    points, near = timeline.at(0), timeline.manifest.near
    black, white = (
        render_image(points, camera, near=near, antialias=True, background=(level, level, level))
        for level in (0.0, 1.0)
    )
    alpha = 1 - (white - black).mean(-1)
    truth = ClusterMasks().read(0, 1, HELD_OUT)[0] / 255
    assert alpha[truth > 0.9].mean() > 0.8
    assert alpha[truth == 0].mean() < 0.05


def test_other_masks_are_another_run(masked: Path) -> None:
    with pytest.raises(ReconstructionError, match=r'capture\.masks is "cluster 0" there, "cluster 40" now'):
        reconstruct(subject(darkness=40), masked.parent, CONFIG)
    with pytest.raises(ReconstructionError, match=r"capture\.masks"):
        reconstruct(wall(), masked.parent, CONFIG)


def test_black_masks_of_the_first_frame_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReconstructionError, match=r"masks of the first frame have no place in common.*--frames"):
        reconstruct(subject(darkness=255), tmp_path, CONFIG)


@pytest.fixture(scope="module")
def regional(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = small({"region": REGION, "group.length": 2, "keyframe.first_iterations": 40})
    return reconstruct(wall(), tmp_path_factory.mktemp("region"), config).reel


def points_of(reel: Path) -> list[np.ndarray]:
    return [open_reel(reel).at(frame / 30).means for frame in range(FRAMES)]


def test_reel_of_a_region_holds_the_points_within_it(regional: Path) -> None:
    reader = ReelReader(regional)
    assert reader.manifest.transparent
    assert reader.manifest.source is not None
    assert reader.manifest.source.part == "region"
    np.testing.assert_array_less(LOW - 1e-6, reader.manifest.bounds[0])
    np.testing.assert_array_less(reader.manifest.bounds[1], HIGH + 1e-6)
    assert outside(regional) < 0.01
    assert min(len(points) for points in points_of(regional)) > 20


def test_reel_of_a_region_is_written_and_encoded_from_its_checkpoints(regional: Path, tmp_path: Path) -> None:
    """The surroundings stay in the checkpoints, and out of every reel."""
    again = reencode(regional.parent / "work", tmp_path / "again", EncodeConfig(), Silent())
    for one, other in zip(points_of(regional), points_of(again), strict=True):
        np.testing.assert_allclose(one, other)
    continued = reconstruct(wall(), regional.parent, small({"region": REGION, "keyframe.first_iterations": 40}))
    assert [len(points) for points in points_of(continued.reel)] == [len(points) for points in points_of(again)]


@pytest.mark.parametrize(
    ("region", "error", "message"),
    [
        ("cube:1,2,3", UsageError, r"region=cube:1,2,3: Give box:"),
        ("box:1,1,1,0,0,0", UsageError, r"Give the low corner"),
        ("sphere:90,0,0,1", ReconstructionError, r"nothing of the scene is there .* between -?[0-9.]+, "),
    ],
)
def test_impossible_regions_are_refused(tmp_path: Path, region: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        reconstruct(wall(), tmp_path, small({"region": region}))


def test_region_is_a_part_of_the_settings() -> None:
    assert Config().region == ""
