"""RAFT of torchvision and SAM2 of its package, as they are installed by `make models`, with random weights."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError
from splatreel.method.images.flow import RaftFlow
from splatreel.method.layering.sam2 import Sam2Segmenter
from tests.method.images.test_flow import textured

torch = pytest.importorskip("torch")
TINY = {
    "image_size": 128,
    "image_encoder.trunk.embed_dim": 16,
    "image_encoder.trunk.stages": [1, 1, 2, 1],
    "image_encoder.trunk.global_att_blocks": [3],
    "image_encoder.neck.backbone_channel_list": [128, 64, 32, 16],
    "memory_attention.num_layers": 1,
}
"""Changes of the smallest configuration of SAM2.1 that make a network of a few million weights."""


@pytest.fixture(scope="module", autouse=True)
def _torchvision() -> None:
    """Import torchvision, or skip.

    PyPI's wheel for Linux is compiled for torch's CUDA wheel. Beside torch's CPU wheel its compiled operators do not load. RAFT
    and SAM2 use none of them, but torchvision declares two in Python, which need a name.
    """
    spec = importlib.util.find_spec("torchvision")
    if spec is None or spec.origin is None:
        pytest.skip("torchvision is not installed: make models")
    try:
        for compiled in Path(spec.origin).parent.glob("_C*"):
            torch.ops.load_library(compiled)
    except OSError:
        library = torch.library.Library("torchvision", "FRAGMENT")
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    import torchvision  # noqa: F401


def test_raft_loads_weights_and_sees_what_torchvision_does(tmp_path: Path) -> None:
    from torchvision.models.optical_flow import Raft_Large_Weights, raft_large

    torch.manual_seed(0)
    network = raft_large(weights=None).eval()
    torch.save(network.state_dict(), tmp_path / "raft.pth")
    a, b = textured(128, 136), textured(128, 136, 1)
    flow = RaftFlow(tmp_path / "raft.pth", device="cpu", updates=1)(a, b)
    frames = (torch.from_numpy(image).permute(2, 0, 1)[None] for image in (a, b))
    with torch.inference_mode():
        expected = network(*Raft_Large_Weights.DEFAULT.transforms()(*frames), num_flow_updates=1)[-1]
    np.testing.assert_allclose(flow, expected[0].permute(1, 2, 0).numpy(), atol=1e-3)


def test_raft_refuses_weights_of_another_network(tmp_path: Path) -> None:
    from torchvision.models.optical_flow import raft_small

    torch.save(raft_small(weights=None).state_dict(), tmp_path / "small.pth")
    with pytest.raises(MissingDependencyError, match=r"small\.pth: not the weights of torchvision's raft_large"):
        RaftFlow(tmp_path / "small.pth")


@pytest.fixture(scope="module")
def sam2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return random weights of a tiny SAM2, whose configuration `tiny.yaml` hydra finds."""
    build_sam = pytest.importorskip("sam2.build_sam")
    import hydra
    from hydra.core.global_hydra import GlobalHydra
    from omegaconf import OmegaConf

    folder = tmp_path_factory.mktemp("sam2")
    config = OmegaConf.load(Path(build_sam.__file__).parent / "configs/sam2.1/sam2.1_hiera_t.yaml")
    for name, value in TINY.items():
        OmegaConf.update(config, f"model.{name}", value)
    # hydra ignores the first line of a loaded file, which says that the configuration has no folder
    (folder / "tiny.yaml").write_text("# @package _global_\n" + OmegaConf.to_yaml(config))
    GlobalHydra.instance().clear()
    hydra.initialize_config_dir(str(folder), version_base=None)
    torch.manual_seed(0)
    network = build_sam.build_sam2_video_predictor("tiny.yaml", None, device="cpu")
    torch.save({"model": network.state_dict()}, folder / "tiny.pt")
    return folder / "tiny.pt"


def test_sam2_is_prompted_in_one_view_and_propagates_to_all(sam2: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    segmenter = Sam2Segmenter(sam2, "tiny.yaml", "cpu")
    images = np.stack([textured(64, 96, seed) for seed in range(4)])
    masks = np.zeros((4, 64, 96), bool)
    masks[2, 10:26, 20:50] = masks[2, 40:60, 60:90] = masks[0, 5:10, 5:10] = True
    prompted, propagated = [], {}
    add, propagate = segmenter.predictor.add_new_points_or_box, segmenter.predictor.propagate_in_video

    def record_prompts(**prompt):
        prompted.append((prompt["frame_idx"], prompt["obj_id"]))
        assert masks[2][tuple(prompt["points"].astype(int).T[::-1])].all()
        return add(**prompt)

    def record_masks(*args, **options):
        for view, objects, logits in propagate(*args, **options):
            assert logits.shape == (2, 1, 64, 96)
            propagated[view] = propagated.get(view, 0) | (logits > 0).any(0)[0].numpy()
            yield view, objects, logits

    monkeypatch.setattr(segmenter.predictor, "add_new_points_or_box", record_prompts)
    monkeypatch.setattr(segmenter.predictor, "propagate_in_video", record_masks)
    completed = segmenter.complete(masks, images)
    assert prompted == [(2, 1), (2, 2)]
    assert sorted(propagated) == [0, 1, 2, 3]
    np.testing.assert_array_equal(completed, masks | np.stack([propagated[view] for view in range(4)]))


def test_sam2_draws_nothing_over_the_display(sam2: Path, capfd: pytest.CaptureFixture[str]) -> None:
    masks = np.zeros((2, 64, 96), bool)
    masks[0, 10:40, 20:50] = True
    segmenter = Sam2Segmenter(sam2, "tiny.yaml", "cpu")
    capfd.readouterr()
    segmenter.complete(masks, np.stack([textured(64, 96), textured(64, 96)]))
    assert capfd.readouterr() == ("", "")


def test_sam2_refuses_weights_of_another_network(sam2: Path, tmp_path: Path) -> None:
    state = torch.load(sam2, weights_only=True)["model"]
    for name, content in (
        ("text.pt", None),
        ("other.pt", {"model": dict(list(state.items())[1:])}),
        ("bare.pt", state),
    ):
        path = tmp_path / name
        path.write_text("no weights") if content is None else torch.save(content, path)
        with pytest.raises(MissingDependencyError, match=rf"{name}: not the weights of SAM2 for tiny\.yaml"):
            Sam2Segmenter(path, "tiny.yaml", "cpu")
