"""Errors of the calibration as a variable: estimated or considered, against a pair that is taken as it is stated."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from filters import CalibratedPair, RangeBearing, StereoEKF

from ..drives import CAMERA
from ..matched_drives import HIGH, LOW, RUNS, Frame, Setup, finished, mean_nees, nees

ALL = CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, 2e-3, 1e-3)
OFFSET = CalibratedPair(offset_sigma=1.0)
SIGMAS = np.array([0.25, 3e-3, 2e-3, 5e-3, 5e-3, 5e-3, 2e-3, 1e-3])
ERRORS = SIGMAS * np.array([1.0, -2.0, 1.5, 3.0, -2.0, 1.0, 2.0, -1.5])
POINTS = np.array([[0.5, -0.3, 4.0, 1.0], [-0.2, 0.1, 1.0, 0.05], [0.1, 0.2, 1.0, 0.0], [0.1, 0.2, 1.0, -0.01]])


def values(numbers: np.ndarray) -> dict[str, np.ndarray]:
    return {"calibration": np.asarray(numbers, dtype=float)}


def wrong_offset(seed: int) -> Setup:
    """A drive whose disparities are off by what the prior of `OFFSET` may be."""
    return Setup(OFFSET, values=values(np.random.default_rng([seed, 1]).standard_normal(1)), frames=25)


@cache
def with_offset(seed: int) -> tuple[StereoEKF, Frame]:
    return finished(wrong_offset(seed), seed)


def test_of_small_errors_the_columns_are_those_of_the_field() -> None:
    """(0, 0, 1), (u - cx, v - cy, d), (0, 0, d), the flow of a rotation, and of the right camera alone, in d."""
    u, v, d = CAMERA.project(POINTS[0, :3])
    f, x, y = CAMERA.fx, (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    columns = [[0, 0, 1], [u - CAMERA.cx, v - CAMERA.cy, d], [0, 0, d]]
    rotation = [[-f * x * y, f * (1 + x**2), -f * y], [-f * (1 + y**2), f * x * y, f * x], [-d * y, d * x, 0]]
    claimed = ALL.jacobians(CAMERA, POINTS[:1], values(0.0 * SIGMAS)).by_variable["calibration"][0]
    assert claimed[:, :3] == pytest.approx(np.transpose(columns), abs=1e-9)
    assert claimed[:, 3:6] == pytest.approx(np.array(rotation), abs=1e-9)
    of_the_right = [[0, 0], [0, 0], [f * (1 + (x - d / f) ** 2), v - CAMERA.cy]]
    assert claimed[:, 6:] == pytest.approx(np.array(of_the_right), abs=1e-9)


def test_backprojection_is_the_exact_inverse_at_and_beyond_infinity_too() -> None:
    e = values(ERRORS)
    back = ALL.backproject(CAMERA, ALL.predict(CAMERA, POINTS, e), e)
    assert back / np.linalg.norm(back[:, :3], axis=1)[:, None] == pytest.approx(
        POINTS / np.linalg.norm(POINTS[:, :3], axis=1)[:, None], abs=1e-12
    )


def test_only_errors_with_a_prior_are_there() -> None:
    assert CalibratedPair().variables == ()
    (variable,) = CalibratedPair(focal_sigma=1e-3, misalignment_sigma=2e-3).variables
    assert np.diag(variable.covariance) == pytest.approx(np.array([1e-3, 2e-3, 2e-3, 2e-3]) ** 2)


@pytest.mark.parametrize("pair", [CalibratedPair(), CalibratedPair(0.0, 0.0, 0.0, 0.0)], ids=["none", "zero"])
def test_without_doubt_it_is_the_rectified_pair(pair: CalibratedPair) -> None:
    slam, _ = finished(Setup(), 0, measurement=pair)
    other, _ = finished(Setup(), 0, measurement=RangeBearing())
    assert slam.pose.position == pytest.approx(other.pose.position, abs=1e-9)
    assert slam.pose.orientation == pytest.approx(other.pose.orientation, abs=1e-9)
    assert slam.pose.covariance == pytest.approx(other.pose.covariance, rel=1e-7, abs=1e-12)
    assert slam.landmarks.positions == pytest.approx(other.landmarks.positions, abs=1e-9)


def test_a_wrong_disparity_offset_is_found() -> None:
    off = []
    for seed in range(RUNS):
        belief = with_offset(seed)[0].belief("calibration")
        off.append((wrong_offset(seed).values["calibration"] - belief.value)[0] / np.sqrt(belief.covariance[0, 0]))
    assert np.abs(off).max() < 3.0
    assert 0.8 < np.std(off) < 1.2  # 60 draws: 0.09 each way
    assert with_offset(0)[0].belief("calibration").covariance[0, 0] < 0.25 * OFFSET.variables[0].covariance[0, 0]


def test_the_pose_is_as_certain_as_it_is_right_only_where_the_offset_is_allowed_for() -> None:
    assert LOW < np.mean([nees(*with_offset(seed)) for seed in range(RUNS)]) < HIGH
    assert mean_nees(wrong_offset, measurement=RangeBearing()) > 2.0 * HIGH


def test_a_considered_calibration_keeps_its_prior_and_the_pose_is_consistent() -> None:
    considered = CalibratedPair(offset_sigma=1.0, considered=True)
    slam, _ = finished(wrong_offset(0), 0, measurement=considered)
    belief = slam.belief("calibration")
    assert (belief.value.tolist(), belief.covariance.tolist()) == ([0.0], [[1.0]])
    assert LOW < mean_nees(wrong_offset, measurement=considered) < HIGH


def test_with_all_errors_at_once_the_pose_is_consistent() -> None:
    def setup(seed: int) -> Setup:
        return Setup(ALL, values=values(SIGMAS * np.random.default_rng([seed, 2]).standard_normal(len(SIGMAS))))

    assert LOW < mean_nees(setup) < HIGH


def test_a_prior_below_zero_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^focal_sigma must be a finite number >= 0, got -1"):
        CalibratedPair(focal_sigma=-1.0)
