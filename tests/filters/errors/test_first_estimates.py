"""First-estimates Jacobians: a turned world stays unobservable, exactly."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, Start, StereoEKF, StereoObservation, VelocityDriven
from filters.geometry import rotations, symmetric
from filters.joint_state import JointState
from filters.motions.motion_model import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION

from ..dense import at_first_estimates, gamma, linearised, translations
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, drive
from ..engine.beliefs import assert_same_belief, make
from ..slots import LANDMARKS, MOTIONS
from ..state.states import without_map
from .worlds import driven, odometry

ODOMETRY = BodyVelocity((0.1, 0.0, SPEED), (0.0, 0.2, 0.01), np.diag(np.repeat([0.05, 0.01], 3) ** 2))


def carried(slam: StereoEKF, step: BodyVelocity | None) -> tuple[np.ndarray, np.ndarray]:
    """What a prediction makes of a covariance along the gauge, without the noise that it adds; the gauge there."""
    directions = gauge(slam.state)
    found = []
    for P in (0.0, 1.0):
        twin = copy.deepcopy(slam)
        state = twin.state
        state.P = P * np.asfortranarray(directions @ directions.T)
        twin.state = state
        twin.predict(DT, step)
        found.append(symmetric.full(twin.state.P))
    return found[1] - found[0], gauge(twin.state)  # the noise alone has the gain of odometry: both move alike


def gauge(state: JointState) -> np.ndarray:
    """The six directions of a moved world at the first estimates; (n, 6)."""
    at = at_first_estimates(state)
    return np.hstack([gamma(at), translations(at)])


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("measurement", ["joint", "sequential"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_first_estimates_hold_gamma_exactly(landmark: str, measurement: str, motion: str) -> None:
    """H Gamma = 0, F Gamma_k = Gamma_k+1, and J Gamma = Gamma of a new landmark, over a run with a changing map."""
    options = {"landmark": landmark, "measurement": measurement, "motion": motion, "gate": None}
    stereo_filter = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="first-estimates", **options)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=0.01 * np.eye(12)))
    frames, rng = drive(9, 12, visible=10, depths=(6.0, 25.0)), np.random.default_rng(1)
    corrected = 0.0
    for k, frame in enumerate(frames):
        if k:
            moved = odometry(frames[k - 1], frame, rng, sigma=0.2)
            told = moved if motion == "velocity-driven" or k % 2 else None
            after, there = carried(stereo_filter, told)
            stereo_filter.predict(DT, told)
            np.testing.assert_allclose(after, there @ there.T, rtol=0, atol=1e-10 * np.abs(there).max() ** 2)
        landmarks, seen = stereo_filter.landmarks.ids, frame.observation
        stereo_filter.forget(landmarks[~np.isin(landmarks, seen.ids)])  # as the update would do first
        state = stereo_filter.state
        if len(state):
            prior = gauge(state)
            H = linearised(stereo_filter, seen.select(np.isin(seen.ids, state.ids))).H
            np.testing.assert_allclose(H @ prior, 0.0, rtol=0, atol=1e-9 * np.abs(H).max() * np.abs(prior).max())
        stereo_filter.update(seen)
        corrected = max(corrected, np.abs(stereo_filter.state.camera.position - state.camera.position).max())
    assert corrected > 1e-3  # or first and current estimates would be the same


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_first_estimates_start_landmarks_along_gamma(landmark: str) -> None:
    """A covariance along Gamma of the camera becomes one along Gamma of camera and map: nothing is gained by adding."""
    state = driven(drive(10, 3, visible=6), landmark=landmark, error="first-estimates", motion=VelocityDriven()).state
    stereo_filter = make(landmark=landmark, error="first-estimates", motion=VelocityDriven(), drop_unseen=False)
    predicted = replace(state.camera, position=state.camera.position + 0.5)
    along = np.zeros((CAMERA_SIZE, 3))
    along[POSITION], along[ROTATION] = -rotations.skew(predicted.position), predicted.R_wc.T
    known = replace(without_map(state.camera, along @ along.T, state.model), predicted=predicted)
    stereo_filter.state = known
    uvd = np.array([[500.0, 150.0, 20.0], [900.0, 250.0, 9.0], [700.0, 100.0, 40.0]])
    stereo_filter.update(StereoObservation(np.arange(3), uvd, R=np.tile(1e-20 * np.eye(3), (3, 1, 1))))
    grown = stereo_filter.state
    expected = gamma(at_first_estimates(grown))
    expected[LINEAR], expected[ANGULAR] = 0.0, 0.0
    actual = symmetric.full(grown.P)
    np.testing.assert_allclose(actual, expected @ expected.T, rtol=0, atol=1e-9 * np.abs(actual).max())


def corrected_by(slam: StereoEKF, told: BodyVelocity) -> None:
    """The same as odometry, by a correction."""
    measured = slam.options.motion.odometry_measurement(slam.state.camera, DT, told)
    H = {"pose": measured.H[:, :6], "velocity": measured.H[:, 6:]}
    assert slam.correct(measured.innovation, H, measured.R).used


def test_h_is_taken_where_odometry_or_a_correction_has_led() -> None:
    """Both come before the camera; landmarks that are measured then do not move the point."""
    frames = drive(3, 2)
    for fuse in (
        lambda slam: slam.predict(DT, ODOMETRY),
        lambda slam: (slam.predict(DT), corrected_by(slam, ODOMETRY)),
    ):
        slam = make(error="first-estimates")
        slam.update(frames[0].observation)
        fuse(slam)
        at = slam.state.camera
        slam.update(frames[1].observation)
        after = slam.state
        np.testing.assert_array_equal(after.predicted.linear_velocity, at.linear_velocity)
        np.testing.assert_array_equal(after.predicted.position, at.position)
        assert np.linalg.norm(after.camera.position - at.position) > 1e-4


@pytest.mark.parametrize("error", ["first-estimates", "so3"])
def test_odometry_is_a_correction_after_the_step(error: str) -> None:
    fused, corrected = (make(error=error, drop_unseen=False) for _ in range(2))
    for k, frame in enumerate(drive(4, 8)):
        if k:
            fused.predict(DT, ODOMETRY)
            corrected.predict(DT)
            corrected_by(corrected, ODOMETRY)
        for slam in (fused, corrected):
            slam.update(frame.observation)
    assert_same_belief(fused, corrected, 1e-7)
