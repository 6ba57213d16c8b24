"""`check_filter` and covariances that are none, filters that round, need odometry, or cannot be made (60 s)."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from filters import (
    BodyVelocity,
    InverseDepthStereoEKF,
    StereoEKF,
    StereoObservation,
    UpdateReport,
    VelocityDriven,
    check_filter,
)
from filters.checks.conformance import CHECKS, REFERENCE_CAMERA, REFERENCE_NOISE, START
from stereo_slam_env.baselines.camera_alone import DeadReckoning

from ..false_claims import LIES, liar


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("where", ["pose", "pose_error", "velocity", "landmarks", "forecast"])
def test_a_covariance_that_is_none_fails(where: str, lie: str) -> None:
    report = check_filter(liar(where, lie), raise_on_failure=False)
    if lie == "zero" and where in ("velocity", "landmarks"):  # odometry without errors, a map that is known
        assert not report.failed
        return
    wrong = {"zero": "is not positive", "negative": "is not positive", "NaN": "is not finite"}
    assert wrong.get(lie, "is not symmetric") in "\n".join(report.failed)


def test_a_filter_that_claims_the_negative_from_the_start_fails() -> None:
    """Its NEES are below zero, so that none is too large."""
    assert check_filter(liar("pose_error", "negative", first=0), raise_on_failure=False).failed


class InformationFilter(DeadReckoning):
    """Dead reckoning that keeps the inverse of its covariance: after every update that is inverted again."""

    def _use(self, observation: StereoObservation) -> UpdateReport:
        P = np.linalg.inv(np.linalg.inv(self._belief.P))
        self._belief = dataclasses.replace(self._belief, P=0.5 * (P + P.T))
        return super()._use(observation)


def test_an_information_filter_may_round() -> None:
    slam = InformationFilter(REFERENCE_CAMERA, REFERENCE_NOISE)
    slam.reset(START)
    nothing = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    for _ in range(5):
        slam.predict(0.1)
        before = slam.pose.covariance
        slam.update(nothing)
    assert 0.0 < np.abs(slam.pose.covariance - before).max() < 1e-9
    assert len(check_filter(InformationFilter).passed) == len(CHECKS)


def test_the_size_of_a_difference_is_said() -> None:
    class Drifts(InverseDepthStereoEKF):
        shift = 0.0

        def update(self, observation: StereoObservation) -> UpdateReport:
            self.shift += 1e-3
            return super().update(observation)

        @property
        def pose(self) -> Any:
            pose = super().pose
            return dataclasses.replace(pose, position=pose.position + self.shift)

    report = check_filter(Drifts, raise_on_failure=False)
    (line,) = (line for line in report.failed if line.startswith("A frame without measurements"))
    assert "position differs by 0.001, more than " in line


@pytest.mark.parametrize("error", ["quaternion", "right-invariant"])
def test_a_filter_that_needs_odometry_is_given_some(error: str) -> None:
    """Also over the winding drives, where it must be as good as its covariance says."""
    check_filter(lambda camera, noise: StereoEKF(camera, noise, motion=VelocityDriven(), error=error))


def test_odometry_is_given_to_those_alone_who_ask_for_it() -> None:
    given: list[BodyVelocity | None] = []

    class Listens(InverseDepthStereoEKF):
        def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
            if isinstance(odometry, BodyVelocity):
                given.append(odometry)
            super().predict(dt, odometry)

    check_filter(Listens)
    assert given == []


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda rig: InverseDepthStereoEKF(rig, rig), "unexpected keyword argument"),
        (lambda camera, noise, rate: InverseDepthStereoEKF(camera, noise), "rate"),
        (lambda camera, noise: None, "NoneType"),
    ],
)
def test_what_cannot_be_made_is_one_line(make: Any, complaint: str) -> None:
    report = check_filter(make, raise_on_failure=False)
    assert report.passed == ()
    (line,) = report.failed
    assert complaint in line
