"""The error of a pose is what the filter defines it to be, and the filter is not shown the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import ConformanceError, InverseDepthStereoEKF, PoseBelief, StereoEKF, check_filter, nees
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.checks.consistency import InconsistentPoseError, blind_pose_error
from filters.checks.synthetic_drives import StraightDrive
from stereo_slam_env.evaluation.filter_run import run_filter


def _driven(make: Any) -> tuple[Any, StraightDrive]:
    slam, drive = make(REFERENCE_CAMERA, REFERENCE_NOISE), StraightDrive.simulated(REFERENCE_CAMERA, REFERENCE_NOISE)
    slam.reset(drive.start)
    for frame in range(5):
        if frame:
            drive.predict(slam, frame)
        slam.update(drive.observe(frame))
    return slam, drive


@pytest.mark.parametrize("error", ["quaternion", "so3", "first-estimates", "right-invariant", "left-invariant"])
def test_the_definitions_of_the_package_are_computed_to_the_bit(error: str) -> None:
    slam, drive = _driven(lambda camera, noise: StereoEKF(camera, noise, landmark="shared-anchor", error=error))
    truth = drive.position(4) + np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [0.1, 0.2, -0.1]).as_quat()
    for blind, direct in zip(blind_pose_error(slam, *truth), slam.pose_error(*truth), strict=True):
        np.testing.assert_array_equal(blind, direct)


class _EulerAngles(InverseDepthStereoEKF):
    """A definition of its own."""

    def pose_error(self, position: Any, orientation: Any) -> Any:
        turn = Rotation.from_quat(self.pose.orientation).inv() * Rotation.from_quat(np.array(orientation))
        return np.concatenate([position - self.pose.position, turn.as_euler("xyz")]), self.pose.covariance


class _InMillimetres(InverseDepthStereoEKF):
    """Another unit."""

    def pose_error(self, position: Any, orientation: Any) -> Any:
        error, P = super().pose_error(position, orientation)
        units = np.repeat([1e3, 1.0], 3)
        return units * error, np.outer(units, units) * P


@pytest.mark.parametrize("own", [_EulerAngles, _InMillimetres])
def test_a_definition_of_ones_own_counts_to_first_order(own: Any) -> None:
    slam, drive = _driven(own)
    truth = drive.position(4), Rotation.from_euler("xyz", [2e-4, -1e-4, 3e-4]).as_quat()
    (blind, P), (direct, Q) = blind_pose_error(slam, *truth), slam.pose_error(*truth)
    np.testing.assert_allclose(nees(blind[None], P[None]), nees(direct[None], Q[None]), rtol=5e-3)


class _Draws(InverseDepthStereoEKF):
    """Errors drawn from its own covariance."""

    rng = np.random.default_rng(0)

    def pose_error(self, position: Any, orientation: Any) -> Any:
        _, P = super().pose_error(position, orientation)
        return self.rng.multivariate_normal(np.zeros(6), P), P


class _Halves(InverseDepthStereoEKF):
    """Half the error."""

    def pose_error(self, position: Any, orientation: Any) -> Any:
        error, P = super().pose_error(position, orientation)
        return 0.5 * error, P


class _ClaimsMore(InverseDepthStereoEKF):
    """Four times the covariance that `pose` states."""

    def pose_error(self, position: Any, orientation: Any) -> Any:
        error, P = super().pose_error(position, orientation)
        return error, 4.0 * P


class _NeverWrong(InverseDepthStereoEKF):
    """No error, wherever the truth is."""

    def pose_error(self, position: Any, orientation: Any) -> Any:
        error, P = super().pose_error(position, orientation)
        return 0.0 * error, P


class _OfAnotherPose(InverseDepthStereoEKF):
    """States a pose that its errors are not of."""

    @property
    def pose(self) -> PoseBelief:
        pose = super().pose
        return PoseBelief(pose.position + np.array([0.0, 0.0, 0.01]), pose.orientation, pose.covariance)


FALSE = {
    _Draws: "its pose_error of its own pose is not zero",
    _Halves: "its pose_error has another covariance than its pose",
    _ClaimsMore: "its pose_error has another covariance than its pose",
    _NeverWrong: "its pose_error has another covariance than its pose",
    _OfAnotherPose: "its pose_error of its own pose is not zero",
}


@pytest.mark.parametrize(("false", "said"), FALSE.items(), ids=[false.__name__ for false in FALSE])
def test_an_error_that_is_none_of_the_pose_breaks_the_contract(false: Any, said: str) -> None:
    slam, drive = _driven(false)
    with pytest.raises(InconsistentPoseError, match=said):
        blind_pose_error(slam, drive.position(4), drive.orientation)
    with pytest.raises(ConformanceError, match=said):
        check_filter(false)
    run = run_filter(sse.make_recording("reference-turn", 0), false)
    assert run.failure is not None
    assert run.failure.startswith(f"frame 0: {said}")


class _Peeks(InverseDepthStereoEKF):
    """Goes on from the last pose that it was asked about."""

    asked: Any = None

    def pose_error(self, position: Any, orientation: Any) -> Any:
        self.asked = np.array(position, dtype=float), np.array(orientation, dtype=float)
        return super().pose_error(position, orientation)

    def predict(self, dt: float, odometry: Any = None, inertial: Any = None) -> None:
        if self.asked is not None:
            state = self.state
            state.camera = type(state.camera)(
                *self.asked, state.camera.linear_velocity, state.camera.angular_velocity, state.camera.variables
            )
            self.state, self.asked = state, None
        super().predict(dt, odometry, inertial)


def test_a_run_does_not_show_the_truth() -> None:
    recording, seen = sse.make_recording("reference-turn", 0), []

    class Listens(InverseDepthStereoEKF):
        def pose_error(self, position: Any, orientation: Any) -> Any:
            seen.append(np.array(position))
            return super().pose_error(position, orientation)

    honest, listening, peeking = (run_filter(recording, make) for make in (InverseDepthStereoEKF, Listens, _Peeks))
    assert len(seen) >= len(recording)
    for truth in listening.true_positions[1:]:
        assert np.linalg.norm(np.array(seen) - truth, axis=1).min() > 1e-3
    np.testing.assert_array_equal(listening.pose_nees, honest.pose_nees)
    gains = np.linalg.norm(peeking.positions - peeking.true_positions, axis=1)
    assert gains[1:].mean() > np.linalg.norm(honest.positions - honest.true_positions, axis=1)[1:].mean()
    with pytest.raises(ConformanceError, match="after pose_error it goes another way"):
        check_filter(_Peeks)
