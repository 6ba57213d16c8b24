"""What first-estimates and right-invariant errors promise: a turned world stays unobservable (12 s)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filters.engine.error_definition import ERRORS
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, ConstantVelocity, Start, StereoEKF, StereoObservation, VelocityDriven, rotations
from filters.motions.model import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION, CameraState, MotionModel
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.state.linearised import LinearisedMeasurements

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, Frame, drive
from ..invariant_ekf import InvariantEKF, wedge
from ..numeric import numeric_jacobian, relative_difference
from .beliefs import make, scaled, tilted

LANDMARKS = ["inverse-depth", "shared-anchor", "euclidean", "hybrid"]
MOTIONS: dict[str, MotionModel] = {"constant velocity": ConstantVelocity(), "velocity-driven": VelocityDriven()}


def odometry(before: Frame, after: Frame, rng: np.random.Generator, sigma: float = 0.05) -> BodyVelocity:
    """Velocity of a step with an error of `sigma`, m/s and rad/s."""
    start, end = Rotation.from_quat(before.orientation), Rotation.from_quat(after.orientation)
    turn = (start.inv() * end).as_rotvec()
    half_way = start * Rotation.from_rotvec(0.5 * turn)
    velocity = np.concatenate([half_way.inv().apply(after.position - before.position), turn]) / DT
    velocity += sigma * rng.standard_normal(6)
    return BodyVelocity(velocity[:3], velocity[3:], sigma**2 * np.eye(6))


def driven(frames: list[Frame], **options) -> StereoEKF:
    """A filter after a drive with noisy odometry."""
    stereo_filter = make(**{"drop_unseen": False, **options})
    rng = np.random.default_rng(0)
    for k, frame in enumerate(frames):
        if k:
            stereo_filter.predict(DT, odometry(frames[k - 1], frame, rng))
        stereo_filter.update(frame.observation)
    return stereo_filter


def some_state(landmark: str) -> JointState:
    """A map of several frames seen from a pose in general position, with a dense covariance."""
    stereo_filter = tilted(make(landmark=landmark, drop_unseen=False))
    for k, frame in enumerate(drive(1, 5, visible=4, depths=(6.0, 30.0))):
        if k:
            stereo_filter.predict(DT)
        stereo_filter.update(frame.observation)
    state = stereo_filter.state
    root = np.random.default_rng(2).standard_normal(state.P.shape)
    return replace(state, P=np.asfortranarray(np.tril(root @ root.T)))


def direction(angles: np.ndarray) -> np.ndarray:
    """Eq. 5."""
    theta, phi = angles[:, 0], angles[:, 1]
    return np.stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=1)


def turned_world(state: JointState, turn: Rotation) -> JointState:
    """Camera and map, rotated about the origin of W."""
    camera = state.camera
    moved = CameraState(
        turn.apply(camera.position),
        (turn * Rotation.from_quat(camera.orientation)).as_quat(),
        turn.apply(camera.linear_velocity),
        camera.angular_velocity,
    )
    blocks = turn.apply(state.blocks)
    if state.model.anchored:
        own = state.blocks[state.parameter_block]
        x, y, z = turn.apply(direction(own)).T
        turned = np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z)), own[:, 2]], axis=1)
        blocks[state.parameter_block] = turned
    return replace(state, camera=moved, blocks=blocks)


def standard_error(state: JointState, other: JointState) -> np.ndarray:
    """The error that leads from `state` to `other`."""
    start, end = Rotation.from_quat(state.camera.orientation), Rotation.from_quat(other.camera.orientation)
    blocks = other.blocks - state.blocks
    if state.model.anchored:  # azimuth is an angle
        theta = blocks[state.parameter_block, 0]
        blocks[state.parameter_block, 0] = np.arctan2(np.sin(theta), np.cos(theta))
    return np.concatenate(
        [
            other.camera.position - state.camera.position,
            (start.inv() * end).as_rotvec(),
            other.camera.linear_velocity - state.camera.linear_velocity,
            other.camera.angular_velocity - state.camera.angular_velocity,
            blocks.ravel(),
        ]
    )


def translations(state: JointState) -> np.ndarray:
    """Effect of moving the world on the error state; (n, 3)."""
    blocks = np.tile(np.eye(3), (len(state.blocks), 1, 1))
    blocks[state.parameter_block[state.anchor_block >= 0]] = 0.0
    camera = np.zeros((CAMERA_SIZE, 3))
    camera[POSITION] = np.eye(3)
    return np.vstack([camera, blocks.reshape(-1, 3)])


def small_correction(state: JointState, seed: int, size: float = 0.2) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(len(state.P))


# --- the two tools: Gamma, and the shear of P ---


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_gamma_is_the_effect_of_turning_the_world(landmark: str) -> None:
    state = some_state(landmark)
    numeric = numeric_jacobian(lambda e: standard_error(state, turned_world(state, Rotation.from_rotvec(e))), 3)
    assert relative_difference(state.world_rotation(), numeric) < 1e-7


@pytest.mark.parametrize("whole", [False, True], ids=["camera rows", "all rows"])
def test_shear_is_the_dense_formula(whole: bool) -> None:
    state = some_state("shared-anchor")
    size = len(state.P)
    W = np.zeros((size, 3))
    given = size if whole else CAMERA_SIZE
    W[:given] = np.random.default_rng(3).standard_normal((given, 3))
    M = np.eye(size)
    M[:, ROTATION] += W
    expected = M @ symmetric.full(state.P) @ M.T
    state.shear_by_rotation(W[:given])
    np.testing.assert_allclose(symmetric.full(state.P), expected, rtol=0, atol=1e-11 * np.abs(expected).max())


# --- right-invariant ---


def to_invariant(state: JointState) -> np.ndarray:
    """T of xi = T delta: theta = R delta_theta, and the rest is what a rotation by theta does not explain."""
    R_wc = state.camera.R_wc
    T = np.eye(len(state.P))
    T[:, ROTATION] -= state.world_rotation() @ R_wc
    T[ROTATION, ROTATION] = R_wc
    return T


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_correction_leaves_p_alone_in_invariant_coordinates(landmark: str) -> None:
    before, error = some_state(landmark), ERRORS["right-invariant"]
    delta = small_correction(before, 4)
    after = error.moved(replace(before, P=before.P.copy(order="F")), delta)
    after.shear_by_rotation(error.transport(before, after, delta))
    P, P_after = (to_invariant(s) @ symmetric.full(s.P) @ to_invariant(s).T for s in (before, after))
    np.testing.assert_allclose(P_after, P, rtol=0, atol=1e-10 * np.abs(P).max())
    assert np.abs(symmetric.full(after.P) - symmetric.full(before.P)).max() > 1.0


def test_a_correction_is_the_exponential_of_the_group() -> None:
    """Of [[R, r, v, f_1 ... f_n], [0, I]], from the left; the angular velocity is added to."""
    state = some_state("euclidean")
    delta = small_correction(state, 5)
    xi = to_invariant(state) @ delta
    columns = np.vstack([xi[ROTATION], xi[POSITION], xi[LINEAR], xi[CAMERA_SIZE:].reshape(-1, 3)])
    X = np.eye(len(columns) + 2)
    X[:3, :3] = state.camera.R_wc
    X[:3, 3:] = np.vstack([state.camera.position, state.camera.linear_velocity, state.blocks]).T
    X = expm(wedge(columns.ravel())) @ X
    moved = ERRORS["right-invariant"].moved(state, delta)
    np.testing.assert_allclose(moved.camera.R_wc, X[:3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(moved.camera.position, X[:3, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(moved.camera.linear_velocity, X[:3, 4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(moved.blocks, X[:3, 5:].T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        moved.camera.angular_velocity, state.camera.angular_velocity + delta[ANGULAR], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_correction_along_gamma_turns_the_world(landmark: str) -> None:
    """However large: this is what makes the filter blind to the choice of W."""
    state, theta = some_state(landmark), np.array([0.3, -1.1, 0.7])
    moved = ERRORS["right-invariant"].moved(state, state.world_rotation() @ theta)
    expected = turned_world(state, Rotation.from_rotvec(theta))
    np.testing.assert_allclose(standard_error(expected, moved), 0.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_correction_is_delta_to_first_order(landmark: str, error: str) -> None:
    state = some_state(landmark)
    numeric = numeric_jacobian(lambda d: standard_error(state, ERRORS[error].moved(state, d)), len(state.P))
    np.testing.assert_allclose(numeric, np.eye(len(state.P)), rtol=0, atol=1e-7)


@pytest.mark.parametrize("error", ["quaternion", "so3"])
def test_transport_is_the_derivative_of_the_correction(error: str) -> None:
    state, definition = some_state("euclidean"), ERRORS[error]
    delta = small_correction(state, 6, 0.3)
    moved = definition.moved(state, delta)
    # Local coordinates at `moved` agree with the standard error to first order, so one derivative serves all.
    numeric = numeric_jacobian(lambda e: standard_error(moved, definition.moved(state, delta + e)), len(state.P))
    expected = np.eye(len(state.P))
    expected[:CAMERA_SIZE, ROTATION] += definition.transport(state, moved, delta)
    np.testing.assert_allclose(numeric, expected, rtol=0, atol=1e-7)


# --- the error that NEES is made of ---


@pytest.mark.parametrize("error", ERRORS)
def test_pose_covariance_is_that_of_the_pose_error(error: str) -> None:
    state, definition = some_state("euclidean"), ERRORS[error]
    camera, P_pose = state.camera, symmetric.full(state.P)[:6, :6]

    def error_of(delta: np.ndarray) -> np.ndarray:
        truth = Rotation.from_quat(camera.orientation) * Rotation.from_rotvec(delta[3:])
        return definition.pose_error(camera, P_pose, camera.position + delta[:3], truth.as_quat())[0]

    np.testing.assert_allclose(error_of(np.zeros(6)), 0.0, rtol=0, atol=1e-12)
    J = numeric_jacobian(error_of, 6)
    covariance = definition.pose_error(camera, P_pose, camera.position, camera.orientation)[1]
    np.testing.assert_allclose(covariance, J @ P_pose @ J.T, rtol=0, atol=1e-7 * np.abs(covariance).max())


@pytest.mark.parametrize("error", ERRORS)
def test_pose_error_is_the_correction_that_leads_to_the_truth(error: str) -> None:
    """Not only to first order."""
    state, definition = some_state("euclidean"), ERRORS[error]
    delta = small_correction(state, 7, 0.4)
    truth = definition.moved(state, delta).camera
    actual, _ = definition.pose_error(state.camera, np.eye(6), truth.position, truth.orientation)
    xi = to_invariant(state) @ delta if error == "right-invariant" else delta
    np.testing.assert_allclose(actual, xi[:6], rtol=0, atol=1e-11)


def test_the_right_invariant_filter_equals_one_written_from_the_paper() -> None:
    """Pose, map and both covariances, over 20 steps in which landmarks enter and are missed."""
    frames = drive(3, 21, visible=12, depths=(6.0, 20.0))
    stereo_filter = make(landmark="euclidean", error="right-invariant", motion=VelocityDriven(), drop_unseen=False)
    reference = InvariantEKF(CAMERA, INDEPENDENT_PIXELS.R)
    sigmas = np.array([0.2, 0.3, 0.1, 0.02, 0.05, 0.03])
    stereo_filter.reset(Start(covariance=np.diag(np.concatenate([sigmas, np.ones(6)]) ** 2)))
    reference.P = np.diag(np.concatenate([sigmas[3:], sigmas[:3]]) ** 2)
    rng = np.random.default_rng(8)
    for k, frame in enumerate(frames):
        if k:
            moved = odometry(frames[k - 1], frame, rng, sigma=0.3)
            stereo_filter.predict(DT, moved)
            reference.predict(DT, moved)
        stereo_filter.update(frame.observation)
        reference.update(frame.observation)
        np.testing.assert_allclose(stereo_filter.pose.position, reference.position, rtol=0, atol=1e-8)
        np.testing.assert_allclose(rotations.matrix(stereo_filter.pose.orientation), reference.rotation, atol=1e-8)
        _, covariance = stereo_filter.pose_error(frame.position, frame.orientation)
        swapped = reference.P[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])]
        np.testing.assert_allclose(*scaled(covariance, swapped), rtol=0, atol=1e-8)
        believed = stereo_filter.landmarks
        order = believed.ids.tolist()
        assert sorted(reference.ids) == order
        np.testing.assert_allclose(believed.positions, [reference.landmark(i) for i in order], rtol=0, atol=1e-8)
        expected = np.array([reference.landmark_covariance(i) for i in order])
        np.testing.assert_allclose(*scaled(believed.covariances, expected), rtol=0, atol=1e-8)
    assert len(reference.ids) > 20


# --- first estimates: what is unobservable stays so ---


class Watched(StereoEKF):
    """Notes the H of every update."""

    def __init__(self, *args, **options) -> None:
        self.seen: list[LinearisedMeasurements] = []
        super().__init__(*args, **options)

    def _linearise(self, state, index, stage):
        self.seen.append(super()._linearise(state, index, stage))
        return self.seen[-1]


def dense(measurements: LinearisedMeasurements, size: int) -> np.ndarray:
    """H (3 M, size)."""
    H = np.zeros((*measurements.innovation.shape, size))
    H[:, :, : measurements.by_leading.shape[2]] = measurements.by_leading
    for landmark, rows in enumerate(measurements.map_rows):
        H[landmark][:, rows] += measurements.by_map[landmark]
    return H.reshape(-1, size)


def gauge(state: JointState) -> np.ndarray:
    """The six directions of a moved world at the first estimates; (n, 6)."""
    at = state.at_first_estimates()
    return np.hstack([at.world_rotation(), translations(at)])


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("measurement", ["joint", "sequential"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_first_estimates_hold_gamma_exactly(
    landmark: str, measurement: str, motion: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H Gamma = 0, F Gamma_k = Gamma_k+1, and J Gamma = Gamma of a new landmark, over a run with a changing map."""
    applied: list[np.ndarray] = []
    transform = JointState.transform_camera

    def noted(state: JointState, F: np.ndarray, added: np.ndarray | None = None) -> None:
        applied.append(F)
        transform(state, F, added)

    monkeypatch.setattr(JointState, "transform_camera", noted)
    options = {"landmark": landmark, "measurement": measurement, "motion": MOTIONS[motion], "gate": None}
    stereo_filter = Watched(CAMERA, INDEPENDENT_PIXELS, error="first-estimates", **options)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=0.01 * np.eye(12)))
    frames, rng = drive(9, 12, visible=10, depths=(6.0, 25.0)), np.random.default_rng(1)
    corrected = 0.0
    for k, frame in enumerate(frames):
        if k:
            before = gauge(stereo_filter.state)[:CAMERA_SIZE]
            applied.clear()
            stereo_filter.predict(DT, odometry(frames[k - 1], frame, rng, sigma=0.2))
            np.testing.assert_allclose(applied[0] @ before, gauge(stereo_filter.state)[:CAMERA_SIZE], atol=1e-11)
        stereo_filter.seen.clear()
        prior = gauge(stereo_filter.state)
        old_camera = stereo_filter.state.camera
        stereo_filter.update(frame.observation)
        for measurements in stereo_filter.seen:
            H = dense(measurements, len(prior))
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
    stereo_filter.state = replace(
        JointState.without_map(state.camera, along @ along.T, state.model), predicted=predicted
    )
    uvd = np.array([[500.0, 150.0, 20.0], [900.0, 250.0, 9.0], [700.0, 100.0, 40.0]])
    stereo_filter.update(StereoObservation(np.arange(3), uvd, R=np.tile(1e-20 * np.eye(3), (3, 1, 1))))
    grown = stereo_filter.state
    expected = grown.at_first_estimates().world_rotation()
    expected[LINEAR], expected[ANGULAR] = 0.0, 0.0
    actual = symmetric.full(grown.P)
    np.testing.assert_allclose(actual, expected @ expected.T, rtol=0, atol=1e-9 * np.abs(actual).max())


def local_observability(error: str, landmark: str, motion: str) -> tuple[np.ndarray, np.ndarray]:
    """H_k F_k-1 ... F_0 stacked over 12 frames of one map, and the gauge directions at the start."""
    options = {"landmark": landmark, "motion": MOTIONS[motion], "gate": None, "drop_unseen": False}
    stereo_filter = Watched(CAMERA, INDEPENDENT_PIXELS, error=error, **options)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=0.01 * np.eye(12)))
    frames, rng = drive(11, 12, visible=8, missed=0.0, depths=(15.0, 40.0)), np.random.default_rng(2)
    first = set(frames[0].observation.ids.tolist())
    rows, product, start = [], np.eye(0), np.zeros(0)
    applied: list[np.ndarray] = []
    with pytest.MonkeyPatch.context() as patch:
        transform = JointState.transform_camera
        patch.setattr(
            JointState,
            "transform_camera",
            lambda state, F, added=None: (applied.append(F), transform(state, F, added))[1],
        )
        for k, frame in enumerate(frames):
            if k:
                applied.clear()
                stereo_filter.predict(DT, odometry(frames[k - 1], frame, rng, sigma=0.2))
                F = np.eye(len(product))
                F[:CAMERA_SIZE, :CAMERA_SIZE] = applied[0]
                product = F @ product
            seen = frame.observation
            stereo_filter.seen.clear()
            stereo_filter.update(seen.select([i for i, name in enumerate(seen.ids.tolist()) if name in first]))
            if not k:
                start = gauge(stereo_filter.state)
                product = np.eye(len(start))
            rows += [dense(m, len(start)) @ product for m in stereo_filter.seen if len(m)]
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


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_still_camera_learns_nothing_about_its_own_pose(landmark: str) -> None:
    """It sees where things are relative to itself; the plain EKF takes the noise of that for a compass."""
    nothing = BodyVelocity(np.zeros(3), np.zeros(3), np.zeros((6, 6)))
    rng = np.random.default_rng(12)
    uvd = rng.uniform([200.0, 50.0, 10.0], [1100.0, 350.0, 40.0], (8, 3))
    frames = [uvd + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, 8) for _ in range(40)]
    sigma, kept = 0.2, {}
    for error in ("quaternion", "so3", "first-estimates", "right-invariant"):
        stereo_filter = make(landmark=landmark, error=error, motion=VelocityDriven())
        stereo_filter.reset(Start(covariance=sigma**2 * np.eye(12)))
        for k, seen in enumerate(frames):
            if k:
                stereo_filter.predict(DT, nothing)
            stereo_filter.update(StereoObservation(np.arange(8), seen))
        kept[error] = np.linalg.eigvalsh(stereo_filter.pose.covariance[3:, 3:])[0] / sigma**2
    assert kept["first-estimates"] == pytest.approx(1.0, abs=1e-7)
    assert kept["right-invariant"] == pytest.approx(1.0, abs=1e-7)
    assert kept["so3"] < 0.99
    assert kept["quaternion"] < 0.99
