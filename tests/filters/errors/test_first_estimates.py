"""First-estimates Jacobians: a turned world stays unobservable, exactly."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, Extended, FirstEstimates, Start, StereoEKF, StereoObservation, VelocityDriven
from filters.geometry import rotations, symmetric
from filters.motions.motion_model import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION
from filters.state.joint_state import JointState, world_rotation_of_variables
from filters.state.layout import LinearisedMeasurements

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, drive
from ..engine.beliefs import assert_same_belief, make
from ..engine.linear_problems import dense
from ..slots import LANDMARKS, MOTIONS
from ..state.states import without_map
from .worlds import driven, odometry

ODOMETRY = BodyVelocity((0.1, 0.0, SPEED), (0.0, 0.2, 0.01), np.diag(np.repeat([0.05, 0.01], 3) ** 2))


class Watching(Extended):
    """Notes the H of every update."""

    def __init__(self) -> None:
        self.seen: list[LinearisedMeasurements] = []

    def linearise(self, *arguments) -> LinearisedMeasurements:
        """As the base class."""
        self.seen.append(super().linearise(*arguments))
        return self.seen[-1]


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


def translations(state: JointState) -> np.ndarray:
    """Effect of moving the world on the error state; (n, 3)."""
    blocks = np.tile(np.eye(3), (len(state.blocks), 1, 1))
    blocks[state.parameter_block[state.anchor_block >= 0]] = 0.0
    camera = np.zeros((CAMERA_SIZE, 3))
    camera[POSITION] = np.eye(3)
    return np.vstack([camera, blocks.reshape(-1, 3)])


def gauge(state: JointState) -> np.ndarray:
    """The six directions of a moved world at the first estimates; (n, 6)."""
    at = state.at_first_estimates()
    return np.hstack([at.world_rotation(), translations(at)])


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("measurement", ["joint", "sequential"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_first_estimates_hold_gamma_exactly(landmark: str, measurement: str, motion: str) -> None:
    """H Gamma = 0, F Gamma_k = Gamma_k+1, and J Gamma = Gamma of a new landmark, over a run with a changing map."""
    watching = Watching()
    options = {"landmark": landmark, "measurement": measurement, "motion": motion, "gate": None}
    stereo_filter = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="first-estimates", update=watching, **options)
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
        watching.seen.clear()
        landmarks = stereo_filter.landmarks.ids
        stereo_filter.forget(landmarks[~np.isin(landmarks, frame.observation.ids)])  # as the update would do first
        prior = gauge(stereo_filter.state)
        old_camera = stereo_filter.state.camera
        stereo_filter.update(frame.observation)
        for measurements in watching.seen:
            H = dense(measurements, len(prior))[1]
            np.testing.assert_allclose(H @ prior, 0.0, rtol=0, atol=1e-9 * np.abs(H).max() * np.abs(prior).max())
        corrected = max(corrected, np.abs(stereo_filter.state.camera.position - old_camera.position).max())
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
    expected = grown.at_first_estimates().world_rotation()
    expected[LINEAR], expected[ANGULAR] = 0.0, 0.0
    actual = symmetric.full(grown.P)
    np.testing.assert_allclose(actual, expected @ expected.T, rtol=0, atol=1e-9 * np.abs(actual).max())


def local_observability(error: str, landmark: str, motion: str) -> tuple[np.ndarray, np.ndarray]:
    """H_k F_k-1 ... F_0 stacked over 12 frames of one map, and the gauge directions at the start."""
    watching = Watching()
    options = {"landmark": landmark, "motion": motion, "gate": None, "drop_unseen": False, "update": watching}
    stereo_filter = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **options)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=0.01 * np.eye(12)))
    frames, rng = drive(11, 12, visible=8, missed=0.0, depths=(15.0, 40.0)), np.random.default_rng(2)
    first = set(frames[0].observation.ids.tolist())
    rows, product, start = [], np.eye(0), np.zeros(0)
    for k, frame in enumerate(frames):
        if k:
            moved, state, parts = (
                odometry(frames[k - 1], frame, rng, sigma=0.2),
                stereo_filter.state,
                stereo_filter.options,
            )
            step = parts.motion.predict(state.camera, DT, moved)
            image = world_rotation_of_variables(state.layout, step.state)
            stereo_filter.predict(DT, moved)
            F = np.eye(len(product))
            settled = stereo_filter.state
            image_settled = world_rotation_of_variables(state.layout, settled.camera)
            by_odometry = parts.error.constrained(
                np.eye(CAMERA_SIZE), image_settled, replace(state, predicted=step.state)
            )
            F[:CAMERA_SIZE, :CAMERA_SIZE] = by_odometry @ parts.error.constrained(step.F, image, state)
            product = F @ product
        seen = frame.observation
        watching.seen.clear()
        stereo_filter.update(seen.select([i for i, name in enumerate(seen.ids.tolist()) if name in first]))
        if not k:
            start = gauge(stereo_filter.state)
            product = np.eye(len(start))
        rows += [dense(m, len(start))[1] @ product for m in watching.seen if len(m)]
    return np.vstack(rows), start


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_only_first_estimates_learn_nothing_about_the_world_frame(landmark: str, motion: str) -> None:
    size = {}
    for error in ("first-estimates", "so3"):
        stacked, start = local_observability(error, landmark, motion)
        by_direction = (
            np.linalg.norm(stacked @ start, axis=0) / np.linalg.norm(stacked, 2) / np.linalg.norm(start, axis=0)
        )
        size[error] = by_direction[:3].max(), by_direction[3:].max()
    assert max(size["first-estimates"]) < 1e-11
    assert size["so3"][1] < 1e-11  # a moved world stays unobservable in every EKF
    assert size["so3"][0] > 1e-5  # a turned one does not


@pytest.mark.parametrize("motion", MOTIONS)
def test_rank_of_the_local_observability_matrix(motion: str) -> None:
    """XYZ, where every direction but the gauge can be seen: six are missing, three with a plain EKF."""
    never_seen = 6 if motion == "velocity-driven" else 0  # velocities before a step that odometry decides
    missing = {}
    for error in ("first-estimates", "so3"):
        stacked, _ = local_observability(error, "euclidean", motion)
        scale = np.linalg.norm(stacked, axis=0)
        values = np.linalg.svd(stacked / np.where(scale > 0, scale, 1.0), compute_uv=False)
        missing[error] = stacked.shape[1] - int(np.sum(values > 1e-11 * values[0])) - never_seen
    assert missing == {"first-estimates": 6, "so3": 3}


class ByNumbers(FirstEstimates):
    """A subclass states no kernels."""


def corrected_by(slam: StereoEKF, told: BodyVelocity) -> None:
    """The same as odometry, by a correction."""
    measured = slam.options.motion.odometry_measurement(slam.state.camera, DT, told)
    H = {"pose": measured.H[:, :6], "velocity": measured.H[:, 6:]}
    assert slam.correct(measured.innovation, H, measured.R).used


@pytest.mark.parametrize("error", ["first-estimates", ByNumbers()], ids=["compiled", "by numbers"])
def test_h_is_taken_where_odometry_or_a_correction_has_led(error: object) -> None:
    """Both come before the camera; landmarks that are measured then do not move the point."""
    frames = drive(3, 2)
    for fuse in (
        lambda slam: slam.predict(DT, ODOMETRY),
        lambda slam: (slam.predict(DT), corrected_by(slam, ODOMETRY)),
    ):
        slam = make(error=error)
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


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_subclass_has_the_same_jacobians_by_numbers(landmark: str, motion: str) -> None:
    """H, F, and the Jacobians of new landmarks and of odometry; and the walk of the gauge."""
    options = {"landmark": landmark, "motion": motion, "gauge_walk": 0.01, "iterations": 2}
    frames = drive(5, 8, depths=(6.0, 25.0), noise_scale=3.0)
    compiled, by_numbers, plain = (
        driven(frames, error=error, **options | own)
        for error, own in (("first-estimates", {}), (ByNumbers(), {}), ("so3", {"gauge_walk": 0.0}))
    )
    assert_same_belief(by_numbers, compiled, 1e-6)
    with pytest.raises(AssertionError):
        assert_same_belief(plain, compiled, 1e-3)
