"""Textbook EKF-SLAM on filterpy's `ExtendedKalmanFilter`: dense matrices, six inverse-depth numbers a landmark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from filters import (
    BodyVelocity,
    CameraState,
    Forecast,
    InverseDepth,
    LandmarkBelief,
    MotionModel,
    RangeBearing,
    StereoCamera,
    StereoNoise,
    StereoObservation,
    UpdateReport,
)
from filters.contract.noise import gate_limit
from filters.contract.validation import gate_probability, unique_ids
from filters.engine.own_state import predict_camera
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.motion_model import (
    ANGULAR,
    CAMERA_SIZE,
    LINEAR,
    POSE_SIZE,
    POSITION,
    ROTATION,
)
from filters.parts import Named
from stereo_slam_env.baselines.camera_alone import CameraBelief, CameraFilter, symmetrised

_LANDMARK = 6
_MODEL = InverseDepth()


class FilterpyEKF(CameraFilter):
    """EKF-SLAM as in a textbook, on filterpy's `ExtendedKalmanFilter`: inverse depth, dense matrices, slow.

    The estimates are those of `inverse-depth`; the cost of a frame grows with the cube of the number of landmarks.
    filterpy's `x` is the error of the state: 12 numbers of the camera, then (anchor, theta, phi, rho) of each landmark.
    It is zero before each update and is moved into the state after it. A landmark that is not seen leaves the map.

    Parameters
    ----------
    camera, noise, motion
        See `CameraFilter`; odometry is used as the motion model says.
    gate : float or None
        Probability with which a consistent measurement of a landmark passes the chi-square gate; None: no gate.

    Raises
    ------
    ValueError
        An option has an impossible value.

    References
    ----------
    R. Labbe, "Kalman and Bayesian Filters in Python", chapter 11, and filterpy, https://github.com/rlabbe/filterpy.
    J. Civera, A. J. Davison, J. M. M. Montiel, "Inverse Depth Parametrization for Monocular SLAM", T-RO 24(5), 2008.
    """

    open_options = frozenset({"motion", "gate"})

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        motion: Named | MotionModel | None = None,
        gate: float | None = 0.99,
    ) -> None:
        probability = gate_probability(gate)
        self._limit = np.inf if probability is None else gate_limit(probability, 3)
        super().__init__(camera, noise, motion=motion)

    def _restart(self) -> None:
        self._ids: IntArray = np.zeros(0, dtype=np.int64)  # ascending
        self._map, self._P = np.zeros((0, _LANDMARK)), self._belief.P

    def _move(self, dt: float, odometry: BodyVelocity | None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        step, rest = predict_camera(self._motion, self._belief.state, dt, odometry), self._map.size
        measured = None if odometry is None else self._motion.odometry_measurement(step.state, dt, odometry)
        ekf = self._kalman_filter()
        ekf.F = block_diag(step.F, np.eye(rest))
        ekf.Q = block_diag(step.G @ step.Q @ step.G.T, np.zeros((rest, rest)))
        ekf.predict()
        self._move_to(step.state, ekf.P)
        if measured is not None:
            self._correct(measured.innovation, np.pad(measured.H, ((0, 0), (0, rest))), measured.R)

    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Correct with known landmarks (Eq. 13-18), drop those not seen, add the new ones (Eq. 19-25)."""
        observation = RangeBearing().completed(observation, self.camera)
        ids, R = observation.ids, observation.covariances(self.noise)
        in_map = np.isin(ids, self._ids)
        uvd, H, forward = self._linearised(np.searchsorted(self._ids, ids[in_map]))
        innovations = observation.uvd[in_map] - uvd
        S = H @ self._P @ H.transpose(0, 2, 1) + R[in_map]
        squared = np.einsum("mk,mk->m", innovations, np.linalg.solve(S, innovations[:, :, None])[:, :, 0])
        used, nis = forward & (np.isinf(self._limit) | (squared <= self._limit)), 0.0
        if used.any():
            nis = self._correct(innovations[used].ravel(), np.concatenate(H[used]), block_diag(*R[in_map][used]))
        dropped = self._ids[~np.isin(self._ids, ids)]
        self.forget(dropped)
        h_w = self.camera.ray(observation.uvd) @ self._belief.state.R_wc.T
        new = ~in_map & _MODEL.can_start_from(tuple(h_w.T))
        if new.any():
            self._add(ids[new], observation.uvd[new], R[new])
        return UpdateReport(
            updated=ids[in_map][used],
            initialised=ids[new],
            dropped=dropped,
            gated=ids[in_map][forward & ~used],
            rejected=ids[~in_map & ~new],
            behind_camera=ids[in_map][~forward],
            nis=nis,
            nis_dof=3 * int(used.sum()),
        )

    def _kalman_filter(self, rows: int = 1) -> ExtendedKalmanFilter:
        """filterpy's filter of the error, at zero; a new one each time, because the map grows and shrinks."""
        ekf = ExtendedKalmanFilter(dim_x=len(self._P), dim_z=rows)
        ekf.x, ekf.P = np.zeros(len(self._P)), self._P
        return ekf

    def _correct(self, innovation: FloatArray, H: FloatArray, R: FloatArray) -> float:
        """Estimate the error (Eq. 15-18) and move it into the state; the NIS of the innovation."""
        ekf = self._kalman_filter(len(innovation))
        ekf.update(innovation, lambda error: H, lambda error: np.zeros(len(innovation)), R)
        state, delta, half_turn = self._belief.state, ekf.x, 0.5 * ekf.x[ROTATION]
        moved = CameraState(
            state.position + delta[POSITION],
            rotations.multiply(state.orientation, np.append(half_turn, 1.0)),
            state.linear_velocity + delta[LINEAR],
            state.angular_velocity + delta[ANGULAR],
        )
        self._map = self._map + delta[CAMERA_SIZE:].reshape(-1, _LANDMARK)
        by_error = np.eye(len(delta))  # of the error at the moved state by that at the old one
        by_error[ROTATION, ROTATION] = (np.eye(3) - rotations.skew(half_turn)) / (1.0 + half_turn @ half_turn)
        self._move_to(moved, by_error @ ekf.P @ by_error.T)
        return float(ekf.y @ ekf.SI @ ekf.y)

    def _move_to(self, state: CameraState, P: FloatArray) -> None:
        self._P = symmetrised(P)
        self._belief = CameraBelief(state, self._P[:CAMERA_SIZE, :CAMERA_SIZE])

    def _linearised(self, index: IntArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Predicted (u, v, d) (M, 3), H (M, 3, 12 + 6 N), and whether the rays point forward (Eq. 8-10, 13)."""
        R_wc = self._belief.state.R_wc
        homogeneous = _MODEL.relative_to(self._belief.state.position, self._map[index, :3], self._map[index, 3:])
        h_c, scale = homogeneous.homogeneous[:, :3] @ R_wc, homogeneous.homogeneous[:, 3]
        by_camera = self.camera.project_scaled_jacobian(h_c, scale)
        by_world = np.concatenate([by_camera[:, :, :3] @ R_wc.T, by_camera[:, :, 3:]], axis=2)
        H = self._placed(by_world @ homogeneous.by_map, index)
        H[:, :, POSITION] = by_world @ homogeneous.by_position
        H[:, :, ROTATION] = by_camera[:, :, :3] @ rotations.skew(h_c)
        return self.camera.project_scaled(h_c, scale), H, h_c[:, 2] > 0

    def _placed(self, by_landmark: FloatArray, index: IntArray) -> FloatArray:
        """Jacobians (M, k, 6), each by its own landmark, as Jacobians (M, k, 12 + 6 N) by all errors."""
        placed = np.zeros((*by_landmark.shape[:2], len(self._P)))
        np.put_along_axis(placed, _rows(index)[:, None, :], by_landmark, axis=2)
        return placed

    def _add(self, ids: IntArray, uvd: FloatArray, R: FloatArray) -> None:
        """Enter new landmarks with their correlations to all others (Eq. 25)."""
        position = self._belief.state.position
        h_c, R_wc = self.camera.ray(uvd), self._belief.state.R_wc
        new = _MODEL.started(position, h_c @ R_wc.T, uvd[:, 2] / self.camera.disparity_constant)
        by_ray, by_scale = new.by_seen[:, :, :3] @ R_wc, new.by_seen[:, :, 3:] / self.camera.disparity_constant
        by_uvd = np.concatenate([by_ray[:, :, :2] / (self.camera.fx, self.camera.fy), by_scale], axis=2)
        J = np.zeros((len(ids), _LANDMARK, len(self._P)))
        J[:, :3, POSITION], J[:, 3:, ROTATION] = np.eye(3), -by_ray @ rotations.skew(h_c)  # the anchor is the camera
        J, by_uvd = np.concatenate(J), np.pad(by_uvd, ((0, 0), (3, 0), (0, 0)))
        start_covariance = J @ self._P @ J.T + block_diag(*(by_uvd @ R @ by_uvd.transpose(0, 2, 1)))
        self._P = np.block([[self._P, self._P @ J.T], [J @ self._P, symmetrised(start_covariance)]])
        self._map = np.concatenate([self._map, np.insert(new.parameters, [0, 0, 0], position, axis=1)])
        self._ids = np.concatenate([self._ids, ids])
        self._keep(np.argsort(self._ids))

    def _keep(self, index: IntArray) -> None:
        """Only the landmarks at `index`, in that order."""
        rows = np.concatenate([np.arange(CAMERA_SIZE), _rows(index).ravel()])
        self._ids, self._map, self._P = self._ids[index], self._map[index], self._P[np.ix_(rows, rows)]

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        self._keep(np.flatnonzero(~np.isin(self._ids, unique_ids("ids", np.asarray(ids)))))

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks at the current pose."""
        wanted_ids, index = self._wanted(ids)
        uvd, H, forward = self._linearised(index)
        S = H @ self._P @ H.transpose(0, 2, 1) + self.noise.R
        return Forecast(wanted_ids, uvd, symmetrised(S), forward & self.camera.in_view(uvd))

    @property
    def landmarks(self) -> LandmarkBelief:
        """The map, in ascending order of ids."""
        positions = _MODEL.points(self._map[:, :3], self._map[:, 3:]).positions
        joint, rows = self.joint_covariance(), POSE_SIZE + np.arange(positions.size).reshape(-1, 3)
        covariances, variances = (
            joint[rows[:, :, None], rows[:, None, :]],
            np.diag(self._P)[CAMERA_SIZE + 5 :: _LANDMARK],
        )
        return LandmarkBelief(self._ids.copy(), positions, covariances, self._map[:, 5].copy(), variances.copy())

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error and landmark positions, correlations included; see `StereoFilter`."""
        _, index = self._wanted(ids)
        by_map = _MODEL.points(self._map[index, :3], self._map[index, 3:]).by_map
        J = np.concatenate([np.eye(POSE_SIZE, len(self._P)), *self._placed(by_map, index)])
        with np.errstate(invalid="ignore", over="ignore"):
            return symmetrised(J @ self._P @ J.T)

    def _wanted(self, ids: Sequence[int] | IntArray | None) -> tuple[IntArray, IntArray]:
        """The landmarks asked for (None: all), and where they are; refuses those that are not there."""
        wanted_ids = self._ids if ids is None else unique_ids("ids", np.asarray(ids))
        if len(missing := np.setdiff1d(wanted_ids, self._ids)):
            raise ValueError(f"ids must be in the map, not there: {missing[:5].tolist()}: see landmarks.ids")
        return wanted_ids.copy(), np.searchsorted(self._ids, wanted_ids)


def _rows(index: IntArray) -> IntArray:
    """Rows of P of the landmarks at `index`; (M,) -> (M, 6)."""
    return np.asarray(CAMERA_SIZE + _LANDMARK * index[:, None] + np.arange(_LANDMARK))
