"""The factors of `batch`: full smoothing of all poses and landmarks with GTSAM, incrementally (iSAM2) and as a whole.

GTSAM's error of a pose is (rotation, translation), both in the camera frame; ours is (position in W, rotation on the
right). `_tangent` is the change between the two and the only place that knows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from filters import rotations
from filters.camera import StereoCamera
from filters.motion import POSE_SIZE, POSITION, ROTATION, CameraState, MotionPrediction
from filters.validation import FloatArray, IntArray

# How far a landmark may lie from where it starts: as a multiple of its first distance in iSAM2, m in the final solve.
# It decides nothing, and keeps a point whose depth is not told by its views from running away.
INCREMENTAL_SPREAD = 10.0
FINAL_SPREAD = 1000.0
# A motion model may claim to know a velocity exactly (m/s, rad/s); a factor cannot.
SMALLEST_VELOCITY_SIGMA = 1e-6
SMALLEST_POSE_SIGMA = 1e-9
# iSAM2 relinearises poses (rad, m) and landmarks (m) that moved by more than this, every so many updates. Ten times
# coarser, its last pose is twice as far off; this fine, it is that of the final solve.
RELINEARISE_POSE, RELINEARISE_LANDMARK, RELINEARISE_EVERY = 0.001, 0.1, 10
# Rows of (u_left, u_right, v) from (u, v, d), the order of GTSAM's stereo factor.
STEREO_ROWS = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def load_gtsam() -> ModuleType:
    """The gtsam module.

    Raises
    ------
    ValueError
        It is not installed.
    """
    try:
        import gtsam
    except ImportError as error:
        raise ValueError('the batch smoother needs gtsam: pip install "stereo-slam-env[gtsam]"') from error
    module: ModuleType = gtsam
    return module


@dataclass(frozen=True, eq=False)
class Move:
    """One prediction: from `before` by `predictions`, the last of which says where to start (`after`)."""

    before: CameraState
    dt: float
    predictions: tuple[MotionPrediction, ...]

    @property
    def after(self) -> CameraState:
        """Predicted state."""
        return self.predictions[-1].state


@dataclass(frozen=True, eq=False)
class Smoothed:
    """All poses given all measurements: one for `reset` and one for each `predict`.

    Attributes
    ----------
    positions : (K, 3)
        r^WC, m.
    orientations : (K, 4)
        q^WC, xyzw.
    chi_square : float
        Twice the final cost.
    degrees_of_freedom : int
        Residuals minus unknowns: `chi_square` is about as large where model and noise are right. A larger one tells a
        wrong noise, outliers, or a false minimum.
    """

    positions: FloatArray
    orientations: FloatArray
    chi_square: float
    degrees_of_freedom: int


class SmoothingGraph:
    """Factors, iSAM2's estimate of all variables, and their numbers of rows."""

    def __init__(self, camera: StereoCamera, start: CameraState, P: FloatArray) -> None:
        self._gtsam = load_gtsam()
        self._camera = camera
        self._calibration = self._gtsam.Cal3_S2Stereo(camera.fx, camera.fy, 0.0, camera.cx, camera.cy, camera.baseline)
        self._isam = self._gtsam.ISAM2(self._parameters())
        self._factors = self._gtsam.NonlinearFactorGraph()
        self._values = self._gtsam.Values()
        self._moves: list[Move] = []
        self._start_velocity_covariance = P[POSE_SIZE:, POSE_SIZE:]
        self._measured = self._gtsam.NonlinearFactorGraph()
        self._rows = 0
        self._starts: dict[int, FloatArray] = {}
        self._views: list[tuple[int, int]] = []
        T = _tangent(start)
        inverse = np.linalg.inv(T)
        covariance = inverse @ P[:POSE_SIZE, :POSE_SIZE] @ inverse.T + SMALLEST_POSE_SIGMA**2 * np.eye(POSE_SIZE)
        pose = self._pose_of(start)
        self._values.insert(self._pose_key(0), pose)
        model = self._gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._measure(self._gtsam.PriorFactorPose3(self._pose_key(0), pose, model), POSE_SIZE)

    def __deepcopy__(self, memo: dict[int, Any]) -> SmoothingGraph:
        """GTSAM's own copies; factors are immutable and shared."""
        twin = object.__new__(SmoothingGraph)
        twin.__dict__.update(self.__dict__)
        twin._isam = self._gtsam.ISAM2(self._isam)
        twin._factors = self._factors.clone()
        twin._values = self._gtsam.Values(self._values)
        twin._moves = list(self._moves)
        twin._starts = dict(self._starts)
        twin._views = list(self._views)
        twin._measured = self._measured.clone()
        return twin

    @property
    def last(self) -> int:
        """Number of the current pose."""
        return len(self._moves)

    def add_move(self, move: Move) -> None:
        """A new pose, tied to the two before it by what the motion models say of its velocity.

        With v_k = (r_k - r_k-1) / dt and w_k = Log(R_k-1^T R_k) / dt, Eq. 6 is a statement about three poses:
        (v_k, w_k) = f(x_k-1, v_k-1, w_k-1) + noise. It is linear but for rotations of the size of a correction, so
        it is linearised once.
        """
        k = len(self._moves) + 1
        new = _velocity_jacobian(move.before, move.after, move.dt)
        for prediction in move.predictions:
            F = prediction.F[POSE_SIZE:]
            covariance = (prediction.G @ prediction.Q @ prediction.G.T)[POSE_SIZE:, POSE_SIZE:]
            before, earlier = new[:, :6] - F[:, :6], None
            if self._moves:
                previous = self._moves[-1]
                old = _velocity_jacobian(previous.before, move.before, previous.dt)
                before, earlier = before - F[:, 6:] @ old[:, 6:], -F[:, 6:] @ old[:, :6]
            else:
                covariance = covariance + F[:, 6:] @ self._start_velocity_covariance @ F[:, 6:].T
            covariance = covariance + SMALLEST_VELOCITY_SIGMA**2 * np.eye(6)
            residual = _velocity(move.after) - _velocity(prediction.state)
            blocks = [(k, new[:, 6:], move.after), (k - 1, before, move.before)]
            if earlier is not None:
                blocks.append((k - 2, earlier, self._moves[-1].before))
            self._add_linear(blocks, residual, covariance)
        self._values.insert(self._pose_key(k), self._pose_of(move.after))
        self._moves.append(move)

    def add_landmarks(self, points: FloatArray, distances: FloatArray) -> IntArray:
        """New landmarks that start at (M, 3) m in W, (M,) m from the camera; returns their keys."""
        first = len(self._starts)
        keys = [int(self._gtsam.symbol("l", first + i)) for i in range(len(points))]
        for key, point, distance in zip(keys, points, distances.tolist(), strict=True):
            self._values.insert(key, point)
            self._factors.add(self._near(key, point, INCREMENTAL_SPREAD * distance))
            self._starts[key] = point
        return np.array(keys, dtype=np.int64)

    def add_sightings(self, poses: IntArray, keys: IntArray, uvd: FloatArray, R: FloatArray) -> None:
        """Measurements (M, 3) px of landmarks from the poses of those numbers, with R (M, 3, 3) px^2."""
        measured = uvd @ STEREO_ROWS.T
        covariances = STEREO_ROWS @ R @ STEREO_ROWS.T
        for k, key, (u_left, u_right, v), S in zip(
            poses.tolist(), keys.tolist(), measured.tolist(), covariances, strict=True
        ):
            point, model = self._gtsam.StereoPoint2(u_left, u_right, v), self._gtsam.noiseModel.Gaussian.Covariance(S)
            pose = self._pose_key(k)
            self._measure(self._gtsam.GenericStereoFactor3D(point, model, pose, key, self._calibration), 3)
            self._views.append((pose, key))

    def solve(self) -> None:
        """Take in what was added since the last call."""
        self._isam.update(self._factors, self._values)
        self._factors, self._values = self._gtsam.NonlinearFactorGraph(), self._gtsam.Values()

    def state(self) -> CameraState:
        """The current pose, with the velocity of the last move."""
        pose = self._isam.calculateEstimatePose3(self._pose_key(self.last))
        position, orientation = _split(pose)
        if not self._moves:
            return CameraState(position, orientation, np.zeros(3), np.zeros(3))
        before, dt = self._isam.calculateEstimatePose3(self._pose_key(self.last - 1)), self._moves[-1].dt
        turn = rotations.log(before.rotation().matrix().T @ pose.rotation().matrix())
        return CameraState(position, orientation, (position - before.translation()) / dt, turn / dt)

    def points(self, keys: IntArray) -> FloatArray:
        """Estimated positions of landmarks, (M, 3) m in W."""
        found = [self._isam.calculateEstimatePoint3(key) for key in keys.tolist()]
        return np.array(found).reshape(-1, 3)

    def covariance(self, keys: IntArray) -> FloatArray:
        """Joint covariance (12 + 3 M) of the camera and of landmarks; without a move, of the pose alone (6 + 3 M)."""
        numbers = [self.last] if not self._moves else [self.last - 1, self.last]
        pose_keys = [self._pose_key(k) for k in numbers]
        joint = np.asarray(self._isam.jointMarginalCovariance([*pose_keys, *keys.tolist()]).fullMatrix())
        poses = [_split(self._isam.calculateEstimatePose3(key)) for key in pose_keys]
        states = [CameraState(r, q, np.zeros(3), np.zeros(3)) for r, q in poses]
        J = np.zeros((6 * len(states), 6 * len(states)))
        J[:6, -6:] = _tangent(states[-1])
        if self._moves:
            by_poses = _velocity_jacobian(states[0], states[1], self._moves[-1].dt)
            J[6:, :6], J[6:, 6:] = by_poses[:, :6] @ _tangent(states[0]), by_poses[:, 6:] @ _tangent(states[1])
        whole = np.eye(len(joint))
        whole[: len(J), : len(J)] = J
        covariance: FloatArray = whole @ joint @ whole.T
        return 0.5 * (covariance + covariance.T)

    def smooth(self) -> Smoothed:
        """Levenberg-Marquardt on everything, from iSAM2's poses and landmarks.

        A landmark that iSAM2 has thrown behind a camera that saw it would stay there, a false minimum: it starts again
        from where it was first put. The steps here are damped, so that none is thrown again.
        """
        factors, values = self._measured.clone(), self._isam.calculateBestEstimate()
        behind = {key for pose, key in self._views if values.atPose3(pose).transformTo(values.atPoint3(key))[2] <= 0.0}
        for key in sorted(behind):
            values.update(key, self._starts[key])
        for key in self._starts:
            factors.add(self._near(key, values.atPoint3(key), FINAL_SPREAD))
        values = self._gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
        trajectory = [_split(values.atPose3(self._pose_key(k))) for k in range(self.last + 1)]
        positions, orientations = (np.array(part) for part in zip(*trajectory, strict=True))
        dof = self._rows - 6 * len(trajectory) - 3 * len(self._starts)
        return Smoothed(positions, orientations, 2.0 * float(factors.error(values)), dof)

    def _measure(self, factor: Any, rows: int) -> None:
        """Add a factor that is a fact, and not only a help for iSAM2."""
        self._factors.add(factor)
        self._measured.add(factor)
        self._rows += rows

    def _near(self, key: int, point: FloatArray, spread: float) -> Any:
        return self._gtsam.PriorFactorPoint3(key, point, self._gtsam.noiseModel.Isotropic.Sigma(3, spread))

    def _parameters(self) -> Any:
        parameters = self._gtsam.ISAM2Params()
        parameters.relinearizeSkip = RELINEARISE_EVERY
        thresholds = self._gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.full(6, RELINEARISE_POSE)))
        thresholds.insert(("l", np.full(3, RELINEARISE_LANDMARK)))
        parameters.setRelinearizeThreshold(thresholds)
        return parameters

    def _pose_key(self, k: int) -> int:
        return int(self._gtsam.symbol("x", k))

    def _pose_of(self, state: CameraState) -> Any:
        return self._gtsam.Pose3(self._gtsam.Rot3(state.R_wc), state.position)

    def _add_linear(
        self, blocks: Sequence[tuple[int, FloatArray, CameraState]], residual: FloatArray, covariance: FloatArray
    ) -> None:
        """The factor residual + sum A_k e_k ~ N(0, covariance), e_k our error of pose k at a state."""
        L = np.linalg.cholesky(covariance)
        at = self._gtsam.Values()
        arguments: list[Any] = []
        for k, A, state in blocks:
            at.insert(self._pose_key(k), self._pose_of(state))
            arguments += [self._pose_key(k), solve_triangular(L, A @ _tangent(state), lower=True)]
        right = -solve_triangular(L, residual, lower=True)
        factor = self._gtsam.JacobianFactor(*arguments, right, self._gtsam.noiseModel.Unit.Create(len(residual)))
        self._measure(self._gtsam.LinearContainerFactor(factor, at), len(residual))


def _tangent(state: CameraState) -> FloatArray:
    """Our error of a pose from GTSAM's: e = T (rotation, translation in the camera frame)."""
    T = np.zeros((POSE_SIZE, POSE_SIZE))
    T[POSITION, 3:], T[ROTATION, :3] = state.R_wc, np.eye(3)
    return T


def _velocity(state: CameraState) -> FloatArray:
    return np.concatenate([state.linear_velocity, state.angular_velocity])


def _velocity_jacobian(before: CameraState, after: CameraState, dt: float) -> FloatArray:
    """Derivative (6, 12) of the velocities between two poses by the errors of both."""
    R = before.R_wc.T @ after.R_wc
    by_turn = np.linalg.inv(rotations.right_jacobian(rotations.log(R)))
    J = np.zeros((6, 12))
    J[:3, 0:3], J[:3, 6:9] = -np.eye(3), np.eye(3)
    J[3:, 3:6], J[3:, 9:12] = -by_turn @ R.T, by_turn
    return J / dt


def _split(pose: Any) -> tuple[FloatArray, FloatArray]:
    """Position and quaternion of a Pose3."""
    turn = rotations.exp_quaternion(rotations.log(pose.rotation().matrix()))
    return np.array(pose.translation(), dtype=np.float64), turn
