"""Statistical linearisation: sigma points instead of Jacobians.

Each landmark's measurement depends on its own few rows of the state (pose, anchor, parameters). Sigma points drawn
from their joint covariance are sent through Eq. 8-10, and a line is fitted: z = mean + H e + error, with the
covariance of that error added to R. With that H and R the ordinary update is the unscented one on the measured
sub-state (as Li and Aouf did for a stereo rig), for all landmarks at once, and it keeps its sparsity.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters.camera import StereoCamera
from filters.engine import symmetric
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.measurements.model import Stage
from filters.motion import POSE_SIZE, POSITION, ROTATION
from filters.validation import FloatArray, IntArray

ALPHA, BETA = 0.5, 2.0
"""Spread of the sigma points, and the Gaussian choice for their covariance weight (Merwe)."""
_NEGLIGIBLE = 1e-14
"""Eigenvalues below this share of the largest are directions without uncertainty."""


def linearise(
    camera: StereoCamera, state: JointState, index: IntArray, stage: Stage, point: JointState | None = None
) -> LinearisedMeasurements:
    """Innovations of a stage with H and R fitted to sigma points; arguments as of `linearisation.linearise`.

    Raises
    ------
    ValueError
        `point` is given: there is no Jacobian that could be taken elsewhere.
    """
    # Half of the time that `import filters` would take, for those who never ask for this.
    from filterpy.kalman import MerweScaledSigmaPoints

    if point is not None:
        raise ValueError("point must be None: sigma points are drawn around the state itself")
    map_rows = state.map_rows(index)
    pose_rows = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
    rows = np.concatenate([pose_rows, map_rows], axis=1)
    size = rows.shape[1]
    scaled = MerweScaledSigmaPoints(size, ALPHA, BETA, 3.0 - size)
    values, vectors = np.linalg.eigh(symmetric.blocks(state.P, rows))
    values = np.where(values > _NEGLIGIBLE * values[:, -1:], values, 0.0)
    sigmas = np.sqrt(values)
    spread = np.sqrt(ALPHA**2 * 3.0)
    offsets = spread * (vectors * sigmas[:, None]).transpose(0, 2, 1)
    errors = np.concatenate([np.zeros((len(index), 1, size)), offsets, -offsets], axis=1)

    z = _measured_at(camera, state, index, errors) @ stage.T.T
    mean = np.einsum("s,msk->mk", scaled.Wm, z)
    deviation = z - mean[:, None]
    scatter = np.einsum("s,msk,msl->mkl", scaled.Wc, deviation, deviation)
    # In the coordinates of the eigenvectors, scaled to unit variance, the regression is the cross-covariance.
    along = spread * scaled.Wc[1] * (deviation[:, 1 : size + 1] - deviation[:, size + 1 :])
    with np.errstate(divide="ignore"):
        unscale = np.where(sigmas > 0.0, 1.0 / sigmas, 0.0)
    H = along.transpose(0, 2, 1) * unscale[:, None] @ vectors.transpose(0, 2, 1)
    nonlinearity = scatter - np.einsum("msk,msl->mkl", along, along)
    R = stage.R + 0.5 * (nonlinearity + nonlinearity.transpose(0, 2, 1))
    return LinearisedMeasurements(stage.z - mean, H[:, :, :POSE_SIZE], H[:, :, POSE_SIZE:], map_rows, R)


def _measured_at(camera: StereoCamera, state: JointState, index: IntArray, errors: FloatArray) -> FloatArray:
    """(u, v, d) of each landmark at each of its sigma points; (M, S, w) -> (M, S, 3)."""
    count, samples, size = errors.shape
    flat = errors.reshape(-1, size)
    repeated = np.repeat(np.arange(count), samples)
    parameters = state.parameters(index)[repeated] + flat[:, -3:]
    anchors = state.anchors(index)
    if anchors is not None:
        anchors = anchors[repeated] + flat[:, POSE_SIZE : POSE_SIZE + 3]
    position = state.camera.position + flat[:, POSITION]
    seen = state.model.homogeneous(position, anchors, parameters)
    R_wc = state.camera.R_wc @ Rotation.from_rotvec(flat[:, ROTATION]).as_matrix()
    h_c = np.einsum("nij,ni->nj", R_wc, seen[:, :3])
    return camera.project_scaled(h_c, seen[:, 3]).reshape(count, samples, 3)
