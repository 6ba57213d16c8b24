"""Expected information gain of sequences of looks: pure maths, many sequences at once.

The information matrix (inverse covariance) of pose and map is carried along, in the errors delta r, phi (rotation in W)
and delta p of `Knowledge`, positions taken relative to the camera as it is now. In these,

- a known motion changes nothing;
- its noise, of covariance Q on the pose, takes L, the columns of the pose, to L A, with A = (I + Q L_pose)^-1, and the
  information of the map down by L_map A Q L_map^T; that of steps without a look adds up;
- a look adds H^T R^-1 H of every landmark to its own block, and what follows from d e / d pose = [-I, [e]x] to the
  rest: a step costs 6 columns instead of the whole matrix.

Only at the end is the matrix put together, with the pose last, and one Cholesky factor of it has the answer to both
questions: all of its diagonal is the log-determinant of pose and map, the last six are that of the pose, whatever the
map is.

Landmarks that a sequence never looks at say nothing of the pose, and nothing of what one look gains: they are left out.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.compilation import entry
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
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
    gains = np.zeros(len(looks))
    try:
        _put_gains(knowledge.covariance, knowledge.by_pose, looks, Q, gain == "pose", gains)
    except np.linalg.LinAlgError:
        raise ArithmeticError(
            "joint_covariance() of the filter must be positive definite, and is not: no gain can be expected"
        ) from None
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


@entry
def _put_gains(
    covariance: FloatArray, by_pose: FloatArray, looks: FloatArray, Q: FloatArray, of_pose: bool, gains: FloatArray
) -> None:
    sequences, steps, count = looks.shape[:3]
    for s in range(sequences):
        seen = np.empty((steps, count), dtype=np.bool_)
        needed = np.full(count, not of_pose and steps > 1)
        for k in range(steps):
            for i in range(count):
                seen[k, i] = looks[s, k, i, 0, 0] + looks[s, k, i, 1, 1] + looks[s, k, i, 2, 2] > 0.0
                needed[i] |= seen[k, i]
        index, place = np.flatnonzero(needed), 3 * (np.cumsum(needed) - 1)
        rows = 3 * len(index)
        if rows == 0:
            continue
        C, noise = _part(covariance, index), np.zeros((POSE_SIZE, POSE_SIZE))
        L = np.linalg.inv(C)
        L_xm, L_x = L[:POSE_SIZE, POSE_SIZE:].copy(), L[:POSE_SIZE, :POSE_SIZE].copy()
        before, lost, used = np.empty((steps * POSE_SIZE, rows)), np.empty((steps * POSE_SIZE, rows)), 0
        for k in range(steps):
            noise += Q[k]
            C[:POSE_SIZE, :POSE_SIZE] += Q[k]
            if k < steps - 1 and not seen[k].any():
                continue
            A = np.linalg.inv(np.eye(POSE_SIZE) + np.dot(noise, L_x))
            before[used : used + POSE_SIZE] = L_xm
            lost[used : used + POSE_SIZE] = np.dot(np.dot(noise, A.T), L_xm)
            L_xm, L_x, used = np.dot(A.T, L_xm), np.dot(L_x, A), used + POSE_SIZE
            noise[:] = 0.0
            for n in np.flatnonzero(seen[k]):
                WB = np.dot(looks[s, k, n], by_pose[n])
                for a in range(3):
                    for b in range(3):
                        L[POSE_SIZE + place[n] + a, POSE_SIZE + place[n] + b] += looks[s, k, n, a, b]
                    for j in range(POSE_SIZE):
                        L_xm[j, place[n] + a] += WB[a, j]
                L_x += np.dot(by_pose[n].T, WB)
        whole = np.empty((rows + POSE_SIZE, rows + POSE_SIZE))
        whole[:rows, :rows] = L[POSE_SIZE:, POSE_SIZE:] - np.dot(before[:used].T, lost[:used])
        whole[:rows, rows:], whole[rows:, :rows], whole[rows:, rows:] = L_xm.T, L_xm, L_x
        first = rows if of_pose else 0
        prior = C[:POSE_SIZE, :POSE_SIZE].copy() if of_pose else C
        gains[s] = (
            np.log(np.diag(np.linalg.cholesky(whole))[first:]).sum() + np.log(np.diag(np.linalg.cholesky(prior))).sum()
        )


@entry
def _part(covariance: FloatArray, index: IntArray) -> FloatArray:
    """Covariance of the pose and of the landmarks at `index` (M,); (6 + 3 M, 6 + 3 M)."""
    rows = np.arange(POSE_SIZE + 3 * len(index))
    for m, i in enumerate(index):
        for a in range(3):
            rows[POSE_SIZE + 3 * m + a] = POSE_SIZE + 3 * i + a
    part = np.empty((len(rows), len(rows)))
    for i, row in enumerate(rows):
        for j, column in enumerate(rows):
            part[i, j] = covariance[row, column]
    return part
