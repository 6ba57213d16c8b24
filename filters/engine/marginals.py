"""Marginals of the joint state: landmark positions, and their covariance with the pose."""

from __future__ import annotations

import numpy as np

from filters.motions.model import POSE_SIZE
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.validation import FloatArray, IntArray


def joint_covariance(state: JointState, index: IntArray) -> FloatArray:
    """J P J^T of the pose error and the positions (W) of the landmarks at `index`; (6 + 3 M, 6 + 3 M).

    J is the identity on the pose; on each landmark it is the Jacobian of its position by its own rows, to which the
    products are confined. Rows of landmarks without a finite position are not finite.
    """
    by_map = state.model.points(state.anchors(index), state.parameters(index)).by_map
    rows = state.map_rows(index)
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
    by_map = state.model.points(state.anchors(index), state.parameters(index)).by_map
    rows = state.map_rows(index)
    pose = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
    P = symmetric.blocks(state.P, np.concatenate([pose, rows], axis=1))
    J = np.zeros((len(index), POSE_SIZE + 3, POSE_SIZE + rows.shape[1]))
    J[:, :POSE_SIZE, :POSE_SIZE] = np.eye(POSE_SIZE)
    J[:, POSE_SIZE:, POSE_SIZE:] = by_map
    with np.errstate(invalid="ignore", over="ignore"):
        parts: FloatArray = J @ P @ J.transpose(0, 2, 1)
    return parts
