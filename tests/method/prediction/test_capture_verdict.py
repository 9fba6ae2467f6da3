"""The verdict of `capture check`: poor views, equal poses and unconfirmed poses fail."""

from dataclasses import replace

import pytest

from splatreel.method.prediction.quality import SCALE, Coverage, judge_capture, rating
from splatreel.method.prediction.trial import Trial

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
        (coverage(shared=[0] * 5, psnr=None), [], "the images do not confirm the poses"),
        (coverage(shared=[0] * 5, psnr=20.2), [], "the images do not confirm the poses"),
        (coverage(shared=[0] * 5, psnr=12.0), [], "the images do not confirm the poses"),
        (coverage(), ["cam0", "cam4"], "the poses or lenses of cam0, cam4 do not fit each other"),
    ],
)
def test_faults_fail_the_verdict(found: Coverage, misfits: list[str], said: str) -> None:
    verdict = judge_capture(found, misfits)
    assert len(verdict.faults) == 1
    assert said in verdict.text("CMD")
    assert verdict.text("CMD").startswith("Do not reconstruct it as it is:")
    assert "It can be reconstructed" not in verdict.text("CMD")


def test_good_trial_confirms_poses_of_plain_walls() -> None:
    assert judge_capture(coverage(shared=[0] * 5, psnr=31.0), []).faults == []


def test_trial_of_a_subject_confirms_poses_of_cameras_that_share_no_points() -> None:
    found = replace(coverage(shared=[0] * 5, psnr=21.0), subject=True)
    assert judge_capture(found, []).faults == []
    assert found.trial is not None
    blurred = replace(found, trial=replace(found.trial, psnr=found.trial.flat + 1.5))
    assert "do not confirm the poses" in judge_capture(blurred, []).text("CMD")


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
    assert "half of the cameras have 1 point or fewer in common" in said
    assert "Masks fit the others in part only: cam1 (40%), cam2 (80%). They or the poses are wrong." in said
    assert any(sentence.startswith("the mask of cam1 does not fit") for sentence in apart.sentences())


@pytest.mark.parametrize(("doubt", "said"), [("as well if cam1 and cam3 were exchanged", True), (None, False)])
def test_masks_that_fit_wrong_poses_as_well_confirm_nothing(doubt: str | None, said: bool) -> None:
    """Runs of earlier versions did not try wrong poses."""
    found = replace(coverage(shared=[1] * 5, psnr=9.0), subject=True, mask_fits=[1.0] * 5, mask_doubt=doubt)
    assert not any("confirmed" in sentence for sentence in found.sentences())
    text = judge_capture(found, []).text("CMD")
    assert "the images do not confirm the poses" in text
    assert ("The masks confirm nothing: they would fit as well if cam1 and cam3 were exchanged." in text) == said
    assert Coverage.from_dict(found.to_dict()) == found


@pytest.mark.parametrize(("share", "fits"), [(0.9, [1.0] * 5), (0.1, [0.3, 1, 1, 1, 1])])
def test_trial_of_a_subject_confirms_nothing_by_large_masks_or_masks_that_do_not_fit(
    share: float, fits: list[float]
) -> None:
    found = replace(coverage(shared=[0] * 5, psnr=21.0), subject=True, mask_share=0.1, mask_fits=[0.8] * 5)
    assert judge_capture(found, []).faults == []
    assert judge_capture(replace(found, mask_share=share, mask_fits=fits), []).faults


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
