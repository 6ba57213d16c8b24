"""Checks of error definitions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.checks.part_contracts.comparison import TURN, assert_close
from filters.checks.part_contracts.motions import a_camera
from filters.contract.inputs import Start, StereoObservation
from filters.engine.stereo_ekf import StereoEKF
from filters.errors import ErrorDefinition
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray

_UVD = np.array([[600.0, 200.0, 30.0], [300.0, 100.0, 20.0], [900.0, 250.0, 10.0], [800.0, 180.0, 4.0]])


def _filter(error: ErrorDefinition, R: FloatArray | None = None) -> StereoEKF:
    """A filter with four landmarks, in a world turned by R, before it is corrected."""
    root, R = 0.1 * np.random.default_rng(0).standard_normal((12, 12)), np.eye(3) if R is None else R
    turn = np.eye(12)
    turn[:3, :3] = turn[6:9, 6:9] = R  # rotation and angular velocity are those of the camera
    at, P = a_camera({}), turn @ root @ root.T @ turn.T
    start = Start(R @ at.position, rotations.from_matrix(R @ at.R_wc), R @ at.linear_velocity, at.angular_velocity, P)
    slam = StereoEKF(REFERENCE_CAMERA, REFERENCE_NOISE, error=error, landmark="euclidean", gate=None)
    slam.reset(start)
    slam.update(StereoObservation(np.arange(4), _UVD))
    slam.predict(0.1)
    return slam


def check_error_of_nothing(error: ErrorDefinition) -> None:
    """A measurement that is what the filter expects leaves the estimate where it is."""
    slam = _filter(error)
    before = slam.pose
    slam.update(StereoObservation(slam.ids, slam.forecast().uvd))
    assert_close("position without an innovation", slam.pose.position, before.position, 1e-9)
    assert_close("orientation without an innovation", slam.pose.orientation, before.orientation, 1e-9)


def check_error_invariance(error: ErrorDefinition) -> None:
    """In a world that is turned, the same measurements lead to the turned estimate."""
    slam, turned = _filter(error), _filter(error, TURN)
    for one in (slam, turned):
        one.update(StereoObservation(np.arange(4), _UVD + [[3.0, -2.0, 0.5]] * 4))
    assert_close("landmarks in a turned world", turned.landmarks.positions, slam.landmarks.positions @ TURN.T, 1e-7)
    assert_close("position in a turned world", turned.pose.position, TURN @ slam.pose.position, 1e-7)
    here, there = rotations.matrix(slam.pose.orientation), rotations.matrix(turned.pose.orientation)
    assert_close("orientation in a turned world", there, TURN @ here, 1e-7)


def check_error_of_the_pose(error: ErrorDefinition) -> None:
    """The pose has no error against itself, and `pose_error` has the covariance of small ones."""
    slam = _filter(error)
    camera, P = slam.camera_state, slam.pose.covariance
    none, covariance = error.pose_error(camera, P, camera.position, camera.orientation)
    assert_close("pose_error of the pose itself", none, np.zeros(6))

    def against(e: FloatArray) -> FloatArray:
        true = rotations.multiply(camera.orientation, rotations.exp_quaternion(e[3:]))
        return error.pose_error(camera, P, camera.position + e[:3], true)[0]

    J = derivatives.jacobian(against, 6)
    assert_close("covariance of pose_error", covariance, J @ P @ J.T)


CHECKS: tuple[Callable[..., None], ...] = (
    check_error_of_nothing,
    check_error_invariance,
    check_error_of_the_pose,
)
