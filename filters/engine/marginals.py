"""Marginals of the joint state: landmarks, and their covariance with the pose."""

from __future__ import annotations

import numpy as np

from filters.contract.outputs import LandmarkBelief
from filters.geometry import symmetric
from filters.geometry.arrays import FloatArray, IntArray
from filters.landmarks.landmark_model import Points
from filters.motions.motion_model import POSE_SIZE
from filters.state.joint_state import JointState


def landmark_belief(state: JointState) -> LandmarkBelief:
    """The map, in ascending order of ids."""
    index, model = np.argsort(state.ids), state.model
    points, rows = _points(state, index)
    P_map = symmetric.blocks(state.P, rows)
    with np.errstate(invalid="ignore", over="ignore"):
        covariances = _mirrored(points.by_map @ P_map @ points.by_map.transpose(0, 2, 1))
    inverse = model.inverse_distances(state.camera.position, state.anchors(index), state.parameters(index))
    own_rows = state.own_rows(index)
    position_rows = np.broadcast_to(np.arange(3), (len(index), 3))
    P_own = symmetric.blocks(state.P, np.concatenate([position_rows, own_rows], axis=1))
    J = np.concatenate([inverse.by_position, inverse.by_parameters], axis=1)
    variance = np.einsum("mi,mij,mj->m", J, P_own, J)
    return LandmarkBelief(state.ids[index], points.positions, covariances, inverse.values, variance)


def _points(state: JointState, index: IntArray) -> tuple[Points, IntArray]:
    """Positions in W of the landmarks at `index`, and the rows (M, w) of P that their Jacobian is by."""
    return state.model.points(state.anchors(index), state.parameters(index)), state.map_rows(index)


def joint_covariance(state: JointState, index: IntArray) -> FloatArray:
    """J P J^T of the pose error and the positions (W) of the landmarks at `index`; (6 + 3 M, 6 + 3 M).

    J is the identity on the pose; on each landmark it is the Jacobian of its position by its own rows, to which the
    products are confined. Rows of landmarks without a finite position are not finite.
    """
    points, rows = _points(state, index)
    by_map = points.by_map
    needed = np.zeros(len(state.P), dtype=bool)
    needed[:POSE_SIZE] = needed[rows] = True
    place = (np.cumsum(needed) - 1)[rows]
    P = symmetric.full(symmetric.keep(state.P, np.flatnonzero(needed)))
    count = len(index)
    half, joint = np.empty((POSE_SIZE + 3 * count, len(P))), np.empty((POSE_SIZE + 3 * count,) * 2)
    half[:POSE_SIZE] = P[:POSE_SIZE]
    with np.errstate(invalid="ignore", over="ignore"):
        half[POSE_SIZE:] = (by_map @ P[place]).reshape(-1, len(P))
        joint[:POSE_SIZE] = half[:, :POSE_SIZE].T
        joint[POSE_SIZE:] = (by_map @ half.T[place]).reshape(-1, len(half))
    return symmetric.full(joint)


def pose_landmark_covariances(state: JointState, index: IntArray) -> FloatArray:
    """The parts of `joint_covariance` that belong to the pose and to one landmark each; (M, 9, 9)."""
    points, rows = _points(state, index)
    pose = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
    P = symmetric.blocks(state.P, np.concatenate([pose, rows], axis=1))
    J = np.zeros((len(index), POSE_SIZE + 3, POSE_SIZE + rows.shape[1]))
    J[:, :POSE_SIZE, :POSE_SIZE] = np.eye(POSE_SIZE)
    J[:, POSE_SIZE:, POSE_SIZE:] = points.by_map
    with np.errstate(invalid="ignore", over="ignore"):
        return _mirrored(J @ P @ J.transpose(0, 2, 1))


def _mirrored(products: FloatArray) -> FloatArray:
    """Products J P J^T (M, n, n), symmetric to the last bit: where they are large, rounding alone is not."""
    return 0.5 * (products + products.transpose(0, 2, 1))
