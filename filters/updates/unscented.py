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

from filters.extras import require_core
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, Stage
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.state.linearised import LinearisedMeasurements
from filters.updates.model import Linearisation
from filters.validation import FloatArray, IntArray, positive

_NEGLIGIBLE = 1e-14
"""Eigenvalues below this share of the largest are directions without uncertainty."""


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

    def __post_init__(self) -> None:
        positive("alpha", self.alpha)
        positive("beta", self.beta, allow_zero=True)
        require_core("filterpy")

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
        # Half of the time that `import filters` would take, for those who never ask for this.
        from filterpy.kalman import MerweScaledSigmaPoints

        assert point is None, "sigma points are drawn around the state itself"
        map_rows = state.map_rows(index)
        pose_rows = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
        rows = np.concatenate([pose_rows, map_rows], axis=1)
        size = rows.shape[1]
        scaled = MerweScaledSigmaPoints(size, self.alpha, self.beta, 3.0 - size)
        values, vectors = np.linalg.eigh(symmetric.blocks(state.P, rows))
        values = np.where(values > _NEGLIGIBLE * values[:, -1:], values, 0.0)
        sigmas = np.sqrt(values)
        spread = np.sqrt(self.alpha**2 * 3.0)
        # The symmetric root: eigenvectors of equal eigenvalues turn with the last bit of P, and this does not.
        root = vectors * sigmas[:, None] @ vectors.transpose(0, 2, 1)
        offsets = spread * root
        errors = np.concatenate([np.zeros((len(index), 1, size)), offsets, -offsets], axis=1)

        z = _measured_at(sensor, camera, state, index, errors) @ stage.T.T
        mean = np.einsum("s,msk->mk", scaled.Wm, z)
        deviation = z - mean[:, None]
        scatter = np.einsum("s,msk,msl->mkl", scaled.Wc, deviation, deviation)
        # In the coordinates of the root, in which the variance is one, the regression is the cross-covariance.
        along = spread * scaled.Wc[1] * (deviation[:, 1 : size + 1] - deviation[:, size + 1 :])
        with np.errstate(divide="ignore"):
            unscale = np.where(sigmas > 0.0, 1.0 / sigmas, 0.0)
        H = along.transpose(0, 2, 1) @ (vectors * unscale[:, None] @ vectors.transpose(0, 2, 1))
        explained = H @ root
        nonlinearity = scatter - explained @ explained.transpose(0, 2, 1)
        R = stage.R + 0.5 * (nonlinearity + nonlinearity.transpose(0, 2, 1))
        return LinearisedMeasurements(stage.z - mean, H[:, :, :POSE_SIZE], H[:, :, POSE_SIZE:], map_rows, R)


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
    if state.model.in_camera:
        position, R_wc, flat = *state.viewpoint, 0.0 * flat
    position, R_wc = position + flat[:, POSITION], R_wc @ Rotation.from_rotvec(flat[:, ROTATION]).as_matrix()
    if state.model.in_anchor:
        place, R_wa, _ = state.anchor_poses(index[repeated])
        R_aw = (R_wa @ Rotation.from_rotvec(flat[:, POSE_SIZE + 3 : POSE_SIZE + 6]).as_matrix()).transpose(0, 2, 1)
        position = rotations.turned(R_aw, position - place - flat[:, POSE_SIZE : POSE_SIZE + 3])
        R_wc = R_aw @ R_wc
    seen = state.model.homogeneous(position, anchors, parameters)
    points_c = state.model.with_axes(R_wc.transpose(0, 2, 1), seen)
    return sensor.predict(camera, points_c, state.camera.variables).reshape(count, samples, -1)
