"""Correct calibrations, and calibrations like those that COLMAP returns for too few matches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.calibration.calibration_agreement import CalibratedCamera, CalibratedRig, agreeing, trusted, unanimous

RNG = np.random.default_rng(0)


def rig(count: int = 6, points: int = 300) -> CalibratedRig:
    rotations = Rotation.from_rotvec(RNG.normal(0, 0.5, (count, 3))).as_matrix()
    return {f"cam{n}": CalibratedCamera(rotations[n], RNG.normal(0, 2, 3), 0.9, points) for n in range(count)}


def elsewhere(cameras: CalibratedRig) -> CalibratedRig:
    """Return the same rig in a rotated, scaled and translated world."""
    turn = Rotation.from_rotvec([0.3, 1.2, -0.5]).as_matrix()
    return {
        name: replace(placed, rotation=placed.rotation @ turn, center=3 * turn.T @ placed.center + [1, 2, 3])
        for name, placed in cameras.items()
    }


def turned(placed: CalibratedCamera, degrees: float) -> CalibratedCamera:
    return replace(placed, rotation=Rotation.from_rotvec([0, np.radians(degrees), 0]).as_matrix() @ placed.rotation)


def test_agreement_ignores_the_world_frame() -> None:
    one = rig()
    assert agreeing(one, elsewhere(one)) == set(one)
    assert agreeing(one, {name: placed for name, placed in elsewhere(one).items() if name in ("cam0", "cam1")}) == set()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda placed: turned(placed, 17),
        lambda placed: replace(placed, center=placed.center + np.array([0, 4, 0])),
        lambda placed: replace(placed, focal=1.5 * placed.focal),
        lambda placed: replace(placed, focal=-placed.focal),
    ],
)
def test_inconsistent_camera_is_not_trusted(wrong) -> None:
    one = rig()
    other = elsewhere(one)
    other["cam2"] = wrong(other["cam2"])
    assert agreeing(one, other) == set(one) - {"cam2"}
    assert trusted([one, other], 100)[1] == set(one) - {"cam2"}
    assert trusted([one, other, elsewhere(one)], 100)[1] == set(one), "two of three agree"
    moments = [
        {n: replace(p, points=30 if n == "cam2" else 300) for n, p in m.items()} for m in (one, other, elsewhere(one))
    ]
    assert trusted(moments, 100)[1] == set(one) - {"cam2"}, "a camera that sees little must agree with all"
    assert trusted([moments[0], moments[2]], 100)[1] == set(one)


def test_disagreeing_moments_trust_no_camera() -> None:
    assert trusted([rig(), rig(), rig()], 100)[1] == set()


def test_implausible_lenses_are_not_trusted() -> None:
    one = rig()
    one["cam1"] = replace(one["cam1"], focal=5_963_173 / 1920)
    one["cam2"] = replace(one["cam2"], focal=-0.9)
    assert not one["cam1"].possible
    assert not replace(one["cam2"], focal=0.01).possible
    assert trusted([one, elsewhere(one)], 100)[1] == set(one) - {"cam1", "cam2"}
    assert replace(one["cam0"], focal=16_041 / 2048).possible, "a lens of the Technicolor kind"


def test_single_moment_needs_enough_points() -> None:
    one = rig()
    one["cam3"] = replace(one["cam3"], points=12)
    assert trusted([one], 100) == (0, set(one) - {"cam3"})


def test_unanimous_calibrations_agree_on_a_camera() -> None:
    one = rig()
    assert unanimous([one, elsewhere(one), one]) == set(one)
    assert unanimous([one]) == set()
    other = elsewhere({name: placed for name, placed in one.items() if name != "cam3"})
    other["cam2"] = turned(other["cam2"], 17)
    assert unanimous([one, elsewhere(one), other]) == set(one) - {"cam2", "cam3"}
