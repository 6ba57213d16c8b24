"""Statistical linearisation: sigma points instead of Jacobians.

Each landmark's measurement depends on its own few rows of the state (pose, anchor, parameters). Sigma points drawn
from their joint covariance are sent through Eq. 8-10, and a line is fitted: z = mean + H e + error, with the
covariance of that error added to R. With that H and R the ordinary update is the unscented one on the measured
sub-state (as Li and Aouf did for a stereo rig), for all landmarks at once, and it keeps its sparsity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.extras import require_core
from filters.contract.validation import positive
from filters.geometry import rotations, symmetric
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.measurements.measurement_model import MeasurementModel, Stage
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from filters.state.joint_state import JointState
from filters.state.layout import LinearisedMeasurements
from filters.updates.extended import Linearisation

NEGLIGIBLE = 1e-13
"""Share of a variance below which what is left of it, given the numbers before, is rounding."""


@dataclass(frozen=True)
class Unscented(Linearisation):
    """H and R fitted to sigma points.

    Parameters
    ----------
    alpha : float
        Spread of the sigma points.
    beta : float
        Weight of the covariance; 2 is the Gaussian choice (Merwe).
    """

    alpha: float = 0.5
    beta: float = 2.0
    by_jacobians: ClassVar[bool] = False
    kernels: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("alpha", self.alpha)
        positive("beta", self.beta, allow_zero=True)
        require_core("filterpy")

    def sigma_points(self, size: int) -> tuple[float, ...]:
        """Those of Merwe with kappa = 3 - size."""
        # Half of the time that `import filters` would take, for those who never ask for this.
        from filterpy.kalman import MerweScaledSigmaPoints

        scaled = MerweScaledSigmaPoints(size, self.alpha, self.beta, 3.0 - size)
        return float(np.sqrt(self.alpha**2 * 3.0)), float(scaled.Wm[0]), float(scaled.Wc[0]), float(scaled.Wm[1])

    def linearise(
        self,
        sensor: MeasurementModel,
        camera: StereoCamera,
        state: JointState,
        index: IntArray,
        stage: Stage,
        point: JointState | None = None,
    ) -> LinearisedMeasurements:
        """Innovations with H and R fitted to sigma points; `point` must be None."""
        assert point is None, "sigma points are drawn around the state itself"
        map_rows = state.map_rows(index)
        pose_rows = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
        rows = np.concatenate([pose_rows, map_rows], axis=1)
        size = rows.shape[1]
        spread, mean_0, covariance_0, weight = self.sigma_points(size)
        L = _root(symmetric.blocks(state.P, rows))
        offsets = spread * L.transpose(0, 2, 1)
        errors = np.concatenate([np.zeros((len(index), 1, size)), offsets, -offsets], axis=1)

        z = _measured_at(sensor, camera, state, index, errors) @ stage.T.T
        mean = mean_0 * z[:, 0] + weight * z[:, 1:].sum(axis=1)
        deviation = z - mean[:, None]
        weights = np.r_[covariance_0, np.full(2 * size, weight)]
        scatter = np.einsum("s,msk,msl->mkl", weights, deviation, deviation)
        # In the coordinates of the root, in which the variance is one, the regression is the cross-covariance.
        along = spread * weight * (deviation[:, 1 : size + 1] - deviation[:, size + 1 :])
        H = np.zeros((len(index), z.shape[2], size))
        for j in reversed(range(size)):
            left = along[:, j] - np.einsum("mki,mi->mk", H, L[:, :, j])
            H[:, :, j] = np.divide(left, L[:, j, None, j], out=np.zeros_like(left), where=L[:, j, None, j] > 0.0)
        R = stage.R + scatter - along.transpose(0, 2, 1) @ along
        return LinearisedMeasurements(stage.z - mean, H[:, :, :POSE_SIZE], H[:, :, POSE_SIZE:], map_rows, R)


def _root(C: FloatArray) -> FloatArray:
    """Cholesky factors (M, w, w); what is known from the numbers before has a zero column."""
    L = np.zeros_like(C)
    for j in range(C.shape[1]):
        left = C[:, j:, j] - np.einsum("mik,mk->mi", L[:, j:, :j], L[:, j, :j])
        certain = left[:, 0] <= NEGLIGIBLE * C[:, j, j]
        pivots = np.sqrt(np.where(certain, 1.0, left[:, 0]))
        L[:, j:, j] = np.where(certain[:, None], 0.0, left / pivots[:, None])
    return L


def _measured_at(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, index: IntArray, errors: FloatArray
) -> FloatArray:
    """Numbers of the sensor for each landmark at each of its sigma points; (M, S, w) -> (M, S, s)."""
    count, samples, size = errors.shape
    flat = errors.reshape(-1, size)
    repeated = np.repeat(np.arange(count), samples)
    parameters = state.model.retract(state.parameters(index)[repeated], flat[:, -state.size :])
    anchors = state.anchors(index)
    if anchors is not None:
        anchors = anchors[repeated] + flat[:, POSE_SIZE : POSE_SIZE + 3]
    position, R_wc = state.camera.position, state.camera.R_wc
    position, R_wc = position + flat[:, POSITION], R_wc @ Rotation.from_rotvec(flat[:, ROTATION]).as_matrix()
    if state.model.in_anchor:
        place, R_wa, _ = state.anchor_poses(index[repeated])
        R_aw = (R_wa @ Rotation.from_rotvec(flat[:, POSE_SIZE + 3 : POSE_SIZE + 6]).as_matrix()).transpose(0, 2, 1)
        position = rotations.turned(R_aw, position - place - flat[:, POSE_SIZE : POSE_SIZE + 3])
        R_wc = R_aw @ R_wc
    seen = state.model.homogeneous(position, anchors, parameters)
    points_c = state.model.with_axes(R_wc.transpose(0, 2, 1), seen)
    return sensor.predict(camera, points_c, state.camera.variables).reshape(count, samples, -1)
