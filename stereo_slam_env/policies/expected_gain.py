"""Expected information gain of sequences of looks: pure maths, many sequences at once.

The information matrix (inverse covariance) of pose and map is carried along, in the errors delta r, phi (rotation in W)
and delta p of `Knowledge`, positions taken relative to the camera as it is now. In these,

- a known motion changes nothing;
- its noise, of covariance Q on the pose, takes L, the columns of the pose, to L A, with A = (I + Q L_pose)^-1, and the
  information of the map down by L_map A Q L_map^T;
- a look adds H^T R^-1 H of every landmark to its own block, and what follows from d e / d pose = [-I, [e]x] to the
  rest: a step costs 6 columns instead of the whole matrix.

Only at the end is the matrix put together, with the pose last, and one Cholesky factor of it has the answer to both
questions: all of its diagonal is the log-determinant of pose and map, the last six are that of the pose, whatever the
map is.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.policies.foresight import Knowledge

Gain = Literal["pose", "map"]
"""Covariance whose determinant counts: of the pose, or of the pose and the map together."""


def expected_gain(knowledge: Knowledge, looks: FloatArray, Q: FloatArray, gain: Gain) -> FloatArray:
    """0.5 log of prior over posterior determinant of the covariance after sequences of looks, (B,) nats.

    Prior is the covariance after the same motion without a look. Of pose and map together, one look gains the mutual
    information 0.5 logdet S - 0.5 logdet R of its measurements.

    `looks` (B, K, N, 3, 3) are H^T R^-1 H of each landmark in each of K looks of B sequences, see
    `SensorModel.information`; `Q` (K, 6, 6) is the noise that the motion before each look adds to the pose, see
    `motion_noise`. An `ArithmeticError` where the covariance is not positive definite.
    """
    seen = looks.any(axis=(0, 1, 3, 4))
    if not seen.any():
        return np.zeros(len(looks))
    if gain == "pose" and not seen.all():  # a landmark that is never seen says nothing of the pose
        knowledge, looks = knowledge.of_landmarks(np.flatnonzero(seen)), looks[:, :, seen]
    blind = np.zeros((1, *looks.shape[1:]))  # a sequence that looks at nothing: the prior
    logdets = _log_determinants(knowledge, np.concatenate([looks, blind]), Q, gain)
    gains: FloatArray = 0.5 * (logdets[:-1] - logdets[-1])
    return gains


def motion_noise(middles: FloatArray, sigma_position: float, sigma_rotation: float) -> FloatArray:
    """Noise that a step of dead reckoning adds to the pose, in errors that a known motion does not change; (..., 6, 6).

    These are delta r + [r]x phi and phi, with r the position: an error of the turn turns the camera about the middle of
    the step, as in `filters.VelocityDriven`, and so acts on the first by the lever that this is from the origin.
    `middles` (..., 3) are r half-way through the step, from the camera as it is now, m; the standard deviations are of
    each axis, m and rad.
    """
    G = np.zeros((*middles.shape[:-1], POSE_SIZE, POSE_SIZE))
    G[..., POSITION, POSITION] = sigma_position * np.eye(3)
    G[..., POSITION, ROTATION] = sigma_rotation * rotations.skew(middles)
    G[..., ROTATION, ROTATION] = sigma_rotation * np.eye(3)
    Q: FloatArray = G @ np.swapaxes(G, -1, -2)
    return Q


def _log_determinants(knowledge: Knowledge, looks: FloatArray, Q: FloatArray, gain: Gain) -> FloatArray:
    """Log-determinant of the information after each sequence, (B,)."""
    sequences, steps, count = looks.shape[:3]
    rows = 3 * count
    by_pose = knowledge.by_pose
    stacked = by_pose.reshape(rows, POSE_SIZE)
    scale = np.sqrt(np.diag(knowledge.covariance))
    prior = np.linalg.inv(knowledge.covariance / np.outer(scale, scale)) / np.outer(scale, scale)

    of_map, of_pose = prior[None, POSE_SIZE:, :POSE_SIZE], prior[None, :POSE_SIZE, :POSE_SIZE]
    before, lost = [], []
    for step in range(steps):
        A = np.linalg.inv(np.eye(POSE_SIZE) + Q[step] @ of_pose)
        before.append(of_map)
        lost.append(of_map @ (A @ Q[step]))
        of_map, of_pose = of_map @ A, of_pose @ A
        seen = (looks[:, step] @ by_pose).reshape(sequences, rows, POSE_SIZE)
        of_map, of_pose = of_map + seen, of_pose + stacked.T @ seen

    whole = np.empty((sequences, rows + POSE_SIZE, rows + POSE_SIZE))
    of_landmarks = whole[:, :rows, :rows]
    of_landmarks[...] = prior[POSE_SIZE:, POSE_SIZE:] - lost[0] @ before[0].transpose(0, 2, 1)  # the same for all
    if steps > 1:
        of_landmarks -= np.concatenate(lost[1:], axis=2) @ np.concatenate(before[1:], axis=2).transpose(0, 2, 1)
    block = 3 * np.arange(count)[:, None] + np.arange(3)
    whole[:, block[:, :, None], block[:, None, :]] += looks.sum(axis=1)
    whole[:, rows:, :rows], whole[:, :rows, rows:] = of_map.transpose(0, 2, 1), of_map
    whole[:, rows:, rows:] = of_pose
    try:
        diagonal = np.diagonal(np.linalg.cholesky(whole), axis1=1, axis2=2)
    except np.linalg.LinAlgError:
        raise ArithmeticError(
            "joint_covariance() of the filter must be positive definite, and is not: no gain can be expected"
        ) from None
    logdets: FloatArray = 2.0 * np.log(diagonal[:, rows if gain == "pose" else 0 :]).sum(axis=1)
    return logdets
