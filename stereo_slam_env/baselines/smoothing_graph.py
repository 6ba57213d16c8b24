"""The factors of `batch` and `fixed-lag`: poses and landmarks, stereo and motion, with GTSAM.

GTSAM's error of a pose is (rotation, translation), both in the camera frame; ours is (position in W, rotation on the
right). `_tangent` is the change between the two and the only place that knows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from filters import BodyVelocity, CameraState, MotionModel, StereoCamera
from filters.contract.extras import install_command
from filters.engine.own_state import predict_camera
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION

if TYPE_CHECKING:
    from typing import Self

# How far a landmark may lie from where it starts, m: it decides nothing, and keeps a point whose depth is not told by
# its views from running away.
SPREAD = 1000.0
# A motion model may claim to know a velocity exactly (m/s, rad/s); a factor cannot.
SMALLEST_VELOCITY_SIGMA = 1e-6
SMALLEST_POSE_SIGMA = 1e-9
# Rows of (u_left, u_right, v) from (u, v, d), the order of GTSAM's stereo factor.
STEREO_ROWS = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def load_gtsam() -> ModuleType:
    """The gtsam module; a `ValueError` where it is not installed."""
    try:
        import gtsam
    except ImportError as error:
        raise ValueError(f"this smoother needs gtsam: {install_command('gtsam')}") from error
    module: ModuleType = gtsam
    return module


@dataclass(frozen=True, eq=False)
class Sightings:
    """Measurements of landmarks, flat."""

    pose: IntArray  # (M,): numbers of the poses they were taken from
    track: IntArray  # (M,): numbers of the tracks they belong to; a track is a landmark
    uvd: FloatArray  # (M, 3): measurements, px
    R: FloatArray  # (M, 3, 3): their covariances, px^2

    @classmethod
    def joined(cls, parts: Sequence[Sightings]) -> Sightings:
        """All of them, in order."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def select(self, index: BoolArray) -> Sightings:
        """Measurements at `index`."""
        return Sightings(self.pose[index], self.track[index], self.uvd[index], self.R[index])


@dataclass(frozen=True, eq=False)
class Smoothed:
    """All poses given all measurements: one for `reset` and one for each `predict`."""

    positions: FloatArray  # (K, 3): r^WC, m
    orientations: FloatArray  # (K, 4): q^WC, xyzw
    chi_square: float  # twice the final cost
    # Residuals minus unknowns: `chi_square` is about as large where model and noise are right. A larger one tells a
    # wrong noise, outliers, or a false minimum.
    degrees_of_freedom: int


class SmoothingGraph:
    """Factors and the best values so far of all poses and landmarks.

    Pose 0 is at `start` with covariance `P` (12, 12); how its pose and velocity correlate is not used. With `tail_dof`
    measurements count by Cauchy's loss of that width squared, in standard deviations, without by their square.
    """

    def __init__(self, camera: StereoCamera, start: CameraState, P: FloatArray, tail_dof: float | None = None) -> None:
        self._gtsam = load_gtsam()
        self._calibration = self._gtsam.Cal3_S2Stereo(camera.fx, camera.fy, 0.0, camera.cx, camera.cy, camera.baseline)
        self._tail_dof = tail_dof
        self._factors = self._gtsam.NonlinearFactorGraph()
        self._values = self._gtsam.Values()
        self._start = start
        self._start_velocity_covariance = P[POSE_SIZE:, POSE_SIZE:]
        self._time_steps: list[float] = []
        self._keys: dict[int, int] = {}  # of the landmarks, by track
        self._entered = 0
        self._rows = 0
        T = _tangent(start)
        inverse = np.linalg.inv(T)
        covariance = inverse @ P[:POSE_SIZE, :POSE_SIZE] @ inverse.T + SMALLEST_POSE_SIGMA**2 * np.eye(POSE_SIZE)
        pose = self._pose_of(start)
        self._values.insert(self._pose_key(0), pose)
        model = self._gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._measure(self._gtsam.PriorFactorPose3(self._pose_key(0), pose, model), POSE_SIZE)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """GTSAM's own copies; factors are immutable and shared."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin._factors = self._factors.clone()
        twin._values = self._gtsam.Values(self._values)
        twin._time_steps = list(self._time_steps)
        twin._keys = dict(self._keys)
        return twin

    @property
    def last(self) -> int:
        """Number of the current pose."""
        return len(self._time_steps)

    def state(self) -> CameraState:
        """The current pose, with the velocity of the last move."""
        return self._state_at(self.last)

    def add_move(
        self,
        dt: float,
        odometry: BodyVelocity | None,
        models: Sequence[MotionModel],
        R: FloatArray,
        t: FloatArray,
    ) -> None:
        """A new pose, tied to the two before it by what the motion models say of its velocity.

        It starts at (R, t) in the camera before it. With v_k = (r_k - r_k-1) / dt and w_k = Log(R_k-1^T R_k) / dt,
        Eq. 6 is a statement about three poses: (v_k, w_k) = f(x_k-1, v_k-1, w_k-1) + noise. It is linear but for
        rotations of the size of a correction, so it is linearised once.
        """
        before = self.state()
        turn = rotations.log(R)
        after = CameraState(
            before.position + before.R_wc @ t,
            rotations.multiply(before.orientation, rotations.exp_quaternion(turn)),
            before.R_wc @ t / dt,
            turn / dt,
        )
        k = self.last + 1
        new = _velocity_jacobian(before, after, dt)
        for model in models:
            prediction = predict_camera(model, before, dt, odometry)
            F = prediction.F[POSE_SIZE:]
            covariance = (prediction.G @ prediction.Q @ prediction.G.T)[POSE_SIZE:, POSE_SIZE:]
            blocks = [(k, new[:, 6:], after)]
            if k > 1:
                earlier = self._state_at(k - 2)
                old = _velocity_jacobian(earlier, before, self._time_steps[-1])
                blocks.append((k - 1, new[:, :6] - F[:, :6] - F[:, 6:] @ old[:, 6:], before))
                blocks.append((k - 2, -F[:, 6:] @ old[:, :6], earlier))
            else:
                blocks.append((0, new[:, :6] - F[:, :6], before))
                covariance = covariance + F[:, 6:] @ self._start_velocity_covariance @ F[:, 6:].T
            covariance = covariance + SMALLEST_VELOCITY_SIGMA**2 * np.eye(6)
            self._add_linear(blocks, _velocity(after) - _velocity(prediction.state), covariance)
        self._values.insert(self._pose_key(k), self._pose_of(after))
        self._time_steps.append(dt)

    def add_sightings(self, seen: Sightings, located: Mapping[int, tuple[int, FloatArray]]) -> Sightings:
        """Add the measurements of landmarks that are in the graph, or can enter it; returns those that have to wait.

        `located` says of tracks whose depth is known the number of a pose, and where it sees them, (3,) m. The
        landmarks of the others have no depth yet, or would lie behind a camera that saw them.
        """
        needed = {*seen.pose.tolist(), *(pose for pose, _ in located.values())}
        cameras = np.zeros((self.last + 1, 4, 4))
        for k in needed:
            cameras[k] = self._values.atPose3(self._pose_key(k)).matrix()
        waits = np.zeros(len(seen.track), dtype=bool)
        order = np.argsort(seen.track, kind="stable")
        values, first = np.unique(seen.track[order], return_index=True)
        for i, rows in zip(values.tolist(), np.split(order, first)[1:], strict=True):
            if i not in self._keys:
                if i not in located:
                    waits[rows] = True
                    continue
                where, p_c = located[i]
                point = cameras[where, :3, :3] @ p_c + cameras[where, :3, 3]
                views = cameras[seen.pose[rows]]
                if (np.einsum("mi,mi->m", point - views[:, :3, 3], views[:, :3, 2]) <= 0.0).any():
                    waits[rows] = True
                    continue
                self._add_landmark(i, point)
            for row in rows.tolist():
                self._add_sighting(self._keys[i], int(seen.pose[row]), seen.uvd[row], seen.R[row])
        return seen.select(waits)

    def solve(self) -> None:
        """Levenberg-Marquardt on everything, from the best values so far."""
        self._values = self._gtsam.LevenbergMarquardtOptimizer(self._factors, self._values).optimize()

    def smoothed(self) -> Smoothed:
        """Values of the last solution."""
        trajectory = [_split(self._values.atPose3(self._pose_key(k))) for k in range(self.last + 1)]
        positions, orientations = (np.array(part) for part in zip(*trajectory, strict=True))
        dof = self._rows - 6 * len(trajectory) - 3 * len(self._keys)
        return Smoothed(positions, orientations, 2.0 * float(self._factors.error(self._values)), dof)

    def last_move_jacobian(self) -> FloatArray:
        """Derivative (12, 12) of our error of the current state by GTSAM's of the two last poses."""
        before, after = self._state_at(self.last - 1), self.state()
        J = np.vstack([np.eye(6, 12, 6), _velocity_jacobian(before, after, self._time_steps[-1])])
        by_poses: FloatArray = J @ block_diag(_tangent(before), _tangent(after))
        return by_poses

    def _state_at(self, k: int) -> CameraState:
        """Pose `k` with the velocity of the move to it; that of the start has the one it was given."""
        if k == 0:
            start = self._start
            position, orientation = _split(self._values.atPose3(self._pose_key(0)))
            return CameraState(position, orientation, start.linear_velocity, start.angular_velocity)
        before, pose = (self._values.atPose3(self._pose_key(n)) for n in (k - 1, k))
        dt = self._time_steps[k - 1]
        turn = rotations.log(before.rotation().matrix().T @ pose.rotation().matrix())
        position, orientation = _split(pose)
        return CameraState(position, orientation, (position - before.translation()) / dt, turn / dt)

    def _add_landmark(self, i: int, point: FloatArray) -> None:
        key = self._keys[i] = int(self._gtsam.symbol("l", self._entered))
        self._entered += 1
        self._values.insert(key, point)
        near = self._gtsam.noiseModel.Isotropic.Sigma(3, SPREAD)
        self._factors.add(self._gtsam.PriorFactorPoint3(key, point, near))

    def _add_sighting(self, key: int, pose: int, uvd: FloatArray, R: FloatArray) -> None:
        u_left, u_right, v = (STEREO_ROWS @ uvd).tolist()
        model = self._gtsam.noiseModel.Gaussian.Covariance(STEREO_ROWS @ R @ STEREO_ROWS.T)
        if self._tail_dof is not None:
            loss = self._gtsam.noiseModel.mEstimator.Cauchy.Create(self._tail_dof**0.5)
            model = self._gtsam.noiseModel.Robust.Create(loss, model)
        point = self._gtsam.StereoPoint2(u_left, u_right, v)
        factor = self._gtsam.GenericStereoFactor3D(point, model, self._pose_key(pose), key, self._calibration)
        self._measure(factor, 3)

    def _measure(self, factor: Any, rows: int) -> None:
        """Add a factor that is a fact, and not only a help for the solver."""
        self._factors.add(factor)
        self._rows += rows

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
