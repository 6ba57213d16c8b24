"""What the joint state says of landmark positions and of the pose together."""

from __future__ import annotations

import numpy as np

from filters.engine import symmetric
from filters.engine.joint_state import JointState
from filters.motion import POSE_SIZE
from filters.validation import FloatArray, IntArray

_POSE = np.arange(POSE_SIZE)


def joint_covariance(state: JointState, index: IntArray) -> FloatArray:
    """J P J^T of the pose error and the positions (W) of the landmarks at `index`; (6 + 3 M, 6 + 3 M).

    J is the identity on the pose; on each landmark it is the Jacobian of its position by its own rows, to which the
    products are confined. Rows of landmarks without a finite position are not finite.
    """
    by_map = state.model.points(state.anchors(index), state.parameters(index)).by_map
    rows = state.map_rows(index)
    needed, place = np.unique(rows, return_inverse=True)
    P = symmetric.full(symmetric.keep(state.P, np.concatenate([_POSE, needed])))
    place = POSE_SIZE + place.reshape(rows.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        half = np.vstack([P[:POSE_SIZE], (by_map @ P[place]).reshape(-1, len(P))])
        by_landmark = half[:, place].transpose(1, 0, 2) @ by_map.transpose(0, 2, 1)
    joint = np.hstack([half[:, :POSE_SIZE], by_landmark.transpose(1, 0, 2).reshape(len(half), -1)])
    return symmetric.full(joint)
