"""Expected quality of novel views, for rigs with good and with poor coverage."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.base.progress import Silent
from splatreel.capture.color import over_color
from splatreel.capture.mask_shares import mask_shares
from splatreel.codec.reader import ReelReader
from splatreel.method.prediction import trial
from splatreel.method.prediction.quality import (
    SCALE,
    CaptureVerdict,
    Coverage,
    Silhouettes,
    cover,
    judge_capture,
    rating,
)
from splatreel.method.prediction.trial import Trial
from splatreel.run import pipeline, preparation
from splatreel.run.store import Store
from splatreel.scene.camera import Camera, unproject
from tests.method import corner
from tests.method.captures import WallCapture
from tests.method.scenes import look_at
from tests.method.small import small
from tests.notes import Notes
from tests.segmentation.scenes import ring


@pytest.fixture(autouse=True)
def few_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "ITERATIONS", 60)
    monkeypatch.setattr(trial, "POINTS", 2000)
    monkeypatch.setattr(trial, "TRIAL_WIDTH", 96)


def test_good_coverage_is_reported() -> None:
    cameras = corner.arc(5)
    found = cover(cameras, corner.make_images(cameras), progress=Silent())
    assert found.trial is not None
    assert found.trial.camera == "cam2", "the middle one is left out"
    assert found.trial.holds
    assert found.angle is None
    assert found.points > 100
    assert min(found.shared) > 20
    said = found.sentences()
    assert f"{found.trial.psnr:.0f} dB: 20 dB is poor, 30 dB is good" in said[-1]
    assert not any("hardly any" in sentence for sentence in said)


def test_cameras_that_have_nothing_in_common_are_told_that_new_views_will_be_unusable() -> None:
    cameras = corner.arc(4)
    noise = np.random.default_rng(0).integers(0, 256, (4, 12, 18, 3)).astype(np.uint8)
    images = noise.repeat(corner.HEIGHT // 12 + 1, 1).repeat(corner.WIDTH // 18 + 1, 2)
    found = cover(cameras, images[:, : corner.HEIGHT, : corner.WIDTH], progress=Silent())
    assert found.trial is not None
    assert not found.trial.holds
    assert found.angle is not None
    assert found.angle <= 10
    said = found.sentences()
    assert f"novel views more than {found.angle:.0f} degrees from a camera will not be usable" in said[-1]
    assert any("hardly any points in common with two other cameras: cam0" in sentence for sentence in said)


def test_no_trial_unless_asked_for() -> None:
    cameras = corner.arc(3)
    found = cover(cameras, corner.make_images(cameras), with_trial=False, progress=Silent())
    assert found.trial is None
    assert len(found.sentences()) == 2


def test_angles_are_measured_from_the_focus() -> None:
    cameras = [turned(degrees) for degrees in (0, 10, 25, 115)]
    found = cover(cameras, np.zeros((4, 32, 48, 3), np.uint8), with_trial=False, progress=Silent())
    assert found.angles == pytest.approx([10, 10, 15, 90], abs=0.5)
    assert "10 to 90 degrees from the nearest other one" in found.sentences()[0]
    assert "(cam115 is the farthest)" in found.sentences()[0]
    assert (found.points, found.shared) == (0, [0, 0, 0, 0])
    assert found.twins == []


def test_cameras_with_the_same_pose_are_named() -> None:
    cameras = [turned(degrees) for degrees in (0, 10, 25)]
    cameras.append(replace(cameras[1], name="copy"))
    found = cover(cameras, np.zeros((4, 32, 48, 3), np.uint8), with_trial=False, progress=Silent())
    assert found.twins == [["cam10", "copy"]]
    assert "cam10 and copy have the same pose" in found.sentences()[-1]


def turned(degrees: float) -> Camera:
    angle = np.radians(degrees)
    return replace(look_at([4 * np.sin(angle), 0, -4 * np.cos(angle)]), name=f"cam{degrees}")


def test_coverage_round_trips_through_json(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.coverage() is None
    found = Coverage(["a", "b", "c"], [1.0, 2.0, 1.0], [3, 4, 5], 6, Trial("b", 30.0, 11.2, 13.0, 9.5), [["a", "b"]])
    store.save_coverage(found)
    assert store.coverage() == found
    assert found.angle == 10
    (tmp_path / "coverage.json").write_text('{"names": []}')
    with pytest.raises(ReconstructionError, match="is damaged"):
        store.coverage()


def test_failed_trial_limits_the_views_of_the_reel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [camera.name for camera in WallCapture(1).cameras]
    failed = Coverage(names, [20.0] * 4, [0] * 4, 0, Trial(names[1], 14.0, 11.2, 13.0, 9.5))
    monkeypatch.setattr(preparation, "cover", lambda *_, **__: failed)
    angles = []
    for tried in (True, False):
        out, heard = tmp_path / str(tried), Notes()
        config = small({"check_coverage": tried})
        result = pipeline.reconstruct(WallCapture(1), out, config, device="cpu", progress=heard)
        limits = ReelReader(result.reel).manifest.presentation.limits
        assert limits is not None
        angles.append(limits.angle)
        assert any("more than 7 degrees" in line for line in heard.lines) == tried
        assert (out / "work" / "coverage.json").exists() == tried
    assert angles[0] == 7 < angles[1]


def test_room_behind_soft_edges_does_not_count_as_an_error_of_the_subject(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = corner.arc(3)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, cameras[0].height, cameras[0].width, 3)).astype(np.uint8)
    alpha = np.full(images.shape[:3], 100, np.uint8)  # soft everywhere
    alpha[:, :4] = 0
    small = trial.narrow_camera(cameras[1], trial.TRIAL_WIDTH)
    truth, mask = trial.resize_image(images[1], small), trial.resize_image(alpha[1], small)
    layout = SimpleNamespace(near=0.1, background=(0, 0, 0))
    monkeypatch.setattr(trial, "reconstruct_single_frame", lambda *_, **__: (None, layout))
    monkeypatch.setattr(trial, "middle_camera", lambda *_: 1)
    brightness = 1.0
    monkeypatch.setattr(trial, "render_image", lambda *_, **__: brightness * over_color(truth, mask, (0, 0, 0)) / 255)

    def tried() -> Trial:
        return trial.leave_one_out(cameras, images, np.zeros(3), None, None, None, Silent(), alpha)

    assert tried().psnr == trial.BEST
    brightness = 0.9
    assert tried().psnr < 40, "evaluate does not fit the exposure either"


CAMERAS = ring(5)
MIDDLE = np.array([0.2, 0.7, -0.1])
BODY = ((MIDDLE, 0.4), (MIDDLE + np.array([0.1, 0.55, 0.2]), 0.2), (MIDDLE + np.array([-0.5, -0.2, 0.1]), 0.15))
"""Middles and radii of the balls of a body without symmetry."""


def draw(camera: Camera, balls: Sequence[tuple[np.ndarray, float]]) -> np.ndarray:
    """Return the mask [H, W] uint8 of balls."""
    rays = unproject(camera, np.ones((camera.height, camera.width))) - camera.center
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    mask = np.zeros(rays.shape[:2], bool)
    for middle, radius in balls:
        to_middle = middle - camera.center
        beside = to_middle - (rays @ to_middle)[..., None] * rays
        mask |= np.linalg.norm(beside, axis=-1) < radius
    return np.where(mask, 255, 0).astype(np.uint8)


def moment(x: float = 0, z: float = 0) -> np.ndarray:
    """Return the masks [C, H, W] of the body at a place."""
    return np.stack(
        [draw(camera, [(place + np.array([x, 0, z]), radius) for place, radius in BODY]) for camera in CAMERAS]
    )


MASKS = np.stack([moment(), moment(0.5, -0.4)])


def turned_camera(camera: Camera, degrees: float) -> Camera:
    """Return a camera whose pose is wrong by an angle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    return replace(camera, viewmat=turn @ camera.viewmat)


def fits(cameras: list[Camera], masks: np.ndarray) -> list[float]:
    return Silhouettes(cameras, masks, MIDDLE, 0.1).fits


def doubt(cameras: list[Camera], masks: np.ndarray) -> str | None:
    """Return wrong poses that fit as well; None where the given ones do not fit."""
    found = Silhouettes(cameras, masks, MIDDLE, 0.1)
    return found.wrong_poses_that_fit() if min(found.fits) >= 0.9 else None


def test_masks_of_right_poses_fit_and_would_not_fit_wrong_ones() -> None:
    assert min(fits(CAMERAS, MASKS)) > 0.98
    assert doubt(CAMERAS, MASKS) == ""


@pytest.mark.parametrize("degrees", [10, -10, 25])
def test_a_wrong_pose_does_not_fit(degrees: float) -> None:
    cameras = [turned_camera(CAMERAS[0], degrees), *CAMERAS[1:]]
    assert min(fits(cameras, MASKS)) < 0.8


@pytest.mark.parametrize("degrees", [5, -5, 10, -10, 30])
@pytest.mark.parametrize("wrong", [0, 3])
def test_a_wrong_pose_is_not_confirmed(wrong: int, degrees: float) -> None:
    cameras = [turned_camera(camera, degrees) if c == wrong else camera for c, camera in enumerate(CAMERAS)]
    assert doubt(cameras, MASKS) != ""


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 4)])
def test_exchanged_cameras_are_not_confirmed(pair: tuple[int, int]) -> None:
    order = list(range(5))
    order[pair[0]], order[pair[1]] = pair[1], pair[0]
    assert doubt(CAMERAS, MASKS[:, order]) != ""


@pytest.mark.parametrize("share", [-0.3, 0.3])
def test_a_camera_at_a_wrong_place_is_not_confirmed(share: float) -> None:
    viewmat = CAMERAS[1].viewmat.copy()
    viewmat[[0, 2], 3] += share * viewmat[2, 3] * np.array([0.4, 1])
    assert doubt([CAMERAS[0], replace(CAMERAS[1], viewmat=viewmat), *CAMERAS[2:]], MASKS) != ""


def boxes(masks: np.ndarray, margin: int) -> np.ndarray:
    """Return a box around each mask [M, C, H, W]."""
    out = np.zeros_like(masks)
    for target, mask in zip(out.reshape(-1, *masks.shape[2:]), masks.reshape(-1, *masks.shape[2:]), strict=True):
        rows, columns = np.nonzero(mask)
        top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
        target[top : rows.max() + 1 + margin, left : columns.max() + 1 + margin] = 255
    return out


@pytest.mark.parametrize("masks", [np.full_like(MASKS, 255), boxes(MASKS, 16)], ids=["white", "boxes"])
def test_large_masks_confirm_nothing(masks: np.ndarray) -> None:
    assert min(fits(CAMERAS, masks)) > 0.9, "they fit"
    assert "as well if " in (doubt(CAMERAS, masks) or "")
    turned_away = [turned_camera(CAMERAS[0], 10), *CAMERAS[1:]]
    assert doubt(turned_away, masks) != ""


def test_a_ball_in_the_middle_does_not_tell_cameras_apart() -> None:
    masks = np.stack([[draw(camera, [(np.array([0, 0.6, 0]), 0.5)]) for camera in CAMERAS]])
    assert "were exchanged" in (doubt(CAMERAS, masks) or "")


def test_masks_of_another_moment_do_not_fit() -> None:
    masks = MASKS.copy()
    masks[:, 2] = MASKS[::-1, 2]
    assert doubt(CAMERAS, masks) is None


def test_masks_that_hardly_show_the_subject_confirm_nothing() -> None:
    """Masks without weights leave out what no other camera confirms: with a wrong pose, almost everything."""
    some = MASKS[:1].copy()
    some[0, 2, : np.nonzero(some[0, 2].any(1))[0][-1]] = 0
    assert some[0, 2].any()
    assert fits(CAMERAS, some)[2] == 0
    some[0, 2] = 0
    assert fits(CAMERAS, some)[2] == 0


def test_moments_at_which_a_camera_does_not_see_the_subject_do_not_count() -> None:
    some = np.concatenate([MASKS, MASKS[:1]])
    some[2] = 0
    some[1, 2] = 0
    assert fits(CAMERAS, some)[2] > 0.98


def test_two_masks_confirm_nothing() -> None:
    assert fits(CAMERAS[:2], MASKS[:, :2]) == [0, 0]
    assert min(fits(CAMERAS[:3], MASKS[:, :3])) > 0.98


NAMES = [f"cam{number}" for number in range(5)]


def coverage(
    psnr: float | None = 31.0, shared: list[int] | None = None, twins: list[list[str]] | None = None
) -> Coverage:
    trial = None if psnr is None else Trial("cam2", 30.0, psnr, 17.8, 14.2)
    return Coverage(NAMES, [30.0] * 5, shared or [90, 120, 80, 70, 100], 200, trial, twins or [])


@pytest.mark.parametrize(
    ("psnr", "word"), [(20.2, "poor"), (23.9, "poor"), (25.0, "fair"), (30.0, "good"), (40.0, "very good")]
)
def test_views_are_rated_on_the_scale_of_the_report(psnr: float, word: str) -> None:
    found = coverage(psnr)
    assert rating(psnr) == word
    assert f"Expect novel views between the cameras to be {word}, about {psnr:.0f} dB" in found.sentences()[-1]
    assert "will hold" not in found.sentences()[-1]
    verdict = judge_capture(found, [])
    assert verdict.faults == []
    assert f"will be {word} (about {psnr:.0f} dB)" in verdict.text("CMD")
    assert ("closer together" in found.sentences()[-1]) == (word == "poor")
    assert "20 dB is poor, 30 dB is good" in SCALE


def test_trial_that_fails_limits_the_views() -> None:
    text = judge_capture(coverage(16.0), []).text("CMD")
    assert "only views within 10 degrees of a camera will be usable; a person alone holds further" in text
    assert text.endswith("(--masks auto). Run\n  CMD")


def test_without_a_trial_novel_views_are_not_mentioned() -> None:
    assert (
        judge_capture(coverage(None), [])
        .text("CMD")
        .startswith("It can be reconstructed, but no trial of novel views was made")
    )


@pytest.mark.parametrize(
    ("found", "misfits", "said"),
    [
        (coverage(twins=[["cam1", "cam3"]]), [], "cam1 and cam3 have the same pose"),
        (coverage(shared=[90, 0, 80, 70, 100]), [], "cam1 has 0 points in common with two other cameras, where 80"),
        (replace(coverage(shared=[0] * 5, psnr=None), angles=[15.0] * 5), [], "though they are only 15 degrees apart"),
        (
            replace(coverage(), mask_fits=[1, 1, 0.3, 1, 1]),
            [],
            "Other evidence confirms the poses, so the masks are wrong",
        ),
        (replace(coverage(), mask_share=0.0), [], "the masks are black"),
        (coverage(), ["cam0", "cam4"], "the poses or lenses of cam0, cam4 do not fit each other"),
    ],
)
def test_faults_fail_the_verdict(found: Coverage, misfits: list[str], said: str) -> None:
    verdict = judge_capture(found, misfits)
    assert len(verdict.faults) == 1
    assert said in verdict.text("CMD")
    assert verdict.text("CMD").startswith("Do not reconstruct it as it is:")
    assert "It can be reconstructed" not in verdict.text("CMD")


@pytest.mark.parametrize("psnr", [None, 12.0, 20.2])
def test_poses_of_far_cameras_are_unconfirmed_and_not_wrong(psnr: float | None) -> None:
    verdict = judge_capture(coverage(shared=[0] * 5, psnr=psnr), [])
    assert verdict.faults == []
    assert verdict.text("CMD", ["MAKE", "CHECK"]) == (
        "It can be read, but the poses cannot be confirmed by images this far apart: half of the cameras have no points in common with "
        "two others.\nMake masks, then check with --masks:\n  MAKE\n  CHECK\nTo reconstruct it as it is, run\n  CMD"
    )


def test_good_trial_confirms_poses_of_plain_walls() -> None:
    assert judge_capture(coverage(shared=[0] * 5, psnr=31.0), []).faults == []


def test_trial_of_a_subject_confirms_poses_of_cameras_that_share_no_points() -> None:
    found = replace(coverage(shared=[0] * 5, psnr=21.0), subject=True)
    assert judge_capture(found, []).faults == []
    assert found.trial is not None
    blurred = replace(found, trial=replace(found.trial, psnr=found.trial.flat + 1.5))
    assert "cannot be confirmed by images" in judge_capture(blurred, []).text("CMD")


def test_masks_that_fit_confirm_poses_where_the_trial_fails() -> None:
    """Three of four cameras 70 degrees apart do not make a subject that the fourth recognizes, whatever their poses."""
    found = replace(
        coverage(shared=[1] * 5, psnr=9.0), subject=True, mask_fits=[1.0, 0.95, 1.0, 0.99, 1.0], mask_doubt=""
    )
    assert judge_capture(found, []).faults == []
    assert any("the poses are confirmed by the masks" in sentence for sentence in found.sentences())
    assert Coverage.from_dict(found.to_dict()) == found
    apart = replace(found, mask_fits=[1.0, 0.4, 0.8, 0.99, 1.0])
    said = judge_capture(apart, []).text("CMD")
    assert (
        "masks contradict each other. Only a part of these masks fits those of the other cameras: cam1 (40%). " in said
    )
    assert "The masks or the poses are wrong: look at the masks" in said
    partly = judge_capture(replace(found, mask_fits=[1.0, 0.8, 1.0, 0.99, 1.0]), [])
    assert partly.faults == []
    assert "half of the cameras have 1 point or fewer in common" in partly.text("CMD")
    assert "cam1 (80%) fit the others in part only" in partly.text("CMD", ["MAKE"])
    assert "MAKE" not in partly.text("CMD", ["MAKE"])
    assert any(sentence.startswith("the mask of cam1 does not fit") for sentence in apart.sentences())


@pytest.mark.parametrize(("doubt", "said"), [("as well if cam1 and cam3 were exchanged", True), (None, False)])
def test_masks_that_fit_wrong_poses_as_well_confirm_nothing(doubt: str | None, said: bool) -> None:
    """Runs of earlier versions did not try wrong poses."""
    found = replace(coverage(shared=[1] * 5, psnr=9.0), subject=True, mask_fits=[1.0] * 5, mask_doubt=doubt)
    assert not any("confirmed" in sentence for sentence in found.sentences())
    text = judge_capture(found, []).text("CMD")
    assert "the poses cannot be confirmed by images this far apart" in text
    assert ("Nor do the masks confirm them: they would fit as well if cam1 and cam3 were exchanged." in text) == said
    assert Coverage.from_dict(found.to_dict()) == found


@pytest.mark.parametrize(("share", "fits"), [(0.9, [1.0] * 5), (0.1, [0.3, 1, 1, 1, 1])])
def test_trial_of_a_subject_confirms_nothing_by_large_masks_or_masks_that_do_not_fit(
    share: float, fits: list[float]
) -> None:
    found = replace(coverage(shared=[0] * 5, psnr=21.0), subject=True, mask_share=0.1, mask_fits=[0.8] * 5)
    assert judge_capture(found, []).faults == []
    verdict = judge_capture(replace(found, mask_share=share, mask_fits=fits), [])
    assert ("large masks fit at any poses. Are they inverted" in verdict.unconfirmed) == (share > 0.5)
    assert bool(verdict.faults) == (share < 0.5)


def shifted(masks: np.ndarray, pixels: int) -> np.ndarray:
    """Return masks [M, C, H, W] moved to the right."""
    return np.pad(masks, ((0, 0), (0, 0), (0, 0), (pixels, 0)))[..., : masks.shape[-1]]


FIST = BODY[2][1]
HANDS = (BODY[2][0], BODY[2][0] + np.array([1.0, 0.1, 0.1]))
WRONG_MASKS = {
    "shifted": shifted(MASKS, 19),
    "shifted the other way": shifted(MASKS[..., ::-1], 19)[..., ::-1],
    "one shifted": np.concatenate([shifted(MASKS[:, :1], 19), MASKS[:, 1:]], 1),
    "another hand in each": np.stack([[draw(camera, [(HANDS[c % 2], FIST)]) for c, camera in enumerate(CAMERAS)]]),
    "one inverted": np.concatenate([255 - MASKS[:, :1], MASKS[:, 1:]], 1),
    "upside down": MASKS[..., ::-1, :],
}


def judged(masks: np.ndarray, shared: int = 0) -> CaptureVerdict:
    """Return the verdict of masks at right poses."""
    tried = Silhouettes(CAMERAS, masks, MIDDLE, 0.1)
    share = float(np.median(mask_shares(masks[0])))
    doubt = tried.wrong_poses_that_fit() if min(tried.fits) >= 0.9 else None
    found = replace(coverage(None, [shared] * 5), names=[camera.name for camera in CAMERAS], subject=True)
    return judge_capture(replace(found, mask_fits=tried.fits, mask_doubt=doubt, mask_share=share), [])


@pytest.mark.parametrize("kind", WRONG_MASKS)
def test_wrong_masks_at_right_poses_are_faults(kind: str) -> None:
    """`shifted` was no fault: a mask of which nothing fits was taken for one that is too small."""
    [fault] = judged(WRONG_MASKS[kind]).faults
    assert "masks contradict each other" in fault
    assert "The masks or the poses are wrong" in fault


def test_inverted_masks_confirm_nothing_and_right_ones_do() -> None:
    assert "large masks fit at any poses. Are they inverted" in judged(255 - MASKS).unconfirmed
    assert "are they inverted?" in judged(255 - MASKS, shared=90).text("CMD")
    right = judged(MASKS)
    assert (right.faults, right.unconfirmed) == ([], "")


def test_wrong_masks_are_faults_where_points_confirm_the_poses() -> None:
    [fault] = judged(WRONG_MASKS["shifted"], shared=90).faults
    assert "so the masks are wrong: of another capture, shifted" in fault


def test_verdict_of_a_subject_says_what_more_cameras_bring() -> None:
    found = replace(coverage(22.0), subject=True, angles=[30.0, 60.0, 30.0, 40.0, 50.0])
    sentence = found.sentences()[-1]
    assert "Quick trial of the subject without cam2" in sentence
    assert "Expect novel views of the subject between the cameras to be poor, about 22 dB" in sentence
    assert "40 degrees apart. One more camera in the largest gap (beside cam1) would bring about 0.2 dB" in sentence
    assert found.trial is not None
    blurred = replace(found, trial=replace(found.trial, psnr=15.0))
    assert blurred.angle is None, "the player does not limit views of a subject"
    failed = judge_capture(blurred, []).text("CMD")
    assert "the subject will be a blur between the cameras" in failed
    assert "One more camera" in failed
    assert "--masks auto" not in failed
    assert Coverage.from_dict(found.to_dict()) == found
