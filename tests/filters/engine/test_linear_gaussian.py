"""Where everything is linear and Gaussian the engine is the Kalman filter: every such case against filterpy's."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from filters import BodyVelocity, ConstantVelocity, Euclidean, Start, StereoEKF
from filters.geometry import symmetric
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, drive, finish
from ..state.states import augment, camera_at, new_landmarks, remove, transform_variables, without_map
from .linear_problems import assert_covariances_equal, dense, lower, random_covariance, random_measurements, update


def kalman_filter(x: np.ndarray, P: np.ndarray) -> KalmanFilter:
    made = KalmanFilter(dim_x=len(x), dim_z=1)
    made.x, made.P = x.copy(), P.copy()
    return made


def assert_same(x: np.ndarray, P: np.ndarray, reference: KalmanFilter, tolerance: float = 1e-9) -> None:
    """The mean within `tolerance` sigmas, the covariance within as many of its variances."""
    sigmas = np.sqrt(np.diag(reference.P))
    np.testing.assert_allclose(x / sigmas, reference.x / sigmas, rtol=0, atol=tolerance)
    assert_covariances_equal(P, reference.P, tolerance)


@pytest.mark.parametrize("rows", [1, 6, 70])
def test_a_correction_is_one_update_of_filterpy(rows: int) -> None:
    """Of pose, velocity, landmarks and a clone together: estimate, covariance and NIS."""
    rng = np.random.default_rng([21, rows])
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark="euclidean", error="first-estimates", drop_unseen=False)
    finish(slam, drive(21, 5, depths=(6.0, 30.0)))
    slam.clone_pose("then")
    slam.predict(DT)
    state = slam.state
    P, ids = symmetric.full(state.P), state.ids[:3]
    rows_of = {name: state.layout.rows_of((name,)) for name in ("velocity", "pose")}
    rows_of |= {int(i): state.own_rows(np.array([k]))[0] for k, i in enumerate(ids)}
    rows_of["then"] = state.block_rows(state.clones["then"].blocks)
    H_of = {name: rng.standard_normal((rows, len(place))) for name, place in rows_of.items()}
    innovation, R = 1e-2 * rng.standard_normal(rows), random_covariance(rng, rows)
    H = np.zeros((rows, len(P)))
    for name, place in rows_of.items():
        H[:, place] = H_of[name]
    reference = kalman_filter(np.zeros(len(P)), P)
    reference.update(innovation, R=R, H=H)
    still = deepcopy(slam)
    still.correct(np.zeros(rows), H_of, R)  # nothing moves, so P is not carried to another first estimate
    told = slam.correct(innovation, H_of, R)
    after = slam.state
    delta = np.concatenate([after.blocks[k] - state.blocks[k] for k in state.parameter_block])
    own = state.own_rows().ravel()
    sigmas = np.sqrt(np.diag(reference.P))
    np.testing.assert_allclose(delta / sigmas[own], reference.x[own] / sigmas[own], rtol=0, atol=1e-8)
    assert_covariances_equal(symmetric.full(still.state.P), reference.P, 1e-7)
    assert told.nis == pytest.approx(float(reference.mahalanobis) ** 2, rel=1e-7)
    assert (told.used, told.nis_dof) == (True, rows)


# --- a map that grows and shrinks ---


def test_a_map_that_grows_and_shrinks_equals_filterpy_with_every_landmark_ever_seen() -> None:
    """30 frames of linear SLAM; filterpy keeps every landmark and knows nothing of blocks.

    A new landmark is a linear function of the pose plus noise; one that leaves is just not looked at any more.
    """
    rng = np.random.default_rng(24)
    state = without_map(camera_at(np.zeros(3)), lower(random_covariance(rng, CAMERA_SIZE)), Euclidean())
    x_camera = np.zeros(CAMERA_SIZE)  # the map's values are the state's blocks
    reference = kalman_filter(x_camera, symmetric.full(state.P))
    everyone: list[int] = []
    for frame in range(30):
        F = np.eye(CAMERA_SIZE) + 0.1 * rng.standard_normal((CAMERA_SIZE, CAMERA_SIZE))
        Q = 0.1 * random_covariance(rng, CAMERA_SIZE)
        _predict(reference, F, Q)
        transform_variables(state, F, Q)
        x_camera = F @ x_camera

        seen = rng.choice(len(state), min(len(state), 6), replace=False)
        if len(seen):
            measurements = replace(random_measurements(rng, len(seen), 3, len(state), 1), map_rows=state.map_rows(seen))
            places = np.array([everyone.index(i) for i in state.ids[seen].tolist()])
            in_full = CAMERA_SIZE + 3 * places[:, None] + np.arange(3)
            z, H, R = dense(replace(measurements, map_rows=in_full), len(reference.x))
            reference.update(z, R=R, H=H)
            x = np.concatenate([x_camera, state.blocks.ravel()])
            relative = replace(measurements, innovation=measurements.innovation - measurements.times(x))
            delta = update(state.P, relative)
            x_camera = x_camera + delta[:CAMERA_SIZE]
            state.blocks = state.blocks + delta[CAMERA_SIZE:].reshape(-1, 3)

        remove(state, rng.uniform(size=len(state)) < 0.2)

        new = int(rng.integers(0, 4))
        ids = list(range(10 * frame, 10 * frame + new))
        by_pose, by_noise = rng.standard_normal((new, 3, POSE_SIZE)), rng.standard_normal((new, 3, 3))
        R = np.tile(np.diag([0.5, 1.0, 2.0]), (new, 1, 1))
        if new:
            noise = by_noise @ R @ by_noise.transpose(0, 2, 1)
            augment(state, new_landmarks(np.array(ids), by_pose @ x_camera[:POSE_SIZE], by_pose, noise, False))
            _grow(reference, by_pose.reshape(-1, POSE_SIZE), noise)
            everyone += ids

        places = np.array([everyone.index(i) for i in state.ids.tolist()], dtype=np.int64)
        kept = np.concatenate([np.arange(CAMERA_SIZE), (CAMERA_SIZE + 3 * places[:, None] + np.arange(3)).ravel()])
        marginal = kalman_filter(reference.x[kept], reference.P[np.ix_(kept, kept)])
        rows = np.concatenate([np.arange(CAMERA_SIZE), state.map_rows(np.arange(len(state))).ravel()])
        x = np.concatenate([x_camera, state.blocks.ravel()])
        assert_same(x[rows], symmetric.full(state.P)[np.ix_(rows, rows)], marginal, 1e-7)
    assert len(everyone) > 30
    assert 3 < len(state) < len(everyone)


def _predict(reference: KalmanFilter, F_camera: np.ndarray, Q_camera: np.ndarray) -> None:
    """Move the camera of a whole state, and nothing else."""
    size = len(reference.x)
    F, Q = np.eye(size), np.zeros((size, size))
    F[:CAMERA_SIZE, :CAMERA_SIZE], Q[:CAMERA_SIZE, :CAMERA_SIZE] = F_camera, Q_camera
    reference.predict(F=F, Q=Q)


def _grow(reference: KalmanFilter, J: np.ndarray, noise: np.ndarray) -> None:
    """A new landmark is a prediction with a tall F: (x, J x_pose + n)."""
    size = len(reference.x)
    F = np.vstack([np.eye(size), np.hstack([J, np.zeros((len(J), size - POSE_SIZE))])])
    Q = np.zeros((len(F), len(F)))
    for i, block in enumerate(noise):
        rows = slice(size + 3 * i, size + 3 * i + 3)
        Q[rows, rows] = block
    grown = kalman_filter(F @ reference.x, F @ reference.P @ F.T + Q)
    reference.__dict__.update(grown.__dict__)


# --- the whole filter, where its camera does not turn: position and velocity are linear ---


def straight(**options) -> tuple[StereoEKF, KalmanFilter]:
    """A filter that knows it does not turn, and filterpy's for its position and velocity."""
    stereo_filter = StereoEKF(CAMERA, INDEPENDENT_PIXELS, motion=ConstantVelocity(3.0, 0.0), **options)
    rng = np.random.default_rng(25)
    translation = np.r_[0:3, 6:9]
    P = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
    P[np.ix_(translation, translation)] = random_covariance(rng, 6)
    stereo_filter.reset(Start((1.0, 2.0, 3.0), linear_velocity=(0.0, 0.5, SPEED), covariance=P))
    reference = kalman_filter(np.array([1.0, 2.0, 3.0, 0.0, 0.5, SPEED]), P[np.ix_(translation, translation)])
    return stereo_filter, reference


def assert_translation_is(stereo_filter: StereoEKF, reference: KalmanFilter) -> None:
    x = np.concatenate([stereo_filter.pose.position, stereo_filter.velocity.linear])
    sigmas = np.sqrt(np.diag(reference.P))
    np.testing.assert_allclose(x / sigmas, reference.x / sigmas, rtol=0, atol=1e-9)
    for part, whole in ((stereo_filter.pose.covariance, slice(0, 3)), (stereo_filter.velocity.covariance, slice(3, 6))):
        assert_covariances_equal(part[:3, :3], reference.P[whole, whole], 1e-9)


@pytest.mark.parametrize("error", ["quaternion", "so3", "first-estimates"])
@pytest.mark.parametrize("odometry", [False, True])
def test_prediction_and_odometry_of_a_camera_that_does_not_turn(odometry: bool, error: str) -> None:
    """Steps of unequal length; odometry measures the velocity after each."""
    stereo_filter, reference = straight(error=error)
    rng = np.random.default_rng(26)
    for dt in (0.1, 0.02, 0.4, 0.1, 0.1):
        F, G = np.eye(6), np.vstack([dt * np.eye(3), np.eye(3)])
        F[:3, 3:] = dt * np.eye(3)
        reference.predict(F=F, Q=(3.0 * dt) ** 2 * G @ G.T)
        measured = None
        if odometry:
            linear = np.array([0.0, 0.5, SPEED]) + 0.3 * rng.standard_normal(3)
            R = np.diag([0.3, 0.2, 0.4]) ** 2
            measured = BodyVelocity(
                linear, np.zeros(3), np.block([[R, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
            )
            reference.update(linear, R=R, H=np.hstack([np.zeros((3, 3)), np.eye(3)]))
        stereo_filter.predict(dt, measured)
        assert_translation_is(stereo_filter, reference)
